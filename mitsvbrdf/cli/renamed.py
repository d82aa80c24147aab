"""Old names of commands and options. Help omits them. They work for one version; the new name is printed."""

import sys
from collections.abc import Sequence

# An option renamed in several commands has an entry in each. For a flag that help shows as --no-NAME, the
# entry has that form.
RENAMED_COMMANDS = {"pretrain": "fit --method gan --preset paper-two-stage --pretrain"}
FIT = {"--own": "--detail-spread", "--tails": "--highlight-reach", "--likeness": "--similarity",
       "--no-independent": "--no-remove-burn-in", "--no-rivals": "--no-multi-start", "--finish": "--detail",
       "--finish-steps": "--detail-steps"}
RENAMED: dict[str, dict[str, str]] = {"fit": FIT, "batch": FIT, "bench": {"--left-out": "--held-out"}}


def with_new_names(arguments: Sequence[str]) -> list[str]:
    """Replace old names of commands and options in the arguments. Print each once, on standard error.

    Unchanged: a value after ``=``, as in ``--tag=--own``, and all words after ``--``.
    """
    place = next((i for i, word in enumerate(arguments) if not word.startswith("-")), None)
    if place is None:
        return list(arguments)
    found = list(arguments)
    command = found[place].replace("_", "-")
    if command in RENAMED_COMMANDS:
        _say(command, RENAMED_COMMANDS[command])
        found[place:place + 1] = RENAMED_COMMANDS[command].split()
        command = found[place]
    options, said = RENAMED.get(command, {}), set[str]()
    for i, word in enumerate(found):
        if word == "--":
            break
        name, equals, value = word.partition("=")
        old = name.replace("_", "-")  # both spellings are options
        if old in options:
            if old not in said:
                _say(old, options[old])
            said.add(old)
            found[i] = options[old] + equals + value
    return found


def _say(old: str, new: str) -> None:
    print(f"{old} is now {new}", file=sys.stderr)
