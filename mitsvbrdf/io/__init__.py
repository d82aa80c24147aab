"""Tools that all commands share, independent of materials.

``files`` locks files and writes them whole or not at all. ``results`` does the same for a result folder;
``manifest`` lists its files. ``json`` reads JSON, ``decode`` decodes photos, ``images`` reads and writes
pictures. ``progress`` prints progress and tables, ``streams`` keeps a command running when the disk is full,
``signals`` handles Ctrl-C. ``timing`` times jobs, ``provenance`` names the machine and the versions.
"""

from collections.abc import Callable

Report = Callable[[str, float], object]  # called with the current step, and the share done (0 to 1)
