"""A child for the guard's tests: it does what the task's capture says, and imports nothing that is slow.

A capture is words that are run one after the other: ``print:TEXT``, ``sleep:S``, ``take:MIB``, ``free``,
``below:S`` (a process of its own that sleeps), ``abort``, ``exit:CODE``, ``kill:NUMBER``, ``close`` (its
pipe, and sleep), ``say:TEXT`` (not JSON), ``environment:NAME``, ``fail:REASON``. The row says the pid, how
many tasks it had, and what ``below`` started.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

from mitsvbrdf.batch.workers.guard import die_with_parent

held: list[bytearray] = []
READ, WRITE = int(sys.argv[-2]), int(sys.argv[-1])


def act(word: str, row: dict) -> None:
    name, _, value = word.partition(":")
    if name == "print":
        print(value)
    elif name == "sleep":
        time.sleep(float(value))
    elif name == "take":
        held.append(bytearray(os.urandom(1 << 20) * int(value)))
    elif name == "free":
        held.clear()
    elif name == "below":
        row["below"] = subprocess.Popen([sys.executable, "-S", "-c", f"import time; time.sleep({value})"]).pid
        print(row["below"])
    elif name == "abort":
        os.abort()
    elif name == "exit":
        os._exit(int(value))
    elif name == "kill":
        os.kill(os.getpid(), int(value))
    elif name == "close":
        os.close(WRITE)
        time.sleep(600)
    elif name == "say":
        os.write(WRITE, value.encode() + b"\n")
    elif name == "environment":
        row[value] = os.environ.get(value)
    elif name == "fail":
        raise RuntimeError(value)


def main() -> None:
    die_with_parent()
    if "--stillborn" in sys.argv:
        sys.exit("no luck")
    os.write(WRITE, b'{"ready": true}\n')
    for number, line in enumerate(os.fdopen(READ), 1):
        row = {"pid": os.getpid(), "number": number}
        answer = {"state": "done", "reason": "", "row": row}
        try:
            for word in json.loads(line)["task"]["capture"].split():
                act(word, row)
        except RuntimeError as reason:
            answer = {"state": "failed", "reason": str(reason), "row": None}
        os.write(WRITE, json.dumps(answer).encode() + b"\n")


if __name__ == "__main__":
    main()
