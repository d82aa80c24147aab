"""``gan`` from solved maps: where the game begins, what it must not move, and what of it is kept."""

import pytest
import torch
from helpers import ANALYTIC, MITSUBA, photos_of

from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import FitTask, GanConfig, HierarchicalConfig, fit_svbrdf, make_method
from mitsvbrdf.fit.detail_config import DetailConfig
from mitsvbrdf.fit.generator.bounded import Bounded
from mitsvbrdf.fit.generator.gan import Gan
from mitsvbrdf.fit.options import config_of
from mitsvbrdf.fit.solved_gan import ENDED, GAME, SolvedGan, spared
from mitsvbrdf.fit.warnings import UNSETTLED
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF, numbers_of
from mitsvbrdf.measure.metrics import map_rmse, photo_rmse

SPREAD = {"diffuse": 0.02, "specular": 0.1, "roughness": 0.1, "normal": 0.02}


@pytest.fixture(scope="module")
def tiles():
    return make_material("tiles", 32)


@pytest.fixture(scope="module")
def photos(tiles):
    return photos_of(tiles)


def begun(photos, svbrdf, spread=SPREAD):
    """A game that begins at these maps, which stand for both answers of the solver."""
    method = SolvedGan(FitTask(photos, ANALYTIC, GanConfig()))
    bounds = {name: torch.full((4, 4, numbers_of(name, svbrdf[name]).shape[-1]), value)
              for name, value in spread.items()}
    method.answer = svbrdf, photos.views
    method._begin_game(Bounded.of(svbrdf, photos.views, bounds, DetailConfig.reach, DetailConfig.certain))
    return method


def rougher(svbrdf, by):
    return SVBRDF(svbrdf.bsdf, dict(svbrdf.maps) | {"roughness": (svbrdf["roughness"] + by).clamp(0.1, 1)})


def test_before_the_first_step_the_game_renders_the_solved_maps(tiles, photos):
    game = begun(photos, tiles).game
    images = [ANALYTIC.render(each, photos.views) for each in (tiles, game.material())]
    assert torch.allclose(*images, rtol=1e-3, atol=1e-4)


def test_each_texel_has_one_photo_held_out_and_each_photo_as_many_patches(photos):
    held = spared(photos, 0)
    assert (held.sum(dim=0) == 1).all()
    patches = held[:, ::2, ::2].sum(dim=(1, 2))  # of 32 texels 16 patches
    assert patches.sum() == 256 and patches.max() - patches.min() <= 1
    assert not torch.equal(held, spared(photos, 1))


def test_what_is_held_out_changes_no_step_of_the_game(tiles, photos):
    held = spared(photos, 0)
    spoilt = type(photos)(torch.where(held[..., None], 1 - photos.photos, photos.photos), photos.views)
    first, second = (begun(shots, tiles) for shots in (photos, spoilt))
    for method in (first, second):
        for step in range(2):
            method.game.step(step / 10)
    for name, value in first.game.change().items():
        assert torch.equal(value, second.game.change()[name])


def test_a_game_that_only_harms_returns_the_start_bit_for_bit(tiles, photos):
    method = begun(photos, tiles)
    harm = {name: torch.ones(bound.shape[-1], 32, 32) for name, bound in method.game.bounded.bounds.items()}
    method.game.change = lambda: harm
    method._judge()
    assert not method.kept
    for name, value in method.estimate()[0].maps.items():
        assert torch.equal(value, tiles[name])
    assert [each.what for each in method.omitted if each.what.startswith("the game's")] == [
        f"the game's change of {name}" for name in SPREAD]


@pytest.mark.slow
def test_photos_too_small_for_a_game_are_solved():
    tiny = photos_of(make_material("tiles", 6)).pick((0, 1, 2, 3))
    method = SolvedGan(FitTask(tiny, ANALYTIC, GanConfig()))
    while method.stage == 0:
        method.step(0.0)
    assert method.done and [each.what for each in method.omitted][-1] == "the game"


def test_of_a_game_only_the_map_that_it_helps_is_kept(tiles, photos):
    start = rougher(tiles, 0.1)
    method, random = begun(photos, start), torch.Generator().manual_seed(0)
    bounds = method.game.bounded.bounds
    off = (tiles["roughness"] - start["roughness"]) / bounds["roughness"]
    change = {name: torch.randn(bound.shape[-1], 32, 32, generator=random) for name, bound in bounds.items()}
    change["roughness"] = torch.atanh(off.clamp(-0.99, 0.99)).permute(2, 0, 1)
    method.game.change = lambda: change
    method._judge()
    found = method.estimate()[0]
    assert list(method.kept) == ["roughness"]
    assert map_rmse(found, tiles)["roughness"] < 0.01 < map_rmse(start, tiles)["roughness"]
    for name in ("diffuse", "specular", "normal"):
        assert torch.equal(found[name], start[name])
    kept = method.kept
    method.game.change = lambda: {name: value / 2 for name, value in change.items()}
    method._judge()  # a later state that helps less
    assert method.kept is kept


def test_a_change_that_mends_the_second_answer_and_spoils_the_first_is_not_kept(tiles, photos):
    start = rougher(tiles, 0.1)
    for first, kept in ((start, ["roughness"]), (tiles, [])):
        method = begun(photos, start)
        off = (tiles["roughness"] - start["roughness"]) / method.game.bounded.bounds["roughness"]
        change = {name: torch.zeros(bound.shape[-1], 32, 32)
                  for name, bound in method.game.bounded.bounds.items()}
        change["roughness"] = torch.atanh(off.clamp(-0.99, 0.99)).permute(2, 0, 1)
        method.game.change, method.answer = lambda change=change: change, (first, photos.views)
        method._judge()
        assert list(method.kept) == kept


