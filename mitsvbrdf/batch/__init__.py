"""Many captures, one library: a batch on Ray that survives crashes.

The way of a capture: ``captures`` finds it. ``asked`` gives it options and an identity, and looks for its
result in the library. ``run`` hands it out to a Ray task of ``tasks``. ``fitting`` fits it in a warm worker,
and ``results`` publishes the result as a whole. ``library`` lists the results and makes the page.

The folders of a library are its only record: a result that lies there is done, whatever else was lost.
"""
