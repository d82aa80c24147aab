"""The leave-out table: pictures with and without agree, and the files say what was measured."""

import json

import pytest

from mitsvbrdf.cli import main

# Two float32 results of one scene. Measured at 16 px: the same bits but for the Fresnel formula and for rays, 1.3e-6.
DIFFERENCE = 3e-6


@pytest.mark.slow
def test_leaving_out_changes_nothing_and_is_written_down(tmp_path, capsys):
    files = [str(tmp_path / name) for name in ("record.json", "page.md")]
    assert main(["leave-out", "--resolution", "16", "--repeats", "1", "--json", files[0], "--md", files[1]]) == 0
    items = json.loads((tmp_path / "record.json").read_text())["items"]
    page, shown = (tmp_path / "page.md").read_text(), capsys.readouterr().out
    for item in items:
        assert item["worst"] < DIFFERENCE or item["what"] == "light falloff", item["what"]
        assert f"| {item['what']} |" in page
    assert {"specular lobe", "diffuse lobe", "normal map", "ray tracing", "shadow rays", "path depth", "environment",
            "discriminator", "all of these"} <= {item["what"] for item in items}
    assert "all of these" in shown


def test_bad_options():
    assert main(["leave-out", "--resolution", "4"]) == 2
