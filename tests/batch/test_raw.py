"""Raw photos of a batch."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch

from mitsvbrdf.batch.captures import rectified
from mitsvbrdf.capture.align import from_sheet
from mitsvbrdf.errors import CaptureError
from mitsvbrdf.io import images


def test_a_sheet_without_its_size_is_told_with_the_options_of_a_batch(tmp_path, monkeypatch):
    for number in range(3):
        images.write_png(tmp_path / f"{number}.png", torch.full((64, 64, 3), 0.5))
    monkeypatch.setattr(from_sheet, "find_edges", lambda *_, **__: SimpleNamespace(corners=range(30)))
    with pytest.raises(CaptureError, match="30 tags in 0.*`--sheet 18`, to the command or on the line of a "
                                           "list") as error:
        rectified(tmp_path, tmp_path / "out", None, None)
    assert "mitsvbrdf capture" not in str(error.value)
