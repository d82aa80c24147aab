"""Many captures, one library: a batch that survives what may die, on Ray.

The way of a capture: it is named (``captures``), gets options and an identity and is looked for in the
library (``asked``), handed out (``run``) to a task of Ray (``tasks``), fitted in a warm worker
(``fitting``), and appears whole (``results``). ``library`` tells what lies there, and makes its page.

The folders of a library are its only record: a result that lies there is done, whatever else was lost.
"""
