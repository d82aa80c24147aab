"""The command line: parse, call, print, exit code.

0 is success, and a fit that Ctrl-C ended early; 1 a check that does not hold; 2 a mistake the caller can mend; 130 Ctrl-C
without a result.
"""

from __future__ import annotations

import sys

import tyro
from tyro.conf import FlagCreatePairsOff

from .. import __version__
from ..errors import exit_code
from ..system.progress import say
from .bench import bench
from .capture import capture
from .compare import compare
from .crosscheck import crosscheck
from .demo import demo
from .evaluate import evaluate
from .export import export
from .fit import fit_command, method_named, with_flags
from .guess import guess
from .leave_out import leave_out
from .options import Variant
from .pretrain import pretrain_command
from .relight import relight
from .render import render
from .report import report
from .sheet import sheet
from .stability import stability
from .synth import synth
from .view import view


def doctor(variant: Variant = "llvm_ad_rgb", json: bool = False) -> int:
    """Show what is installed, prove libLLVM in a child process, and say what is missing and how to get it."""
    from ..doctor import doctor as examine

    return examine(variant=variant, json=json)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    method = method_named(arguments)
    commands = {"capture": capture, "fit": fit_command(method), "view": view, "guess": guess, "render": render,
                "evaluate": evaluate, "compare": compare, "crosscheck": crosscheck, "leave-out": leave_out,
                "stability": stability, "bench": bench, "synth": synth, "pretrain": pretrain_command,
                "doctor": doctor, "export": export, "relight": relight, "report": report,
                "sheet": sheet, "demo": demo}
    if arguments == ["--version"]:
        say(f"mitsvbrdf {__version__}")
        return 0
    arguments = with_flags(arguments) if method == "hierarchical" else arguments
    return exit_code(
        lambda: tyro.extras.subcommand_cli_from_dict(
            commands, prog="mitsvbrdf", args=arguments, config=(FlagCreatePairsOff,),
            description="Recover the maps of a material (diffuse, specular, roughness, normal) from a few flash photos, "
                        "fitted through Mitsuba 3, without any training data."),
        "interrupted; what is unfinished goes on with --resume" if arguments[:1] in (["fit"], ["relight"]) else "interrupted")
