"""What is left out of a render and of a fit: what each thing saves and costs, as docs/leave-out.md shows it.

:mod:`.renders` lists what a scene may do without, :mod:`.parts` what a fit may; :mod:`.scenes` makes the
photos that are fitted, :mod:`.fits` measures each part, :mod:`.plan` lists all jobs, :mod:`.verdict` judges
their records, and :mod:`.page` shows them, :mod:`.in_short` in words first. ``mitsvbrdf leave-out`` runs
them.
"""
