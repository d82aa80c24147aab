"""Maps held fixed, grey specular, losses of weight 0: nothing is computed for them."""

import json

import pytest
import torch
from helpers import ANALYTIC, GRID
from helpers.variants import mostly_slow

from mitsvbrdf import cli, color
from mitsvbrdf.capture import Capture
from mitsvbrdf.errors import ConfigError, MapsError
from mitsvbrdf.fit import DirectConfig, FitTask, GanConfig, HybridConfig, fit_svbrdf, losses, make_method
from mitsvbrdf.fit.fixed_maps import fixed_maps
from mitsvbrdf.fit.omitted import omitted_by
from mitsvbrdf.io import images
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.material.maps import CHANNELS, flat
from mitsvbrdf.render import make_renderer

SIDE = 16
METHODS = {"hybrid": HybridConfig, "direct": DirectConfig, "gan": GanConfig}
NARROW = {"hybrid": {"width": 4}, "direct": {}, "gan": {"width": 4, "preset": "paper-one-stage"}}


def config_of(method, **settings):
    return METHODS[method](**NARROW[method], **settings)


def unknowns(method):
    """How many numbers the optimisers move."""
    optimizers = [value for value in vars(method).values() if isinstance(value, torch.optim.Optimizer)]
    optimizers += list(getattr(method, "optimizers", {}).values())
    return sum(p.numel() for o in optimizers for group in o.param_groups for p in group["params"])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("renderer", ["analytic", "mitsuba"])
def test_what_is_held_comes_out_as_it_went_in(method, renderer, leather):
    fix = ("normal=flat", "specular=0.2,0.3,0.4", "roughness=0.35")
    result = fit_svbrdf(leather, make_renderer(renderer), config_of(method, fix=fix, iterations=3))
    wanted = {"normal": (0.0, 0.0, 1.0), "specular": (0.2, 0.3, 0.4), "roughness": (0.35,)}
    for name, value in wanted.items():
        assert torch.equal(result.svbrdf[name], torch.tensor(value).expand_as(result.svbrdf[name])), name
    assert set(result.deviations) == {"diffuse"}  # of the others there is nothing to be unsure about
    said = dict(result.omitted)
    assert said["gradient of normal"] == "held at flat" and said["gradient of roughness"] == "held at 0.35"
    assert "gradient of diffuse" not in said


@pytest.mark.parametrize("method", METHODS)
def test_nothing_is_allocated_for_a_map_that_is_held(method, leather):
    renderer, guess = ANALYTIC, torch.full((SIDE, SIDE, 3), 0.2)
    everything = unknowns(make_method(FitTask(leather, renderer, config_of(method), guess)))
    made = make_method(FitTask(leather, renderer, config_of(method, fix=("normal=flat", "specular=0.04")),
                               guess))
    channels = 3 if method == "gan" else 5  # two slopes and three specular levels, or one
    if method == "direct":
        assert everything - unknowns(made) == channels * SIDE**2
    elif method == "hybrid":  # the last layers are 1 x 1 convolutions of 4 channels, with a bias
        assert everything - unknowns(made) == channels * (4 + 1)
    else:  # 4 x 4 deconvolutions of 2 x 4 channels, with a bias
        assert everything - unknowns(made) == channels * (8 * 16 + 1)
    # A whole stream held: its decoder is not there.
    whole = make_method(FitTask(leather, renderer, config_of(method, fix=("normal=flat", "roughness=0.5")),
                                guess))
    if method == "hybrid":
        assert len(whole.generator.up) == 1
    if method == "gan":
        assert whole.generator.normal_roughness is None and set(whole.optimizers) == {"slow", "judge"}
        assert all(torch.isfinite(torch.tensor(list(whole.step(0.0).values()))))
    # constants: one value or colour
    assert all(value.untyped_storage().nbytes() <= 12 for value in whole.fixed.values())


@pytest.mark.parametrize("method", mostly_slow(METHODS, "direct"))
def test_one_grey_specular_level(method, leather):
    settings = config_of(method, grey_specular=True, iterations=3)
    made = make_method(FitTask(leather, make_renderer("analytic"), settings,
                               torch.full((SIDE, SIDE, 3), 0.2)))
    seen = []
    render = made.renderer.render
    made.renderer.render = lambda svbrdf, views: (seen.append(svbrdf["specular"]), render(svbrdf, views))[1]
    made.step(0.0)
    assert seen[0].requires_grad and seen[0].stride(-1) == 0  # renderers see that one channel serves all
    result = fit_svbrdf(leather, make_renderer("mitsuba"), settings)
    specular = result.svbrdf["specular"]
    assert (specular == specular[..., :1]).all() and result.deviations["specular"].shape[-1] == 1
    assert "colour of the specular map" in dict(result.omitted)


