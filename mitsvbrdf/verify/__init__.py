"""The renderers against float64: ``crosscheck`` of given maps, ``stability`` at the ends of every range."""
