"""What every command needs of the machine, and nothing of materials.

``files`` writes whole or not at all and locks, ``results`` does the same for a folder of results, whose files
``manifest`` lists. ``json`` reads JSON, ``decode`` photos, ``images`` reads and writes pictures. ``progress``
talks to the user, ``streams`` lets no full disk end that, ``signals`` listens for Ctrl-C. ``timing``
compares jobs, ``provenance`` names the machine and the versions.
"""

from collections.abc import Callable

Report = Callable[[str, float], object]  # is told what is going on, and the share done
