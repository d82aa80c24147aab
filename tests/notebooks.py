"""Run notebooks with a kernel of this Python.

``python tests/notebooks.py docs/tutorial.ipynb`` renews the kept outputs of a notebook.
"""

import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def run(notebook, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Run a notebook (of nbformat) in place, in this folder. An error in a cell is raised.

    Returns:
        The types of all messages from the kernel, in their order.
    """
    needs = "needs nbclient and ipykernel: pip install mitsvbrdf[test]"
    client = pytest.importorskip("nbclient", reason=needs)
    kernelspec = pytest.importorskip("ipykernel.kernelspec", reason=needs)
    kernelspec.write_kernel_spec(folder / "jupyter/kernels/python3")
    monkeypatch.setenv("JUPYTER_PATH", str(folder / "jupyter"))  # is searched first
    monkeypatch.setenv("IPYTHONDIR", str(folder / "ipython"))  # no start-up files of a user
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    messages: list[str] = []

    class Client(client.NotebookClient):
        def process_message(self, msg, cell, cell_index):
            messages.append(msg["msg_type"])
            return super().process_message(msg, cell, cell_index)

    Client(notebook, kernel_name="python3", timeout=300, resources={"metadata": {"path": str(folder)}},
           record_timing=False, coalesce_streams=True).execute()
    return messages


def main(*paths: str) -> None:
    """Run notebooks and write them with their outputs, without the marks of a machine or a moment."""
    import nbformat

    for path in paths:
        notebook = nbformat.read(path, 4)
        with pytest.MonkeyPatch.context() as monkeypatch, tempfile.TemporaryDirectory() as folder:
            run(notebook, Path(folder), monkeypatch)
        notebook.metadata.language_info = {"name": "python"}
        nbformat.write(notebook, path)


if __name__ == "__main__":
    main(*sys.argv[1:])
