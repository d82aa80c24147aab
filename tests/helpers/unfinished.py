"""Results of a few bytes, and an unfinished run of ours, as a killed command leaves it beside OUT."""

from mitsvbrdf.io import files, results


def make(out, *names, text="new", overwrite=False, **options):
    """Make a result of these files, as a command does."""
    with results.output_folder(out, overwrite, **options) as folder:
        for name in names:
            files.write_bytes(folder / name, text.encode())


def unfinished(out, *names, content=b"state"):
    """Make OUT.partial with these files; returns it."""
    partial = results.partial_folder(out)
    for name in names:
        files.write_bytes(partial / name, content)
    files.write_json(partial / results.MANIFEST, {"serial": 2**40, "files": []})
    return partial
