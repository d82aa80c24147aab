"""The pytest plugin is light, and loaded once."""

import importlib
import os
import subprocess
import sys
import tomllib

from helpers import ROOT
from helpers.golden_suite import PLUGIN


def test_the_plugin_is_light(tmp_path):
    # In a process of its own: a suite that asks for none of it pays for neither torch nor Mitsuba.
    (tmp_path / "test_alone.py").write_text("""
import sys

def test_light(request):
    assert request.config.getoption("mitsvbrdf_report") == "pages"  # pytest-xdist sends no Path
    assert request.config.pluginmanager.has_plugin("mitsvbrdf.testing.plugin")
    assert not {"torch", "mitsuba", "drjit", "cv2", "matplotlib", "numpy"} & set(sys.modules)
""")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run([sys.executable, "-m", "pytest", "-p", PLUGIN, "--mitsvbrdf-report", "pages", "."],
                          cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_entry_point_and_the_module_are_one_plugin(suite):
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["pytest11"]
    assert declared == {PLUGIN: PLUGIN}
    assert importlib.import_module(PLUGIN).pytest_addoption
    suite.pytester.makeconftest(f"pytest_plugins = ['{PLUGIN}']")
    suite.run(failed=3)  # -p and conftest together
