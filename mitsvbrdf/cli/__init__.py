"""The command line: parse, call, print, exit code.

Exit code 0: success; also a fit or relight that Ctrl-C ended, if there is a result. 1: a check failed, or a
part of the work failed. 2: the caller made a mistake. 130: Ctrl-C left no result, or left work undone.
Only the module of the chosen command is imported, so the list of commands loads neither torch nor Mitsuba.
"""

import ast
import functools
import importlib
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import LARGEST, ConfigError, exit_code, plain_warnings
from ..errors import strict as refused
from ..io.files import check_names
from ..io.signals import still_waiting
from .renamed import with_new_names

COMMANDS = ("capture", "fit", "batch", "library", "guess", "render", "evaluate", "compare", "crosscheck",
            "stability", "bench", "synth", "doctor", "export", "relight", "report", "sheet", "demo")
FITTING = ("fit", "batch")  # their options depend on the method
RESUMED = ("fit", "relight")  # --resume continues an unfinished run of these
MOST = {"resolution": 16384, "size": 16384, "repeats": 10_000, "frames": 100_000}  # for memory and time


def main(arguments: list[str] | None = None) -> int:
    """Run a command, and return the exit code. Default of ``arguments``: those of the process."""
    arguments = with_new_names(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        print(f"mitsvbrdf {__version__}")
        return 0
    resumed = bool(arguments) and arguments[0] in RESUMED
    unfinished = "; what is unfinished goes on with --resume" if resumed else ""
    with plain_warnings():
        return exit_code(lambda: _interruptible(arguments), "interrupted" + unfinished)


def _interruptible(arguments: list[str]) -> int:
    """Run a command. At its end, raise KeyboardInterrupt if Ctrl-C came during an import."""
    try:
        return _run(arguments)
    finally:
        if still_waiting():
            raise KeyboardInterrupt


def command(name: str, arguments: Sequence[str] = ()) -> Callable[..., int]:
    """The function of a command. ``fit``, ``batch``: ``arguments`` choose the method and so the options."""
    function = getattr(importlib.import_module(f".{name}", __name__), name)

    @functools.wraps(function)
    def checked(*values: Any, **options: Any) -> int:
        for option, value in inspect.signature(function).bind(*values, **options).arguments.items():
            check_numbers(option, value)
        with refused(options.get("strict", False) and name != "batch"):  # `batch` passes it to its workers
            return function(*values, **options)

    if name in FITTING:
        from .fit import settings
        return functools.partial(checked, config=settings(arguments))
    return checked


def check_numbers(name: str, value: object) -> None:
    """Raise ConfigError if a number of an option is NaN, or too large for every command."""
    if is_dataclass(value):
        for each in fields(value):
            check_numbers(each.name, getattr(value, each.name))
    elif isinstance(value, tuple):
        for each in value:
            check_numbers(name, each)
    elif isinstance(value, (int, float)) and not abs(value) <= (most := MOST.get(name, LARGEST)):
        raise ConfigError(f"--{name.replace('_', '-')} of at most {most:g}", str(value),
                          "give a number up to that")


def _run(arguments: list[str]) -> int:
    """Run the command named by the first argument. Else print all commands, an error or a completion."""
    import tyro

    check_names(*arguments)
    config = (tyro.conf.FlagCreatePairsOff,)
    name, *options = arguments or [""]
    if name in COMMANDS:
        try:
            check_names(os.getcwd())
        except FileNotFoundError:  # torch cannot be imported there
            raise ConfigError("a current folder", "one that was deleted",
                              "type cd to one that is there") from None
        if name in FITTING:
            from .fit import with_flags
            options = with_flags(options)
        return tyro.cli(command(name, options), prog=f"mitsvbrdf {name}", args=options, config=config)
    completion = any(word.startswith(("--tyro-print-comp", "--tyro-write-comp")) for word in arguments)
    commands = {each: command(each) if completion else _named_only(summary(each)) for each in COMMANDS}
    about = ("Recover the maps of a material (diffuse, specular, roughness, normal) from a few flash photos, "
             "fitted through Mitsuba 3, without any training data.")
    return tyro.extras.subcommand_cli_from_dict(commands, prog="mitsvbrdf", args=arguments, config=config,
                                                description=about)


def summary(name: str) -> str:
    """The first paragraph of a command's docstring, read without importing what the command needs."""
    module = ast.parse(Path(__file__).with_name(f"{name}.py").read_text(encoding="utf-8"))
    functions = (node for node in module.body if isinstance(node, ast.FunctionDef) and node.name == name)
    return " ".join((ast.get_docstring(next(functions)) or "").partition("\n\n")[0].split())


def _named_only(text: str) -> Callable[[], int]:
    """A stand-in for a command in the list of all commands: it has the help text, but is never called."""
    def other() -> int:
        raise AssertionError("only the chosen command is called")

    other.__doc__ = text
    return other
