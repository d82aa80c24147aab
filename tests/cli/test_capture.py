"""What `capture` prints of the photos it was given."""

import shutil
from types import SimpleNamespace

from mitsvbrdf.cli.capture import _print
from mitsvbrdf.cli.options import read_photos


def result(resolution, photos=("IMG_1.jpg", "blurred[red].jpg", "IMG_2.jpg"), rejected="blurred[red].jpg"):
    """Three photos, the second of them rejected, rectified to so many pixels."""
    used = [name for name in photos if name != rejected]
    rig = SimpleNamespace(rejected={rejected: "blurred: 0.2"}, errors=dict.fromkeys(used, 0.25), tags={})
    return SimpleNamespace(used=used, photos=[SimpleNamespace(name=name) for name in photos], rig=rig,
                           qualities={}, warnings=("the photos are small",), covered=0.5, next_view=None,
                           capture=SimpleNamespace(resolution=resolution, calibrated=True))


def test_the_table_says_by_which_number_a_fit_calls_each_photo(capsys):
    _print(result(1024), [])
    rows = {cells[1].strip(): cells[2].strip() for line in capsys.readouterr().out.splitlines()
            if len(cells := line.split("│")) > 3}
    assert rows == {"IMG_1.jpg": "used as 00", "blurred[red].jpg": "blurred: 0.2", "IMG_2.jpg": "used as 01"}


def test_photos_of_a_phone_go_by_numbers_that_its_page_explains(shots, tmp_path, capsys):
    folder = tmp_path / "capture"
    shutil.copytree(shots, folder)
    read_photos(folder, 16, None, "auto", "inverse-square")
    assert "quality.html" not in capsys.readouterr().out
    (folder / "quality.html").touch()
    read_photos(folder, 16, None, "auto", "inverse-square")
    assert f"numbers in {folder}/quality.html" in capsys.readouterr().out
