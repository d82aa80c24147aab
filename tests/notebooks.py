"""Notebooks run by a kernel of the Python that runs the tests, whatever other kernels the machine offers."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


class Recorder:
    """What :func:`run` saw: the messages that displays send, by their type, in their order."""

    def __init__(self) -> None:
        self.types: list[str] = []


def run(notebook, folder: Path, monkeypatch) -> Recorder:
    """Run a notebook (of nbformat) in place, in this folder; an error in a cell is raised."""
    client = pytest.importorskip("nbclient", reason="needs nbclient and ipykernel: pip install mitsvbrdf[test]")
    kernelspec = pytest.importorskip("ipykernel.kernelspec", reason="needs ipykernel: pip install mitsvbrdf[test]")
    kernelspec.write_kernel_spec(folder / "jupyter/kernels/python3")
    monkeypatch.setenv("JUPYTER_PATH", str(folder / "jupyter"))  # is searched first
    monkeypatch.setenv("IPYTHONDIR", str(folder / "ipython"))  # no start-up files of a user
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    seen = Recorder()

    class Client(client.NotebookClient):
        def process_message(self, msg, cell, cell_index):
            seen.types.append(msg["msg_type"])
            return super().process_message(msg, cell, cell_index)

    Client(notebook, kernel_name="python3", timeout=120, resources={"metadata": {"path": str(folder)}},
           coalesce_streams=True).execute()
    return seen
