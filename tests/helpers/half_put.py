"""A result as a command leaves it that was killed while it put it in place."""

import json

from mitsvbrdf.io import result_folder
from mitsvbrdf.io.journal import JOURNAL


def half_put(out):
    """Of the files of a whole result every other one is still where it was made."""
    partial = result_folder.partial_folder(out)
    names = sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())
    for name in names[::2]:
        (partial / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).rename(partial / name)
    (partial / JOURNAL).write_text(json.dumps({"staged": "", "earlier": [], "new": names}))
