"""Too large for memory or disk: said before the work begins."""

import shutil
from types import SimpleNamespace

import pytest
from helpers import photos_of

from mitsvbrdf import cli
from mitsvbrdf.capture import write_capture
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.io import provenance, room
from mitsvbrdf.material.made import make_material

GIB = 2**30


@pytest.fixture
def machine(monkeypatch):
    """Sets the GiB of memory and disk that are free."""
    def has(memory, disk=1000.0):
        monkeypatch.setattr(room, "memory_gib", lambda: (2 * memory, memory))
        monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=int(disk * GIB)))
    return has


def test_a_container_counts_and_not_its_machine(tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "_groups", lambda: [tmp_path, tmp_path / "above"])
    cores, (total, free) = provenance.usable_cores(), provenance.memory_gib()
    for name, text in {"memory.max": str(GIB), "memory.current": str(GIB // 2), "cpu.max": "100000 100000",
                       "memory.stat": f"anon 5\ninactive_file {GIB // 4}\n"}.items():
        (tmp_path / name).write_text(text)
    assert provenance.memory_gib() == (1.0, 0.75) and provenance.usable_cores() == 1
    (tmp_path / "memory.max").write_text("max\n")  # without a limit
    (tmp_path / "cpu.max").write_text("max 100000\n")
    assert provenance.memory_gib()[0] == total > 1 and provenance.usable_cores() == cores and free > 0


def test_what_fits_is_named(machine, tmp_path):
    machine(room.PROCESS + 4)
    room.check_room(4096, 256, tmp_path / "new" / "out", 1000)  # 4 GiB in 4 GiB
    machine(room.PROCESS + 3.9)
    with pytest.raises(ConfigError, match="4.7 GiB of memory for 4096 px, got 4.6 GiB; "
                                          "--resolution 4032 fits"):  # 63 times 64; 4044 is the root
        room.check_room(4096, 256)


def test_the_disk_counts(machine, tmp_path):
    machine(1000, disk=2)
    with pytest.raises(ConfigError, match="8.0 GiB of space on the disk of .*out for 4096 px, got 2.0 GiB; "
                                          "--resolution 2048 fits"):
        room.check_room(4096, 1, tmp_path / "out", 512)
    machine(0.1)
    with pytest.raises(ConfigError, match="; free some"):
        room.check_room(64, 1)


def test_a_fit_says_it_in_one_line_and_leaves_nothing(machine, tmp_path, capsys):
    write_capture(photos_of(make_material("leather", 32)), tmp_path / "photos")
    machine(room.PROCESS)
    assert cli.main(["fit", str(tmp_path / "photos"), "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1 and not (tmp_path / "out").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]