def test_a_game_goes_on_from_its_saved_state_bit_for_bit(tiles, photos):
    whole = begun(photos, rougher(tiles, 0.1))
    for step in range(2):
        whole.step(step / 10)
    saved = {name: value.clone() for name, value in whole.state().items()}
    whole.steps = 18
    resumed = make_method(FitTask(photos, ANALYTIC, GanConfig()))
    resumed.load_state(saved)
    resumed.steps = 18
    for method in (whole, resumed):
        for step in range(2, 4):
            method.step(step / 10)  # the last one is judged
    assert all(torch.equal(value, resumed.state()[name]) for name, value in whole.state().items())
    for name, value in whole.estimate()[0].maps.items():
        assert torch.equal(value, resumed.estimate()[0][name])


def test_texels_that_the_photos_determine_stay_where_they_are(tiles, photos):
    # The bounds hold, however large the steps are: a deviation of 0.01 and less leaves no room.
    method = begun(photos, tiles, {name: 0.0124 for name in SPREAD})
    method.game.pace = 100.0
    for step in range(3):
        method.game.step(step / 10)
    errors = map_rmse(method.game.material(), tiles)
    assert 1e-4 < max(errors.values()) < 0.01


def test_of_few_photos_the_solved_maps_are_the_answer(photos):
    method = make_method(FitTask(photos.pick([0, 4, 8]), MITSUBA, GanConfig(iterations=1)))
    method.answer, method.stage = method.solvers[0].estimate(), ENDED
    assert method.done and method.step(0.5) == {}
    assert "fewer than 4 photos" in method.omitted[-1].why


def test_maps_that_are_not_settled_without_the_patches_are_no_start_of_a_game(photos):
    method = make_method(FitTask(photos, ANALYTIC, GanConfig(budget=10.0)))
    method.answer, method.stage, method.began = method.solvers[0].estimate(), 1, 0.5
    method.solvers.append(method.solvers[0])  # not done
    method.step(0.76)
    assert method.done and "no time was left" in method.omitted[-1].why


@pytest.mark.parametrize(("longest", "config", "stopped"), [
    (1e-9, GanConfig(budget=100.0), "budget"), (120.0, GanConfig(iterations=2), "iterations")])
def test_an_answer_that_had_no_time_to_settle_is_said_to(longest, config, stopped, photos, monkeypatch):
    monkeypatch.setattr(HierarchicalConfig, "default_limit", {"budget": longest})
    result = fit_svbrdf(photos.pick([0, 4, 8]), MITSUBA, config)
    assert result.stopped == stopped and UNSETTLED in result.warnings


def test_a_short_budget_is_first_spent_on_all_photos(photos):
    for budget, limit in ((60.0, 60.0), (300.0, 120.0), (None, None)):
        method = make_method(FitTask(photos, ANALYTIC, GanConfig(budget=budget)))
        assert method.solvers[0].config.budget == limit


def test_settings_of_the_other_game_begin_at_the_guess(photos):
    assert GanConfig().begins == "solved" and GanConfig(flash_offset=False).begins == "solved"
    assert GanConfig(width=8).begins == "guess" and GanConfig(preset="paper-one-stage").begins == "untrained"
    assert isinstance(make_method(FitTask(photos, ANALYTIC, GanConfig(start="guess"))), Gan)
    for other, said in (({"game": "bce"}, "beside --game"),
                        ({"preset": "paper-one-stage"}, "--start solved")):
        with pytest.raises(ConfigError, match=said):
            GanConfig(start="solved", **other).check()
    former = {"method": "gan", "preset": "minutes"}
    assert [config_of(former | {"start": old}).start for old in (True, False)] == ["guess", "untrained"]
    assert config_of(former | {"start": "guess", "precision": "auto", "average": 0.99}).start == "guess"
    for later in ({"invented": 1}, {"method": "invented"}):
        with pytest.raises(ConfigError, match="invented"):
            config_of(former | later)


@pytest.mark.slow
def test_the_whole_way_ends_no_worse_than_the_default(photos, tiles):
    result = fit_svbrdf(photos, MITSUBA, GanConfig(iterations=120))
    default = fit_svbrdf(photos, MITSUBA)
    assert result.stopped == "iterations" and dict(result.used).keys() == {"generator", "discriminator"}
    for name, error in map_rmse(default.svbrdf, tiles).items():
        assert map_rmse(result.svbrdf, tiles)[name] < error + 0.005, name
    assert photo_rmse(result.rerendered, photos.photos)[0] < 1.1 * default.rerender_rmse


@pytest.mark.slow
def test_begun_at_the_truth_the_game_keeps_it(tiles, photos):
    from mitsvbrdf.fit.confidence import deviations

    method = begun(photos, tiles)
    spread = deviations(tiles, photos.views, FitTask(photos, MITSUBA, GanConfig()))[0]
    method._begin_game(Bounded.of(tiles, photos.views, spread, DetailConfig.reach, DetailConfig.certain))
    for step in range(60):
        method.step(step / 60)
    assert method.stage == GAME and method.steps == 60
    assert max(map_rmse(method.estimate()[0], tiles).values()) < 0.01  # the game's own maps: 0.09


def test_a_share_of_the_steps_is_no_share_of_the_solvers_time(photos):
    cut, going = (SolvedGan(FitTask(photos, ANALYTIC, GanConfig(budget=1200.0, iterations=steps)))
                  for steps in (None, 200))
    for method in (cut, going):
        method.step(0.0)
        method.step(0.5)
    assert cut.stage > 0 and going.stage == 0
