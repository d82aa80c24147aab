"""Scripts of pages in node: what their functions give, without a browser."""

import json
import os
import shutil
import subprocess
from collections.abc import Sequence
from importlib.resources import files

import pytest

DRIVER = """
const calls = JSON.parse(require("fs").readFileSync(0, "utf8"));
console.log(JSON.stringify(calls.map(([name, args]) => eval(name)(...args))));
"""


def called(scripts: Sequence[str], calls: Sequence[tuple[str, list]], timezone: str = "UTC") -> list:
    """What functions of scripts, named by paths inside the package, give for ``calls`` (name, arguments), all
    in one process in a ``timezone``; the test is skipped where node is not installed.
    """
    node = shutil.which("node") or pytest.skip("needs node on PATH")
    text = "".join(files("mitsvbrdf").joinpath(script).read_text(encoding="utf-8") for script in scripts)
    done = subprocess.run([node, "-e", text + DRIVER], input=json.dumps(calls), capture_output=True,
                          text=True, check=True, env=os.environ | {"TZ": timezone})
    return json.loads(done.stdout)
