"""Somebody else's test suite with golden files."""

import flip_evaluator  # noqa: F401  (what is loaded here stays loaded after the small suites in this process)

from mitsvbrdf.views import nine_view_grid

PLUGIN = "mitsvbrdf.testing.plugin"
TWO = nine_view_grid().pick([0, 4])
FOREIGN = """
    import torch
    from mitsvbrdf.material.maps import flat
    from mitsvbrdf.testing import assert_matches_golden

    def test_picture():
        assert_matches_golden(torch.full((4, 5, 3), {grey}), "grey")

    def test_views():
        assert_matches_golden(torch.rand({shape}, generator=torch.Generator().manual_seed(0)), "views")

    def test_maps():
        assert_matches_golden(flat(4, roughness={roughness}), "maps")
"""

class Suite:
    """A tiny test suite of somebody else, and where its golden files and pages go."""

    def __init__(self, pytester):
        self.pytester, self.folder = pytester, pytester.path
        self.golden, self.report = self.folder / "golden" / "test_foreign", self.folder / ".mitsvbrdf-report"

    def write(self, grey=0.5, shape=(2, 4, 4, 3), roughness=0.5):
        self.pytester.makepyfile(test_foreign=FOREIGN.format(grey=grey, shape=shape, roughness=roughness))
        return self

    def run(self, *options, **outcomes):
        done = self.pytester.runpytest("-p", PLUGIN, "-p", "no:cacheprovider", *options)
        done.assert_outcomes(**outcomes)
        return done.stdout.str()

    def kept(self):
        return {path.name: path.read_bytes() for path in self.golden.iterdir()}
