"""What commands put into a result, out of its maps, goes when the result does; nobody else's file goes."""

import pytest

from mitsvbrdf.errors import OutputError
from mitsvbrdf.io import files, result_folder
from mitsvbrdf.io.journal import JOURNAL, Journal
from mitsvbrdf.relight import frames

EXPORT, RELIGHT = ("gltf/export.json", "gltf/material.glb", "preview.png"), ("relight.json", "sphere.png")


def make(out, *names, text="old", **options):
    with result_folder.output_folder(out, **({"overwrite": False} | options)) as folder:
        for name in names:
            files.write_bytes(folder / name, text.encode())


@pytest.fixture
def out(tmp_path):
    """A fit with a look, exported and relit."""
    out = tmp_path / "out"
    make(out, "fit.json", "maps/a.exr", "look/a.exr")
    make(out / "export", *EXPORT)
    make(out / "relight", *RELIGHT)
    make(out / "look/relight", *RELIGHT)
    return out


def there(out):
    names = [str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()]
    return sorted(name for name in names if not name.endswith(result_folder.MANIFEST))


@pytest.mark.parametrize("options", [{"overwrite": True}, {"overwrite": False, "resume": True}])
def test_what_was_made_of_an_earlier_result_goes_with_it(options, out, capsys):
    if "resume" in options:
        (out / ".partial").mkdir()
        options["overwrite"] = True
    make(out, "fit.json", "maps/a.exr", text="new", **options)
    assert there(out) == ["fit.json",
                          "maps/a.exr"] and not (out / "export").exists() and not (out / "look").exists()
    said = " ".join(capsys.readouterr().out.split())
    assert "removed, as made of the earlier result: export, look/relight, relight" in said


def test_files_of_others_stay_and_are_named(out, capsys):
    for name in ("export/gltf/mine.txt", "check.html", "notes/a.txt"):
        files.write_bytes(out / name, b"mine")
    make(out, "fit.json", text="new", overwrite=True)
    assert there(out) == ["check.html", "export/gltf/mine.txt", "fit.json", "notes/a.txt"]
    assert "no part of this result: check.html, export, notes" in " ".join(capsys.readouterr().out.split())


def test_of_many_files_of_others_five_are_named(tmp_path, capsys):
    make(tmp_path, "fit.json")
    for name in "fedcba":
        files.write_bytes(tmp_path / name, b"mine")
    make(tmp_path, "fit.json", overwrite=True)
    said = " ".join(capsys.readouterr().out.split())
    assert said.endswith("no part of this result: a, b, c, d, e ...") and "removed" not in said


def test_files_that_are_added_take_nothing_away(out, capsys):
    before = there(out)
    make(out, "report.html", add=True)
    assert there(out) == sorted([*before, "report.html"]) and not capsys.readouterr().out


def test_a_result_of_another_kind_under_such_a_name_is_a_users_choice(tmp_path):
    make(tmp_path, "fit.json")
    make(tmp_path / "export", "fit.json", "maps/a.exr")
    make(tmp_path, "fit.json", text="new", overwrite=True)
    assert there(tmp_path / "export") == ["fit.json", "maps/a.exr"]


def test_maps_of_a_users_own_keep_what_was_made_of_them(tmp_path):
    files.write_bytes(tmp_path / "diffuse.png", b"mine")
    make(tmp_path / "relight", *RELIGHT)
    make(tmp_path, "fit.json", overwrite=True)
    assert there(tmp_path) == ["diffuse.png", "fit.json", "relight/relight.json", "relight/sphere.png"]


def test_a_link_in_its_place_is_not_followed(out, tmp_path):
    (out / "export").rename(tmp_path / "elsewhere")
    (out / "export").symlink_to(tmp_path / "elsewhere")
    make(out, "fit.json", text="new", overwrite=True)
    assert there(tmp_path / "elsewhere") == sorted(EXPORT) and (out / "export").is_symlink()


def test_a_command_at_work_there_is_not_disturbed(out):
    for place in ("relight", "look/export"):  # again, and for the first time
        with result_folder.output_folder(out / place, overwrite=True), pytest.raises(OutputError,
                                                                                     match=f"{place}, in use"):
            result_folder.check_free(out, overwrite=True)


def test_all_or_none_of_it_goes(out, monkeypatch):
    before = there(out)
    monkeypatch.setattr(Journal, "_clear", lambda *_: (_ for _ in ()).throw(OSError(28, "full")))
    with pytest.raises(OutputError, match="full"):
        make(out, "fit.json", text="new", overwrite=True)
    assert there(out) == before and not (out / ".partial" / JOURNAL).exists()


def test_relight_is_known_by_its_record():
    # tests/export/test_command.py has the same of export
    assert result_folder.DERIVED["relight"] == frames.RECORD
