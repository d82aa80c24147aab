"""Renderers that must agree: what is wrong is named."""

import math
import re
from pathlib import Path

import pytest
import torch
from helpers import ANALYTIC
from helpers.golden_suite import TWO

from mitsvbrdf.errors import ConfigError
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.testing import assert_renderers_agree, random_material


class Wrong:
    """The float32 twin with something changed on the way in or out."""

    name = "wrong"

    def __init__(self, maps=lambda maps: maps, image=lambda image: image):
        self.twin, self.maps, self.image = ANALYTIC, maps, image

    def render(self, svbrdf, views):
        return self.image(self.twin.render(SVBRDF(svbrdf.bsdf, self.maps(dict(svbrdf.maps))), views))


def with_gradient_off(name, factor):
    """The same values of a map, with a gradient that is off by this factor."""
    return lambda maps: maps | {name: maps[name] * factor - maps[name].detach() * (factor - 1)}


WIDE = {"image_mean": 1e-5, "image_p999": 1e-4, "gradients": 1e-4}


@pytest.mark.parametrize("bsdf", ["roughconductor", "principled"])
def test_renderers_that_agree_pass_and_leave_no_page(bsdf, report):
    assert_renderers_agree(random_material(bsdf, 16), TWO, ("analytic", Wrong()), **WIDE)
    assert not report.exists()


def test_a_wrong_gradient_is_named(report):
    wrong = Wrong(with_gradient_off("roughness", 1.01))
    with pytest.raises(AssertionError) as caught:
        assert_renderers_agree(random_material("roughconductor", 16), TWO, ("analytic", wrong), **WIDE)
    lines = str(caught.value).splitlines()
    assert lines[0] == "wrong differs from analytic64"
    assert lines[1] == "  wrong: gradient of roughness, relative L2: 0.01, limit 0.0001"
    assert lines[2].startswith("  page: ") and len(lines) == 3  # nothing else is off
    text = Path(lines[2].removeprefix("  page: ")).read_text()
    assert text.count("wrong: ") == 6 and text.count("analytic: ") == 6  # all figures of both
    assert text.count('class="text bad"') == 1
    assert text.count("data:image/png") == 2 * 3 + 4 * 3  # two views and four gradients, three pictures each
    assert not re.search(r"""(src|href)=["'](?!data:)""", text)  # self-contained


@pytest.mark.parametrize("image, missed", [
    (lambda x: x * 1.001, ["image, mean relative error: 0.001", "image, 99.9 % of the values within: 0.001"]),
    (lambda x: x * torch.where(torch.arange(x.numel()).reshape(x.shape) % 700 == 0, 1.01, 1.0),
     ["image, mean relative error: 1.9", "image, 99.9 % of the values within: 0.01"]),
    (lambda x: x * torch.where(torch.arange(x.numel()).reshape(x.shape) == 5, torch.nan, 1.0),
     ["image, mean relative error: nan"])])
def test_a_wrong_image_is_named(image, missed, report):
    with pytest.raises(AssertionError) as caught:
        assert_renderers_agree(flat(16), TWO, [Wrong(image=image)], **(WIDE | {"gradients": math.inf}))
    lines = str(caught.value).splitlines()[1:-1]
    assert len(lines) == len(missed)
    for line, start in zip(lines, missed):
        assert line.startswith(f"  wrong: {start}")


def test_an_infinite_limit_asks_for_no_gradient(report):
    undifferentiable = Wrong(image=torch.Tensor.detach)
    limits = {"image_mean": 1e-5, "image_p999": 1e-4}
    assert_renderers_agree(flat(8), TWO, [undifferentiable], gradients=math.inf, **limits)
    with pytest.raises(ConfigError, match="gradients=math.inf"):
        assert_renderers_agree(flat(8), TWO, [undifferentiable], gradients=1.0, **limits)


def test_gradients_that_are_both_zero_agree(report):
    dark = Wrong(lambda maps: maps | {"normal": maps["normal"] * torch.tensor([1.0, 1.0, -1.0])})
    assert_renderers_agree(flat(8), TWO, [dark], reference=dark, **WIDE)
    with pytest.raises(AssertionError, match="gradient of diffuse, relative L2: inf"):
        assert_renderers_agree(flat(8), TWO, ["analytic"], reference=dark, **WIDE)


@pytest.mark.parametrize("renderers, limits, said", [
    ([Wrong()], {"image_mean": 1.0}, "limits for the renderer 'wrong'"), ([], WIDE, "one renderer or more"),
    ([Wrong()], dict.fromkeys(WIDE, math.inf), "not all infinite"),
    (["analytic"], {"gradients": math.nan}, ">= 0"), (["analytic"], {"image_mean": -1.0}, ">= 0")])
def test_an_agreement_of_nothing_is_refused(renderers, limits, said, report):
    with pytest.raises(ConfigError, match=said):
        assert_renderers_agree(flat(8), TWO, renderers, **limits)


def test_a_page_that_cannot_be_written_does_not_hide_the_failure(report):
    report.write_text("a file where the folder should be")
    with pytest.raises(AssertionError,
                       match=r"image, mean relative error: 0\.01(.|\n)*page: none \(expected to write"):
        assert_renderers_agree(flat(8), TWO, [Wrong(image=lambda x: x * 1.01)], **WIDE)
