"""Many captures, one library: a batch that survives what may die, on Ray.

The way of a capture: it is named (``entries``), gets an identity (``identity``, ``prepare``), waits in the
``manifest``, is handed out (``schedule``, ``run``), fitted (``child``), and appears whole (``places``); what
came of all is the ``library``.

Three processes. The *supervisor*, the command itself, has the manifest and decides who fits what. The
*gateway* talks to Ray, and is started anew when it or Ray's head dies. A *worker* is a Ray actor that keeps
one warm child and watches it (``workers``). ``planning`` measures and simulates a large batch before it is
run.
"""
