"""The mutation script still fits the source: each line it breaks is there, once."""

import pytest
from mutate import MUTATIONS, broken


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.name)
def test_mutations_apply(mutation, tmp_path):
    changed = broken(mutation, tmp_path / "copy") / "mitsvbrdf" / mutation.file
    assert mutation.wrong in changed.read_text()
