"""What every command needs of the machine, and nothing of materials.

``files`` writes whole or not at all, ``result_folder`` does the same for a folder of results, by the moves in
``journal``; ``shared_file`` lets several processes change one file. ``json_files`` reads JSON, ``decode``
photos, ``images`` reads and writes pictures. ``progress`` talks to the user, ``streams`` lets no full disk
end that, ``interrupts`` listens for Ctrl-C. ``profile`` says where a fit's time goes, ``timing`` compares
jobs, ``provenance`` says on which machine and with which versions.
"""
