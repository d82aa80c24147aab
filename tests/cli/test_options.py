"""What commands say of the photos that they read."""

import shutil

from mitsvbrdf.cli.options import read_photos


def test_photos_of_a_phone_go_by_numbers_that_its_page_explains(shots, tmp_path, capsys):
    folder = tmp_path / "capture"
    shutil.copytree(shots, folder)
    read_photos(folder, 16, None, "auto", "inverse-square")
    assert "quality.html" not in capsys.readouterr().out
    (folder / "quality.html").touch()
    read_photos(folder, 16, None, "auto", "inverse-square")
    assert f"numbers in {folder}/quality.html" in capsys.readouterr().out
