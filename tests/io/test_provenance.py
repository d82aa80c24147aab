"""Memory and cores that a container has, not its machine; and the model of the CPU."""

import pytest

from mitsvbrdf.io import provenance

GIB = 2**30


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


@pytest.mark.parametrize("told, cpu", [("processor : 0\nmodel name\t: EPYC 7B13 \nflags :\n", "EPYC 7B13"),
                                       ("processor : 0\n", "kind")])
def test_the_model_of_the_cpu_tells_machines_apart(told, cpu, tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "CPUS", tmp_path / "cpuinfo", raising=False)
    monkeypatch.setattr(provenance.platform, "processor", lambda: "kind")
    (tmp_path / "cpuinfo").write_text(told)
    assert provenance.machine()["cpu"] == cpu
