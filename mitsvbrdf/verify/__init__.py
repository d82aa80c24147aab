"""Renderers compared with float64: ``crosscheck`` on given maps, ``stability`` at the ends of every range."""
