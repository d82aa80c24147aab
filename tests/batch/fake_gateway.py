"""A gateway for the pool's tests, without Ray: two workers whose tasks' captures say what happens.

``done``; ``lose`` (that worker, and a new one comes); ``die`` (the gateway, as if killed); ``half`` (dies in
the midst of a line); ``never`` (nothing happens). Behind the name of a file, the ways in which the starts go,
one a line: ``up``, ``failed``, ``die``, ``stuck`` (deaf to orders and to SIGTERM); the last one is for all
later starts.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

plan, events = Path(sys.argv[1]), int(sys.argv[2])


def say(**event: object) -> None:
    os.write(events, json.dumps({"is": event.pop("what")} | event).encode() + b"\n")


def up(number: int) -> None:
    say(what="worker", worker=f"w{number}", host="here", pid=os.getpid(), version="0")


def main() -> None:
    ways = plan.read_text().split()
    plan.write_text("\n".join(ways[1:] or ways))
    number = 0
    for line in sys.stdin:
        order = json.loads(line)
        if order["do"] == "start" and ways[0] == "failed":
            say(what="failed", reason="no luck", fix="try again")
            sys.exit(2)
        if order["do"] == "start" and ways[0] == "die":
            sys.exit(3)
        if order["do"] == "stop":
            sys.exit(0)
        if order["do"] == "start":
            number = order["first"] + 1
            up(number - 1)
            up(number)
            if ways[0] == "stuck":
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
                time.sleep(600)
            continue
        capture, told = order["task"]["capture"], {"worker": order["worker"],
                                                   "attempt": order["task"]["attempt"]}
        if capture == "done":
            say(what="done", outcome={"state": "done"}, **told)
        elif capture == "lose":
            say(what="lost", reason="hit by a stone", **told)
            number += 1
            up(number)
        elif capture == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        elif capture == "half":
            os.write(events, b'{"is": "do')
            sys.exit(3)


main()
