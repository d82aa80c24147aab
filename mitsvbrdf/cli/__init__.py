"""The command line: parse, call, print, exit code.

0 is success, and a fit that Ctrl-C ended early; 1 a check that does not hold; 2 a mistake the caller can
mend; 130 Ctrl-C without a result. Where standard output is full or closed the work goes on, and its exit code
stays; 2 where what is printed is the result. Only the module of the chosen command is imported: words about
commands load neither torch nor Mitsuba.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from types import ModuleType
from typing import Any, get_type_hints

from .. import __version__
from ..errors import LARGEST, ConfigError, exit_code, plain_warnings
from ..errors import strict as refused
from ..io.files import check_names
from .renamed import with_new_names

# What each command does, the first line of its docstring.
COMMANDS = {
    "capture": "Make a capture of raw photos, for `mitsvbrdf fit`: find out where the phone was, rectify, "
               "leave bad photos out.",
    "fit": "Recover the maps of a material from photos.",
    "batch": "Fit many captures into one library, whatever dies on the way.",
    "library": "Look through a library of materials: list, check, export or tidy up what `mitsvbrdf batch` "
               "made.",
    "guess": "Make the guessed diffuse map only: OUT/diffuse.exr and .png.",
    "render": "Render maps for the views of a capture: OUT/NN.png (display values) and NN.exr (linear).",
    "evaluate": "Measure maps: against known maps (--reference) or against photos (--capture).",
    "compare": "Show maps of several methods side by side: input, maps, errors, and every photo beside its "
               "re-renderings.",
    "crosscheck": "Hold every renderer and BSDF against the float64 twin: images, gradients, run time.",
    "stability": "Sweep every parameter to its ends: errors, gradients, conditioning, step sizes, and a "
                 "verdict on "
                 "each renderer.",
    "bench": "Measure error against run time: methods x materials and captures x budgets x seeds.",
    "synth": "Take photos of known maps: rectified ones with their calibration, to test fits on, or raw "
             "ones by a "
             "simulated phone.",
    "pretrain": "First stage of the paper's two-stage training: the generator learns from one picture with "
                "global features.",
    "doctor": "Show what is installed, prove libLLVM in a child process, and say what is missing and how to "
              "get it.",
    "export": "Write a material for other programs: OUT/FORMAT/, with an export.json that states what each "
              "file holds.",
    "relight": "Show a material under other light, path traced with Mitsuba: stills as EXR and PNG, movies "
               "as MP4 and GIF.",
    "report": "Write OUT/report.html, one page about a fit that opens from disk, and its numbers, "
              "OUT/report.json.",
    "sheet": "Write a sheet of AprilTags to print: laid around a material, it tells `mitsvbrdf capture "
             "--sheet CM` where the "
             "phone was.",
    "demo": "Photograph a made material, recover it, and compare with the truth; about two minutes.",
}
FITTING = ("fit", "batch")  # these have the options of the methods
READING = ("capture", "fit", "batch", "guess", "render", "evaluate", "compare", "pretrain", "export",
           "relight", "report")
# what takes memory, or days
MOST = {"resolution": 16384, "size": 16384, "repeats": 10_000, "frames": 100_000}
RESUMED = ("fit", "relight")  # what these leave unfinished goes on with --resume
# what these print is their result
PRINTING = ("library", "evaluate", "crosscheck", "stability", "doctor")
PRINTS = ("--help", "-h", "--explain", "--check")  # with these so do all others


def main(arguments: list[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: of the process where left out.

    Returns:
        The exit code.
    """
    arguments = with_new_names(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        print(f"mitsvbrdf {__version__}")
        return 0
    unfinished = ("; what is unfinished goes on with --resume" if arguments[:1] and arguments[0] in RESUMED
                  else "")
    with plain_warnings():
        return exit_code(lambda: _run(arguments), "interrupted" + unfinished)


def command(name: str, arguments: Sequence[str] = ()) -> Callable[..., int]:
    """The function of a command; ``fit`` and ``batch`` have the options of the method that the arguments
    name.
    """
    function = getattr(_module(name), name.replace("-", "_"))
    if name in FITTING:
        from .fit import fit_command
        function = fit_command(arguments, function)
    return _guarded(function, strict=name in READING)


def _guarded(function: Callable[..., int], strict: bool) -> Callable[..., int]:
    """A command whose numbers are checked before it begins; where wanted, with ``--strict`` beside its
    options.
    """
    from .options import Strict

    signature, hints = inspect.signature(function), get_type_hints(function, include_extras=True)
    parameters = list(signature.parameters.values())
    if strict := strict and "strict" not in signature.parameters:  # `batch` tells its workers itself
        parameters.append(inspect.Parameter("strict", inspect.Parameter.KEYWORD_ONLY, default=False,
                                            annotation=Strict))
        hints["strict"] = Strict

    def command(*values: Any, **options: Any) -> int:
        for name, value in (*zip(signature.parameters, values), *options.items()):
            _check_numbers(name, value)
        with refused(options.pop("strict") if strict else False):
            return function(*values, **options)

    command.__doc__ = function.__doc__
    command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    command.__annotations__ = hints
    return command


def _check_numbers(name: str, value: object) -> None:
    """Raise ConfigError for an option that no command can do anything with."""
    if is_dataclass(value):
        for each in fields(value):
            _check_numbers(each.name, getattr(value, each.name))
    elif isinstance(value, (int, float)) and not abs(value) <= (most := MOST.get(name, LARGEST)):
        raise ConfigError(f"--{name.replace('_', '-')} of at most {most:g}", str(value),
                          "give a number up to that")


def load(arguments: Sequence[str]) -> None:
    """Import what the command that the arguments name needs in any case."""
    if _chosen(arguments) in COMMANDS:
        importlib.import_module("tyro")
        _module(_chosen(arguments))


def only_prints(arguments: Sequence[str]) -> bool:
    """Whether what these arguments ask for comes on standard output, and not as files alone."""
    return (_chosen(arguments) in PRINTING or _chosen(arguments) not in COMMANDS
            or bool(set(PRINTS) & set(arguments)))


def _module(name: str) -> ModuleType:
    return importlib.import_module(f".{name.replace('-', '_')}", __name__)


def _chosen(arguments: Sequence[str]) -> str:
    """The command named, or an empty text; tyro takes both spellings."""
    return next((word for word in arguments if not word.startswith("-")), "").replace("_", "-")


def _run(arguments: list[str]) -> int:
    """Parse the arguments with the chosen command's options, every other command known by name and help
    alone.
    """
    import tyro

    check_names(*arguments)
    # the folder we are in was removed, or a word can be no name at all
    with contextlib.suppress(OSError, ValueError):
        # where links lead
        check_names(os.getcwd(), *(os.path.realpath(word.rpartition("=")[2]) for word in arguments))
    completion = any(word.startswith(("--tyro-print-completion", "--tyro-write-completion"))
                     for word in arguments)
    commands = {name: command(name) if completion else _named_only(text) for name, text in COMMANDS.items()}
    chosen = _chosen(arguments)
    if chosen in COMMANDS:
        commands[chosen] = command(chosen, arguments)
    if chosen in FITTING:
        from .fit import with_flags
        arguments = with_flags(arguments)
    if chosen in COMMANDS and arguments[0].replace("_", "-") == chosen:  # its mistakes then name its own help
        return tyro.cli(commands[chosen], prog=f"mitsvbrdf {chosen}", args=arguments[1:],
                        config=(tyro.conf.FlagCreatePairsOff,))
    return tyro.extras.subcommand_cli_from_dict(
        commands, prog="mitsvbrdf", args=arguments, config=(tyro.conf.FlagCreatePairsOff,),
        description="Recover the maps of a material (diffuse, specular, roughness, normal) from a few flash "
                    "photos, "
                    "fitted through Mitsuba 3, without any training data.")


def _named_only(text: str) -> Callable[[], int]:
    """Stands for a command that was not chosen: its help, and nothing to call."""
    def other() -> int:
        raise AssertionError("only the chosen command is called")

    other.__doc__ = text
    return other
