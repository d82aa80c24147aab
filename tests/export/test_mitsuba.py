"""Scenes that plain Mitsuba renders."""

import numpy as np
import torch
from helpers import GRID

from mitsvbrdf.export import export_material
from mitsvbrdf.render.analytic import AnalyticRenderer


def test_mitsuba_renders_the_scene_and_its_material_as_the_float64_twin(material, tmp_path, two_threads):
    from mitsvbrdf.render.llvm import mitsuba_module

    mi, views = mitsuba_module(), GRID.pick([3])
    export_material(material, tmp_path, ["mitsuba"], views=views)
    scene = mi.load_file(str(tmp_path / "mitsuba" / "scene.xml"))
    expected = AnalyticRenderer(torch.float64).render(material, views)[0].numpy()
    shown = np.array(mi.render(scene))
    assert np.abs(shown - expected).max() < 1e-3 * expected.max()  # measured 1.7e-6

    at = mi.ScalarTransform4f()
    same = mi.load_dict({"type": "scene", "integrator": scene.integrator(), "sensor": scene.sensors()[0],
                         "emitter": scene.emitters()[0],
                         "patch": {"type": "rectangle", "to_world": at.scale(0.5),
                                   "bsdf": scene.shapes()[0].bsdf()}})
    assert np.array_equal(np.array(mi.render(same)), shown)
