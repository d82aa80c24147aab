"""Error against run time, of renderers, methods and captures: what docs/benchmark.md shows.

Jobs (``jobs``: ``renderers``, fits of the ``methods`` on ``tasks``, ``from_phone``, ``start``) become
records, one after the other or several at a time (``parallel``); ``behaviour`` says which need not run,
``code`` which changes void which; ``store`` keeps the ``records`` in one JSON, checked by ``schema``;
``summary`` takes medians over seeds; ``tables``, ``times``, ``plots`` and ``page`` show them beside
``published`` numbers, and ``paper`` makes docs/results/gan.md of them. ``stiff`` keeps fits that are asked
too much in a file of the same kind, and makes docs/stability-fits.md of it; so does ``leave_out`` with what
is left out, and docs/leave-out.md.
"""
