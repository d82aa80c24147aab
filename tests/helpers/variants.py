"""Variants of a test of which some run always and all others in the slow suite."""

from collections.abc import Iterable

import pytest


def mostly_slow(values: Iterable, *quick: object) -> list:
    """Values for ``parametrize``; those that are not named as quick, by themselves or by their first one, are
    marked slow.
    """
    found, names = [], set()
    for value in values:
        row = value if isinstance(value, tuple) else (value,)
        names.add(row[0])
        found.append(pytest.param(*row, marks=[] if row[0] in quick else pytest.mark.slow))
    assert names >= set(quick), f"no variant is called {set(quick) - names}"
    return found
