"""Fits that are asked too much: extreme materials, wrong calibration, photos that say little, and several of
these at once.

:mod:`.scenes` lists what is photographed and what of it a fit is told, :mod:`.fits` does the fits,
:mod:`.verdict` judges each, :mod:`.tables`, :mod:`.plots` and :mod:`.page` write docs/stability-fits.md.
``mitsvbrdf stability --fits`` runs them.
"""
