"""The manifest of a result folder: a list of our files, and a serial number that a new result increases."""

import os
from pathlib import Path

from .files import inside, is_regular, stays_inside
from .json import load

MANIFEST = ".mitsvbrdf"
# Folders that commands make by default inside the folder of the maps: name, and the file that identifies it.
DERIVED = {"export": "export.json", "relight": "relight.json"}


def own_files(out: Path) -> list[str]:
    """Names of our files in ``out``, as its manifest lists them; empty without a manifest."""
    names = _manifest(out).get("files")
    return [name for name in (names if isinstance(names, list) else ())
            if stays_inside(name) and name != MANIFEST]


def derived(out: Path) -> dict[str, list[str]]:
    """A dict: each :data:`DERIVED` folder that was made from this result, to the names of its files.

    A folder must be beside a file of the result, and its own manifest must list the file that identifies it.
    Names are relative to ``out``.
    """
    found = {}
    for name in derived_places(out):
        place = inside(out, name)
        theirs = own_files(place) if place else []
        if any(Path(each).name == DERIVED[Path(name).name] for each in theirs):
            found[name] = [f"{name}/{each}" for each in (*theirs, MANIFEST)]
    return found


def files_of_others(out: Path) -> list[str]:
    """Names of files in ``out`` that are not ours. Unfinished :data:`DERIVED` folders are ours."""
    ours = {MANIFEST, *own_files(out), *(name for names in derived(out).values() for name in names)}
    left = [Path(name) for name in derived_places(out)]
    staged = {str(path.with_name(f"{path.name}.partial")) for path in left}
    staged |= {str(path.with_name(f".{path.name}.added")) for path in left}
    ours |= {str(path.with_name(f".{path.name}.lock")) for path in left}
    found = []
    for here, folders, names in os.walk(out):
        at = Path(here).relative_to(out)
        links = [name for name in folders if Path(here, name).is_symlink()]
        folders[:] = [name for name in folders if name not in links and str(at / name) not in staged]
        found += [str(at / name) for name in (*names, *links)
                  if not (str(at / name) in ours and is_regular(Path(here, name)))]
    return sorted(found)


def is_ours(folder: Path) -> bool:
    """Whether a command of ours made this folder, or nothing is in it."""
    return folder.is_dir() and not folder.is_symlink() and (
        is_regular(folder / MANIFEST) or not any(folder.iterdir()))


def serial_of(folder: Path) -> int:
    """The serial number of a result folder; 0 if it has none."""
    serial = _manifest(folder).get("serial")
    return serial if isinstance(serial, int) else 0


def _manifest(folder: Path) -> dict:
    try:
        found = load(folder / MANIFEST, (dict, list), links=False)
    except (OSError, ValueError):
        return {}
    return {"files": found} if isinstance(found, list) else found  # earlier versions wrote only a list


def derived_places(out: Path) -> list[str]:
    """The paths, relative to ``out``, where folders of :data:`DERIVED` may be."""
    homes = {parent for name in own_files(out) for parent in Path(name).parents}
    return sorted(str(home / folder) for home in homes for folder in DERIVED)
