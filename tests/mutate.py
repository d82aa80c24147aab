"""Would the tests notice? Breaks the renderers in a copy, one thing at a time, and sees who catches it.

    python tests/mutate.py [NAME ...] [--json FILE]

For each break the renderer tests run in the copy until the first failure, and the cross-check on the built-in
materials. Exit code 1 if any break passes both. Takes some minutes.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TESTS = ("tests/render/test_render.py", "tests/render/test_needs.py", "tests/test_conventions.py",
         "tests/cli")
CROSSCHECK = ("crosscheck", "--resolution", "32", "--repeats", "1")


@dataclass(frozen=True)
class Mutation:
    """One wrong line: ``right`` must stand exactly once in ``file`` and is replaced by ``wrong``."""

    name: str
    file: str
    right: str
    wrong: str


MUTATIONS = [
    Mutation("square the roughness twice", "render/bsdf.py",
             'maps["roughness"] * maps["roughness"]', '(maps["roughness"] * maps["roughness"]) ** 2'),
    Mutation("drop the 0.5 of the blend", "render/bsdf.py", 'maps["diffuse"] * needs.lobes',
             'maps["diffuse"]'),
    Mutation("flip a row", "render/scene.py", 'held[slot]["data"] = value[::-1]',
             'held[slot]["data"] = value'),
    Mutation("swap G", "render/analytic.py", "_smith(a2, c.n_l) * _smith(a2, c.n_v)",
             "_smith(a2, c.n_l) * _smith(a2, c.n_l)"),
    Mutation("turn use_shadowing_function on", "render/bsdf.py",
             '"use_shadowing_function": False', '"use_shadowing_function": True'),
    Mutation("stale light", "render/scene.py", 'params["light.position"] = mi.Point3f(light)',
             'params["light.position"] = mi.Point3f(row(mi, lights.array, 0))'),
    Mutation("wrong principal point", "render/plugins.py", "position_sample.x - 0.5",
             "position_sample.x - 0.49"),
    Mutation("wrong principal point of the exported scene", "export/mitsuba.py", '"shift_x": -x',
             '"shift_x": x'),
    Mutation("drop a normalisation", "render/texels.py", "dr.normalize(camera - place)",
             "(camera - place)"),
    Mutation("drop the normalisation of the normals", "render/plugins.py", "n = dr.normalize(normal)",
             "n = normal"),
    Mutation("clamp alpha at 0.05", "render/bsdf.py", 'maps["roughness"] * maps["roughness"]',
             '__import__("drjit").maximum(maps["roughness"] * maps["roughness"], 0.05)'),
    Mutation("gamma in the wrong place", "render/texels.py", "self.plugin.eval(self._context, si, "
                                                                   "to_light)",
             "self.plugin.eval(self._context, si, to_light) ** (1 / 2.2)"),
    Mutation("leave out the Fresnel curve too early", "render/needs.py", "CONSTANT_FRESNEL_DEGREES = 1.5",
             "CONSTANT_FRESNEL_DEGREES = 12.0"),
    Mutation("cancelling form of the distribution", "render/analytic.py",
             "a2 * c.n_h**2 + c.across2", "c.n_h**2 * (a2 - 1) + 1"),
]


def broken(mutation: Mutation | None, folder: Path) -> Path:
    """A copy of the repository in ``folder`` with this mutation, or sound with None."""
    for part in ("mitsvbrdf", "tests", "scenes", "docs"):
        shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / file, folder / file)
    if mutation:
        path = folder / "mitsvbrdf" / mutation.file
        text = path.read_text()
        if text.count(mutation.right) != 1:
            raise SystemExit(f"{mutation.name}: {mutation.right!r} stands {text.count(mutation.right)} "
                             f"times in {mutation.file}, expected once; adapt the mutation")
        path.write_text(text.replace(mutation.right, mutation.wrong))
    return folder


def verdicts(folder: Path) -> dict[str, str | None]:
    """Who catches what is wrong in this copy: the first failing test and the cross-check's complaint, or
    None.
    """
    environment = os.environ | {"PYTHONPATH": str(folder), "OMP_WAIT_POLICY": "PASSIVE"}

    def run(*command: str) -> subprocess.CompletedProcess:
        return subprocess.run([sys.executable, *command], cwd=folder, env=environment, capture_output=True,
                              text=True)

    tests = run("-m", "pytest", "-x", "-q", "--tb=no", *TESTS)
    first = next((line.split()[1] for line in tests.stdout.splitlines()
                  if line.startswith(("FAILED", "ERROR"))), None)
    if tests.returncode not in (0, 1):
        raise SystemExit(f"the tests did not run: {tests.stdout[-2000:]}{tests.stderr[-2000:]}")
    check = run("-m", "mitsvbrdf", *CROSSCHECK)
    if check.returncode not in (0, 1):
        raise SystemExit(f"the cross-check did not run: {check.stdout[-2000:]}{check.stderr[-2000:]}")
    return {"tests": first if tests.returncode else None, "crosscheck": "exit code 1" if check.returncode
            else None}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="only mutations whose name holds one of these words")
    parser.add_argument("--json", type=Path, help="write the verdicts to this file")
    options = parser.parse_args()
    chosen = [m for m in MUTATIONS if not options.names or any(word in m.name for word in options.names)]
    if not chosen:
        parser.error(f"no mutation of that name; there are: {', '.join(m.name for m in MUTATIONS)}")
    results, survivors = [], []
    for mutation in [None, *chosen]:
        with tempfile.TemporaryDirectory() as folder:
            found = verdicts(broken(mutation, Path(folder)))
        name = mutation.name if mutation else "nothing broken"
        results.append({"mutation": name} | found)
        print(f"{name}: tests {found['tests'] or 'pass'}; cross-check {found['crosscheck'] or 'passes'}",
              flush=True)
        caught = found["tests"] or found["crosscheck"]
        if mutation is None and caught:
            raise SystemExit("mend this first: a sound copy must pass")
        if mutation is not None and not caught:
            survivors.append(name)
    if options.json:
        options.json.write_text(json.dumps(results, indent=1))
    print(f"{len(chosen) - len(survivors)} of {len(chosen)} caught" + (f"; not: {', '.join(survivors)}"
                                                                       if survivors else ""))
    return 1 if survivors else 0


if __name__ == "__main__":
    raise SystemExit(main())
