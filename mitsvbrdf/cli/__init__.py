"""The command line: parse, call, print, exit code.

0 is success, and a fit that Ctrl-C ended early; 1 a check that does not hold; 2 a mistake the caller can mend; 130
Ctrl-C without a result. Only the module of the chosen command is imported: help on commands loads neither torch nor
Mitsuba.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from .. import __version__
from ..errors import LARGEST, ConfigError, exit_code, plain_warnings
from ..errors import strict as refused
from ..io.files import check_names
from .renamed import with_new_names

# What each command does, the first line of its docstring.
COMMANDS = {
    "capture": "Make a capture of raw photos for `mitsvbrdf fit`: find the poses of the phone, rectify, "
               "reject bad photos.",
    "fit": "Recover the maps of a material from photos.",
    "batch": "Fit many captures into one library, whatever dies on the way.",
    "library": "Look through a library of materials: list, check, export or tidy up what `mitsvbrdf batch` "
               "made.",
    "guess": "Guess the diffuse map, without a fit: OUT/diffuse.exr and diffuse.png.",
    "render": "Render maps for the views of a capture: OUT/NN.png (display values) and NN.exr (linear).",
    "evaluate": "Measure maps: against known maps (--reference) or against photos (--capture).",
    "compare": "Show maps of several methods side by side: input, maps, errors, and every photo beside its "
               "re-renderings.",
    "crosscheck": "Compare every renderer and BSDF with the float64 twin: images, gradients, run time.",
    "stability": "Sweep every parameter to its ends and give a verdict on each renderer.",
    "bench": "Measure error against run time: methods x materials and captures x budgets x seeds.",
    "synth": "Take photos of known maps: rectified photos with their calibration, or raw photos of a "
             "simulated phone.",
    "doctor": "Show what is installed, prove libLLVM in a child process, and say what is missing and how to "
              "get it.",
    "export": "Write a material for other programs: OUT/FORMAT/, with an export.json that states what each "
              "file holds.",
    "relight": "Show a material under other light, path traced with Mitsuba.",
    "report": "Write OUT/report.html, one page about a fit that opens from disk, and its numbers, "
              "OUT/report.json.",
    "sheet": "Write a sheet of AprilTags to print.",
    "demo": "Photograph a made material, recover it, and compare with the truth; about two minutes.",
}
FITTING = ("fit", "batch")  # these have the options of the methods
RESUMED = ("fit", "relight")  # what these leave unfinished goes on with --resume
MOST = {"resolution": 16384, "size": 16384, "repeats": 10_000, "frames": 100_000}  # what takes memory, or days


def main(arguments: list[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: the command and its options; of the process by default.

    Returns:
        The exit code.
    """
    arguments = with_new_names(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        print(f"mitsvbrdf {__version__}")
        return 0
    unfinished = "; what is unfinished goes on with --resume" if arguments[:1] and arguments[0] in RESUMED else ""
    with plain_warnings():
        return exit_code(lambda: _run(arguments), "interrupted" + unfinished)


def command(name: str, arguments: Sequence[str] = ()) -> Callable[..., int]:
    """The function of a command; ``fit`` and ``batch`` have the options of the method that the arguments name."""
    function = getattr(importlib.import_module(f".{name}", __name__), name)
    if name in FITTING:
        from .fit import fit_command
        function = fit_command(arguments, function)

    @functools.wraps(function)
    def checked(*values: Any, **options: Any) -> int:
        for option, value in inspect.signature(function).bind(*values, **options).arguments.items():
            _check_numbers(option, value)
        with refused(options.get("strict", False) and name != "batch"):  # `batch` tells its workers
            return function(*values, **options)

    return checked


def _check_numbers(name: str, value: object) -> None:
    """Raise ConfigError for an option that no command can do anything with."""
    if is_dataclass(value):
        for each in fields(value):
            _check_numbers(each.name, getattr(value, each.name))
    elif isinstance(value, (int, float)) and not abs(value) <= (most := MOST.get(name, LARGEST)):
        raise ConfigError(f"--{name.replace('_', '-')} of at most {most:g}", str(value), "give a number up to that")


def _check_here() -> None:
    """Raise ConfigError for a current folder that cannot be named; torch does not even load in a deleted one."""
    try:
        check_names(os.getcwd())
    except FileNotFoundError:
        raise ConfigError("a current folder", "one that was deleted", "type cd to one that is there") from None


def _run(arguments: list[str]) -> int:
    """Parse the arguments with the options of the command they begin with; without one, show all commands."""
    import tyro

    check_names(*arguments)
    config = (tyro.conf.FlagCreatePairsOff,)
    name, *options = arguments or [""]
    if name in COMMANDS:
        _check_here()
        if name in FITTING:
            from .fit import with_flags
            options = with_flags(options)
        return tyro.cli(command(name, options), prog=f"mitsvbrdf {name}", args=options, config=config)
    completion = any(word.startswith(("--tyro-print-completion", "--tyro-write-completion")) for word in arguments)
    commands = {each: command(each) if completion else _named_only(text) for each, text in COMMANDS.items()}
    return tyro.extras.subcommand_cli_from_dict(
        commands, prog="mitsvbrdf", args=arguments, config=config,
        description="Recover the maps of a material (diffuse, specular, roughness, normal) from a few flash photos, "
                    "fitted through Mitsuba 3, without any training data.")


def _named_only(text: str) -> Callable[[], int]:
    """Stands for a command in the list of all: its help, and nothing to call."""
    def other() -> int:
        raise AssertionError("only the chosen command is called")

    other.__doc__ = text
    return other