def test_the_search_for_a_start_keeps_to_what_is_held():
    # All is held at the truth but one map, of which the best constant is found: 0.4 on the grid; 0.2 by least
    # squares.
    views = GRID
    truth = flat(SIDE, diffuse=0.3, specular=0.2, roughness=0.4)
    photos = color.to_display(ANALYTIC.render(truth, views))
    for free, value in (("roughness", 0.4), ("specular", 0.2)):
        others = {"diffuse": 0.3, "specular": 0.2, "roughness": 0.4}
        fix = ("normal=flat", *(f"{name}={v}" for name, v in others.items() if name != free))
        made = make_method(FitTask(Capture(photos, views), ANALYTIC, DirectConfig(fix=fix), truth["diffuse"]))
        assert made.estimate()[0][free].mean().item() == pytest.approx(value, abs=2e-3)


def test_fixed_maps_from_files(tmp_path):
    # A folder of ours says that its colours are sRGB; without material.json 8 bits mean gamma 2.2. 2 x 2
    # texels become one.
    stripes = flat(SIDE, diffuse=0.2, roughness=0.3)
    stripes.maps["diffuse"][:, ::2] = 0.6
    save_maps(stripes, tmp_path / "maps")
    for kind in ("png", "exr"):
        held = fixed_maps([f"diffuse={tmp_path}/maps/diffuse.{kind}"], "roughconductor", SIDE // 2)["diffuse"]
        assert held.shape == (SIDE // 2, SIDE // 2, 3) and torch.allclose(held, torch.tensor(0.4), atol=1e-4)
    images.write_png(tmp_path / "r.png", torch.full((4, 4, 1), 0.5))
    held = fixed_maps([f"roughness={tmp_path}/r.png"], "roughconductor", 4)["roughness"]
    assert torch.allclose(held, torch.tensor((128 / 255) ** 2.2), atol=1e-4)


@pytest.mark.parametrize("fix, bsdf, words", [
    (["gloss=1"], "roughconductor", ["NAME=VALUE", "roughness"]), (["normal"], "roughconductor",
                                                                   ["NAME=VALUE"]),
    (["metallic=0"], "roughconductor", ["NAME=VALUE"]), (["diffuse=0.1"], "principled", ["base_color"]),
    (["normal=0.5"], "roughconductor", ["normal=flat"]), (["diffuse=flat"], "roughconductor",
                                                          ["only a normal"]),
    (["specular=1.5"], "roughconductor", ["from 0 to 1"]), (["specular=nan"], "roughconductor", ["nan"]),
    (["roughness=0"], "roughconductor", ["0.002"]), (["roughness=0.1,0.2,0.3"], "roughconductor",
                                                     ["1 number for"]),
    (["specular=0.1,0.2"], "roughconductor", ["1 or 3"]), (["specular=0.1", "specular=0.2"], "roughconductor",
                                                           ["once"]),
    (["diffuse=none.exr"], "roughconductor", ["none.exr"]), (["specular=0"], "roughconductor",
                                                             ["roughness=1"]),
    (["normal=flat", "metallic=0", "roughness=0.5", "base_color=0.5"], "principled", ["at least one map"]),])
def test_what_cannot_be_held(fix, bsdf, words):
    with pytest.raises(ConfigError) as error:
        DirectConfig(bsdf=bsdf, fix=tuple(fix)).check()
        fixed_maps(fix, bsdf, 8)
    assert all(word in str(error.value) for word in words), error.value


def test_held_files_that_are_no_maps(tmp_path):
    images.write_png(tmp_path / "wide.png", torch.full((4, 8, 3), 0.5))
    images.write_png(tmp_path / "down.png", torch.full((4, 4, 3), 0.2))  # z of this normal is negative
    (tmp_path / "text.png").write_text("no picture")
    for value in ("diffuse=wide.png", "normal=down.png", "diffuse=text.png"):
        name, file = value.split("=")
        with pytest.raises(MapsError):
            fixed_maps([f"{name}={tmp_path}/{file}"], "roughconductor", 4)


@pytest.mark.parametrize("settings, unused", [
    ({"smooth": 0.0, "flat": 0.0, "diffuse": 0.0, "adversarial": 0.0}, {"total_variation", "tilt", "diffuse",
                                                                        "discriminator"}),
    ({"fix": ("diffuse=0.2",)}, {"diffuse"}), ({"fix": ("normal=flat",)}, {"tilt"}),
    ({"fix": ("specular=0.04", "roughness=0.4")}, {"total_variation"}),
    ({"fix": ("base_color=0.2", "metallic=0.4"), "bsdf": "principled"}, {"diffuse"}), ({}, set()),])
def test_losses_without_weight_or_subject_are_not_computed(settings, unused, leather, monkeypatch):
    called = set()

    def counted(name, real):
        return lambda *given: (called.add(name), real(*given))[1]

    for name in ("total_variation", "tilt", "diffuse", "discriminator", "photometric"):
        monkeypatch.setattr(losses, name, counted(name, getattr(losses, name)))
    made = make_method(FitTask(leather, ANALYTIC, HybridConfig(width=4, **settings),
                               torch.full((SIDE, SIDE, 3), 0.2)))
    made.step(0.0)
    assert called == {"total_variation", "tilt", "diffuse", "discriminator", "photometric"} - unused
    assert hasattr(made, "discriminator") == ("discriminator" not in unused)
    said = dict(omitted_by(FitTask(leather, ANALYTIC, made.config)))
    names = {"total_variation": "smooth", "tilt": "flat", "discriminator": "adversarial",
             "diffuse": "diffuse"}
    assert {losses.NAMES[names[loss]] for loss in unused} == set(losses.NAMES.values()) & set(said)


@pytest.mark.parametrize("config, wanted", [
    (DirectConfig(fix=("diffuse=0.5", "normal=flat")), {"price on tilted normals"}),
    (GanConfig(fix=("diffuse=0.5", "normal=flat")), {"diffuse loss"}),
    (HybridConfig(fix=("diffuse=0.5", "normal=flat")), {"diffuse loss", "price on tilted normals"})])
def test_only_losses_of_the_method_are_omitted(config, wanted, leather):
    said = dict(omitted_by(FitTask(leather, ANALYTIC, config)))
    assert set(losses.NAMES.values()) & set(said) == wanted


@pytest.mark.parametrize("method", METHODS)
def test_a_kept_state_does_not_move(method, leather):
    made = make_method(FitTask(leather, ANALYTIC, config_of(method), torch.full((SIDE, SIDE, 3), 0.2)))
    made.step(0.0)
    kept = made.state()
    before = {name: value.clone() for name, value in kept.items()}
    made.step(0.0)
    assert all(torch.equal(kept[name], before[name]) for name in before)
    assert sum(not torch.equal(value, before[name]) for name, value in made.state().items()) > len(before) / 2


def test_smoothness_counts_only_what_is_fitted():
    svbrdf, edges = make_material("plates", SIDE), losses.edge_weights(torch.full((SIDE, SIDE, 3), 0.2))
    roughness, specular = (float(losses.total_variation(svbrdf, edges, [held]))
                           for held in ("specular", "roughness"))
    assert roughness > 0 and specular > 0
    assert float(losses.total_variation(svbrdf, edges)) == pytest.approx(roughness + specular)


def test_resume_asks_for_the_same_fixed_maps_not_the_same_names(leather, tmp_path):
    save_maps(flat(SIDE, roughness=0.3), tmp_path / "a")
    save_maps(flat(SIDE, roughness=0.3), tmp_path / "b")
    path, renderer = tmp_path / "c.safetensors", ANALYTIC

    def fit(folder, iterations, **resume):
        fix = (f"roughness={tmp_path}/{folder}/roughness.exr",)
        return fit_svbrdf(leather, renderer, DirectConfig(fix=fix, iterations=iterations), **resume)

    fit("a", 2, checkpoint=path)
    fit("b", 4, resume=path)
    save_maps(flat(SIDE, roughness=0.4), tmp_path / "a")
    with pytest.raises(ConfigError, match="resume with the same"):
        fit("a", 4, resume=path)


@pytest.mark.parametrize("bsdf", mostly_slow(CHANNELS, "roughconductor"))
def test_fix_and_explain_on_the_command_line(bsdf, tmp_path, capsys):
    shots, out = tmp_path / "shots", tmp_path / "out"
    assert cli.main(["synth", "builtin:leather", "-o", str(shots), "--resolution", "16", "--renderer",
                     "analytic"]) == 0
    command = ["fit", str(shots), "-o", str(out), "--method", "direct", "--renderer", "analytic",
               "--iterations", "2", "--bsdf", bsdf, "--fix", "normal=flat", "--fix", "roughness=0.5"]
    capsys.readouterr()
    assert cli.main([*command, "--explain"]) == 0 and not out.exists()
    said = capsys.readouterr().out
    assert "gradient of normal (held at flat)" in said and "rmse" not in said
    assert cli.main(command) == 0
    record = json.loads((out / "fit.json").read_text())
    assert record["config"]["fix"] == ["normal=flat", "roughness=0.5"]
    assert all(f"{item['what']} ({item['why']})" in said for item in record["omitted"])
    assert set(record["confidence"]) == set(CHANNELS[bsdf]) - {"normal", "roughness"}
    assert {p.stem for p in (out / "uncertainty").iterdir()} == set(record["confidence"])
    assert cli.main([*command[:-1], "roughness=2", "--overwrite"]) == 2
