"""Tools that all commands share. They know nothing of materials.

``files`` locks files and writes them whole or not at all, ``results`` does so for a folder of results, and
``manifest`` lists the folder's files. ``json`` reads JSON, ``decode`` photos, ``images`` reads and writes
pictures. ``progress`` talks to the user, ``streams`` keeps a full disk from ending a command, ``signals``
listens for Ctrl-C. ``timing`` times jobs, ``provenance`` names the machine and the versions.
"""

from collections.abc import Callable

Report = Callable[[str, float], object]  # takes what is going on, and the share done (0 to 1)
