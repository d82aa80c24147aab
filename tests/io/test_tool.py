"""Tools that are no commands: streams that fail and mistakes end them as they end a command."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import ROOT

import mitsvbrdf

TOOL = """if True:
    import os, sys
    from pathlib import Path
    from mitsvbrdf.errors import ConfigError
    from mitsvbrdf.io.files import write_bytes
    from mitsvbrdf.io.tool import run_tool

    def main(file: Path, way: str = "done") -> int:
        print("measured")
        if way == "mistake":
            raise ConfigError("this", "that", "change it")
        if way == "pressed":
            raise KeyboardInterrupt
        write_bytes(file, b"whole")
        return 0

    sys.exit(run_tool(main, "tool", "interrupted; nothing is written"))
"""


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device that is always full")
def test_streams_and_mistakes_end_a_tool_as_they_end_a_command(tmp_path):
    def run(redirected, *options):
        """Exit code and standard error of tools that run beside each other."""
        name = f"{len(running)}"
        running.append(name)
        return subprocess.Popen(
            ["bash", "-c", f'exec "$@" {redirected}', "bash", sys.executable, "-P", "-c", TOOL, "--file",
             str(tmp_path / name),
             *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT)})

    running: list[str] = []
    begun = [run(">/dev/full"), run("<&- >&- 2>&-"), run("", "--way", "mistake"), run("", "--way", "pressed"),
             run("", "--wya")]
    said = [each.communicate()[1] for each in begun]
    assert [each.returncode for each in begun] == [0, 0, 2, 130, 2] and not any("Traceback" in words
                                                                                for words in said)
    assert said[0].startswith("warning: standard output is cut short: No space left") and said[1] == ""
    assert said[2] == "error: expected this, got that; change it\n" and said[
        3] == "interrupted; nothing is written\n"
    assert [path.read_text() for path in sorted(tmp_path.iterdir())] == ["whole", "whole"]


@pytest.mark.parametrize("stated, expected", [(None, "PASSIVE"), ("ACTIVE", "ACTIVE")])
def test_torch_finds_how_threads_wait_though_the_tool_loads_it_first(stated, expected):
    """A stand-in notes what torch would read when it loads."""
    tool = """if True:
        import os, sys
        sys.modules["torch"] = loaded = type(os)("torch")
        loaded.device, loaded.found = object(), os.environ.get("OMP_WAIT_POLICY")
        from mitsvbrdf.io.tool import run_tool
        def main(word: str) -> int:
            print(word, loaded.found)
            return 3
        sys.exit(run_tool(main, "tool"))
    """
    others = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    environment = others | {"PYTHONPATH": str(ROOT)} | ({"OMP_WAIT_POLICY": stated} if stated else {})
    found = subprocess.run([sys.executable, "-P", "-c", tool, "--word", "so"], env=environment,
                           capture_output=True, text=True)
    assert (found.stdout, found.returncode) == (f"so {expected}\n", 3), found.stderr


def test_there_is_one_way_in():
    folder = Path(mitsvbrdf.__file__).parent
    found = {str(path.relative_to(folder)) for path in folder.rglob("*.py") if re.search(r"tyro\.cli\(",
                                                                                         path.read_text())}
    assert found == {"cli/__init__.py", "cli/batch.py", "io/tool.py"}
