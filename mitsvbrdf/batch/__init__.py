"""Many captures, one library: a batch that survives what may die, on Ray.

Three processes. The *supervisor*, the command itself, has the manifest and decides who fits what (``schedule``, ``run``). The
*gateway* talks to Ray, and is started anew when it or Ray's head dies (``pool``, ``gateway``). A *worker* is a Ray actor that
keeps one warm ``child`` and watches it (``guard``). ``place`` is where results appear whole, ``library`` what they add up to.
"""
