"""The sheet: a whole file or none, of the stated size, showing what it was given."""

import pytest
import torch

from mitsvbrdf import color
from mitsvbrdf.errors import CaptureError, OutputError
from mitsvbrdf.io import images
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import flat
from mitsvbrdf.report.overview import GAP, HEADER, LABEL, MARGIN, write_sheet


def sheet(path, svbrdf, count=9, guess=None, title="50 $ of $x^2$"):
    photos = torch.rand(count, 16, 16, 3, generator=torch.Generator().manual_seed(0))
    write_sheet(path, svbrdf, photos, photos.flip(0), rmse=0.1234, per_photo=[0.1] * count,
                names=[f"{i:02d}" for i in range(count)], title=title, guess=guess)
    return images.read_image(path, CaptureError)


@pytest.mark.parametrize("count", [1, 4, 9, 12])
def test_the_sheet_is_an_image_of_the_stated_width(tmp_path, count):
    image = sheet(tmp_path / "new" / "sheet.png", make_material("tiles", 32), count)
    assert image.shape[1:] == (1680, 3) and 800 < image.shape[0] < 1700
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["sheet.png"]


def test_maps_are_shown_for_display(tmp_path):
    # Four maps of 397 pixels, the last one a normal that points up.
    image = sheet(tmp_path / "a.png", flat(8, diffuse=0.2, specular=0.04, roughness=0.7))
    at = [image[HEADER + LABEL + 200, MARGIN + i * (397 + GAP) + 200] for i in range(4)]
    wanted = [color.to_display(torch.full((3,), v), "srgb") for v in (0.2, 0.04)]
    wanted += [torch.full((3,), 0.7), torch.tensor([0.5, 0.5, 1.0])]
    for got, want in zip(at, wanted, strict=True):
        assert (got - want).abs().max() <= 1.01 / 255  # one 8-bit step: matplotlib cuts where we round


def test_a_principled_material_with_guess(tmp_path):
    image = sheet(tmp_path / "a.png", flat(8, "principled", metallic=1.0), 2, torch.full((8, 8, 3), 0.5))
    # Five maps of 316 pixels: metallic is the second, the guess the last.
    assert image[HEADER + LABEL + 150, MARGIN + 316 + GAP + 150].min() == 1
    assert image[HEADER + LABEL + 150, -MARGIN - 150].mean() == pytest.approx(0.735, abs=0.005)


def test_a_failing_write_leaves_the_old_file_alone(tmp_path, monkeypatch):
    (tmp_path / "a.png").write_bytes(b"old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OutputError, match="No space left"):
        sheet(tmp_path / "a.png", flat(4))
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"] and (tmp_path / "a.png").read_bytes() == b"old"
