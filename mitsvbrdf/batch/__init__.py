"""Many captures, one library: a batch on Ray that survives crashes.

The way of a capture: ``captures`` finds it. ``asked`` gives it options and an identity (a hash of photos and
options), and looks for its result in the library. ``run`` gives it to a Ray task of ``tasks``. ``fitting``
fits it in a warm worker. ``results`` publishes the whole result. ``library`` makes the page of all results.

The folders of a library are its only record: a capture is done if its result is there, whatever else is lost.
"""
