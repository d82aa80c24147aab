"""A budget is kept, by a clock that only work moves: a step of the solver at full size takes a second."""

import pytest
import torch
from helpers import photos_of
from helpers.hierarchical_fits import method_of

from mitsvbrdf.fit.hierarchical import cross_validation, scales, specular_test, stages, starts
from mitsvbrdf.fit.hierarchical.omitted import CROSS_VALIDATION, VIEWS
from mitsvbrdf.fit.hierarchical.shared_lobes import TRIED
from mitsvbrdf.fit.hierarchical.stages import LOBE_ROUNDS, ROUNDS, Stage, Stages
from mitsvbrdf.fit.hierarchical.time_budget import FAR_STEPS, LAST_STEPS, OTHER_STEPS, STEPS, TimeBudget
from mitsvbrdf.fit.hierarchical.view_corrections import ViewCorrections
from mitsvbrdf.material.made import make_material

SIDE = 8
AMPLE = 1e5


class Clock:
    """Tells the seconds of the work done."""

    def __init__(self):
        self.now, self.calls = 0.0, []

    def __call__(self):
        return self.now

    def work(self, kind, side, count):
        self.calls.append((kind, side, count))
        self.now += count * (side / SIDE)**2


@pytest.fixture(scope="module")
def shots():
    return photos_of(make_material("leather", SIDE))


@pytest.fixture
def timed(shots, monkeypatch):
    """Makes a fit of photos of a phone that runs by such a clock."""
    monkeypatch.setattr(scales, "COARSE", SIDE // 2)
    for enough in ("CALM", "WORTH"):  # only the clock ends rounds
        monkeypatch.setattr(stages, enough, -1.0)

    def made(budget, slower=1, **settings):
        method, clock = method_of(shots, budget=budget, **({"exact": False} | settings)), Clock()

        def stepped(solver, photos, answer, prior, count, slower=1):
            side = answer.x.shape[-1]
            clock.work("solver", side, count * (slower if side < SIDE else 1))
            return starts.stepped(solver, photos, answer, prior, count)

        for where in ("observations", "cross_validation", "scoring", "specular_test"):
            monkeypatch.setattr(f"mitsvbrdf.fit.hierarchical.{where}.stepped", stepped)
        monkeypatch.setattr("mitsvbrdf.fit.hierarchical.real_photos.stepped",
                            lambda *given: stepped(*given, slower))
        monkeypatch.setattr(method.corrections, "refine", lambda maps, *_: clock.work(
            "views", maps.resolution, method.corrections.work))
        method.budget.clock = clock
        return method, clock

    return made


def run(method, clock, budget):
    """The loop, as far as it matters here: the stage and its rounds after each step, and what comes out."""
    passed = []
    while not method.done and clock.now < budget:
        method.step(clock.now / budget)
        passed.append((method.stages.stage, method.stages.rounds))
    return passed, method.estimate()[0]


@pytest.mark.parametrize("budget, exact, slower", [
    (30, False, 1), (120, False, 1), (700, False, 1), (1300, False, 8), (60, True, 1), (300, True, 1)])
def test_a_budget_is_kept_and_used(budget, exact, slower, timed):
    """Turns of photos that are held out may take longer than steps so far let foresee."""
    method, clock = timed(budget, slower, exact=exact)
    passed, found = run(method, clock, budget)
    assert passed[-1][0] == Stage.FINE
    assert found.resolution == SIDE and all(torch.isfinite(value).all() for value in found.maps.values())
    assert clock.now <= budget + 2  # the last step may begin just before the end
    assert method.done or clock.now >= budget


def test_exact_photos_whose_time_ends_before_full_size_take_steps_there(timed):
    method, clock = timed(AMPLE, exact=True)
    method.step(0.0)
    method.ended = True
    assert method.estimate()[0].resolution == SIDE and clock.calls[-1] == ("solver", SIDE, STEPS)


def test_a_fit_without_its_last_steps_has_not_settled(timed, monkeypatch):
    for short in (False, True):
        method, clock = timed(AMPLE, exact=True)
        while not method.done:
            step = method.stages.stage, method.stages.rounds
            if short and step == (Stage.FINE, LOBE_ROUNDS - 1):  # what comes last lacks time, nothing else
                monkeypatch.setattr(method.budget, "in_time",
                                    lambda work, *_, **__: work < TRIED * FAR_STEPS * SIDE**2)
            method.step(0.0)
        assert method.exact.lobes and method.cut_short == short and method.stages.closing != short


@pytest.mark.slow
def test_an_ample_budget_changes_nothing(timed):
    method, clock = timed(AMPLE)
    passed, found = run(method, clock, AMPLE)
    free, other = timed(None)
    assert (passed, clock.calls) == (run(free, other, AMPLE)[0], other.calls) and free.done
    assert all(torch.equal(value, free.estimate()[0][name]) for name, value in found.maps.items())
    assert ("views", SIDE, method.corrections.work) in clock.calls
    assert not {CROSS_VALIDATION, f"further {VIEWS}"} & dict(method.omitted).keys() and not method.cut_short


def test_what_cannot_end_in_time_is_not_begun_and_said(timed):
    method, clock = timed(1000)
    run(method, clock, 1000)
    # a quarter of what it takes at full size
    assert ("views", SIDE // 2, method.corrections.work) in clock.calls
    assert ("views", SIDE, method.corrections.work) not in clock.calls
    assert {CROSS_VALIDATION, f"further {VIEWS}"} <= dict(method.omitted).keys() and method.cut_short


@pytest.mark.slow
def test_a_resumed_fit_knows_what_steps_took(timed):
    method, clock = timed(AMPLE)
    while (method.stages.stage, method.stages.rounds) != (Stage.FINE, 4):
        method.step(0.0)
    again, later = timed(clock.now + 400)
    later.now = clock.now
    again.load_state(method.state())
    assert again.budget.rates == method.budget.rates and len(again.budget.rates) == 3
    assert again.budget.end == again.budget.budget
    run(again, later, again.budget.budget)
    assert again.done and "views" not in [kind for kind, *_ in later.calls]
    assert again.stages.rounds == 6 and f"further {VIEWS}" in dict(again.omitted)


def test_the_question_whether_a_material_is_matte_is_not_asked_where_it_cannot_end(timed):
    method, clock = timed(AMPLE, exact=True)
    while not method.stages.finished:
        method.step(0.0)
    method.stages.unexplained = torch.zeros(2)
    asked = specular_test.decision_work(method.scales) / SIDE**2
    for left, counts in ((asked - 1, set()), (asked + STEPS + LAST_STEPS + 1, {specular_test.STEPS})):
        clock.calls.clear()
        method.budget.end = clock.now + left
        method.exact.omit_lobe(method.answer)
        assert {count for _, _, count in clock.calls} & {specular_test.STEPS} == counts


def test_the_turns_are_foreseen_as_they_are_made(timed, monkeypatch):
    # Everything between the stage at the coarse size and the first round at full size, by the solver's steps;
    # variances, which count as one each, are not seen by this clock.
    method, clock = timed(AMPLE)
    while method.stages.stage != Stage.TOGETHER or not method.stages.finished:
        method.step(0.0)
    clock.calls.clear()
    # takes turns of its own
    monkeypatch.setattr("mitsvbrdf.fit.hierarchical.response_curve.curved", lambda *_: None)
    method._begin_next_stage()
    steps, turns = sum(count for _, _, count in clock.calls), cross_validation.in_turn(len(method.capture))
    rounds_of_each = cross_validation.AGREED + len(cross_validation.NOISES) * cross_validation.ROUNDS
    assert steps + len(turns) * rounds_of_each == cross_validation.steps_of_turns(len(method.capture))
    assert {side for _, side, _ in clock.calls} == {method.scales.of(Stage.ALONE).capture.resolution}


@pytest.mark.slow
def test_a_round_that_was_cut_is_made_again_and_tells_nothing(timed, monkeypatch):
    method, clock = timed(AMPLE)
    while (method.stages.stage, method.stages.rounds) != (Stage.FINE, 1):
        method.step(0.0)
    method.budget.end = clock.now + LAST_STEPS + STEPS + OTHER_STEPS
    clock.calls.clear()
    with monkeypatch.context() as patch:
        for enough in ("CALM", "WORTH"):  # any whole round would tell that nothing more is to be won
            patch.setattr(stages, enough, 2.0)
        method.step(0.5)
    assert method.stages.others and method.stages.last == ROUNDS[Stage.FINE]
    assert clock.calls == [("solver", SIDE, STEPS),
                           ("solver", SIDE, OTHER_STEPS)] and method.stages.rounds == 1
    method.step(0.5)
    assert clock.calls[2:] == [("solver", SIDE, LAST_STEPS)] and clock.now == method.budget.end
    method.budget.end = AMPLE * 2
    method.step(0.5)
    assert method.stages.rounds == 2 and method.real.closed is None


def test_a_stage_whose_rounds_are_too_long_ends_once_it_is_known_what_a_round_takes():
    stages = Stages(multi_start=False)
    over = []
    for _ in range(3):
        over.append((stages.over(0.0, short=True), stages.over(0.0)))
        stages.begin_round()  # the first makes kernels, so it tells too much
    assert over == [(False, False), (False, False), (True, False)]


def test_a_stage_that_ends_before_its_refinement_of_the_views_says_so(shots):
    def short(refined, stage, rounds, tied):
        moved = ViewCorrections(shots, refined, True)
        moved.leave(stage, rounds, tied)
        return bool(moved.skipped)

    assert short("always", Stage.ALONE, 11, False) and short("unless exact", Stage.TOGETHER, 8, True)
    assert not short("always", Stage.ALONE, 12, False) and not short("unless exact", Stage.TOGETHER, 9, True)
    # nothing moves
    assert not short("unless exact", Stage.ALONE, 11, False) and not short("never", Stage.TOGETHER, 8, True)
    assert not short("always", Stage.MULTI_START, 1, False)  # which has none


def test_the_pace():
    clock = Clock()
    stages = Stages(multi_start=True)
    pace = TimeBudget(10.0, stages, 4, clock)
    assert pace.in_time(1e9) and pace.steps(7) == 7  # nothing is known yet
    pace.begin(0.2)
    pace.begin(0.9)  # not the first step
    assert pace.end == 8
    with pace.timed("solver", 20):
        clock.now += 1
    assert pace.steps(200) == 35 and pace.steps(200, keep=5) == 30 and pace.steps(200, keep=50) == 1
    assert pace.to_come == STEPS + LAST_STEPS == 14
    assert pace.in_time(84) and not pace.in_time(85) and not pace.in_time(84, beside=1)
    assert pace.in_time(84, "views")
    with pace.timed("views", 10):
        clock.now += 1
    assert pace.in_time(32, "views") and not pace.in_time(33, "views")
    # a slow call may have made a kernel too, or met another program
    for seconds, least in ((3, 0.1), (0.5, 0.05)):
        with pace.timed("views", 10):
            clock.now += seconds
        assert pace.rates["views"] == least and pace.rates["solver"] == 0.05
    pace.rates["views"] = 0.1
    stages.enter(Stage.FINE)
    again = TimeBudget(None, stages, 4, clock)
    again.load_state(pace.state())
    again.begin(0.0)
    later = TimeBudget(20.0, stages, 4, clock)
    later.load_state(pace.state())
    later.begin(0.5)  # by the number of iterations, say
    assert later.end == clock.now + 20 - (10 - (8 - clock.now))
    assert again.rates == pace.rates and again.in_time(1e9) and again.to_come == LAST_STEPS


@pytest.mark.parametrize("exact", [False, True])
def test_the_last_stage_of_real_photos_ends_by_what_its_rounds_tell(exact):
    found = Stages(multi_start=True, stated=exact)
    found.unexplained = torch.ones(2)
    found.enter(Stage.FINE)
    found.begin_round()
    found.moved(2 * stages.CALM)
    found.saved(2 * stages.WORTH)
    assert found.last == ROUNDS[Stage.FINE] and found.others
    found.moved(stages.CALM / 2)
    found.saved(stages.WORTH / 2)
    assert (found.last, found.others) == ((ROUNDS[Stage.FINE], True) if exact else (2, False))
    again = Stages(multi_start=True)
    again.load_state(found.state())
    assert (again.last, again.others) == (found.last, found.others)


def test_a_first_stage_that_lacked_time_is_not_forgotten_in_the_next_one(shots):
    method, again = (method_of(shots, exact=False) for _ in range(2))
    for stage, rounds in ((Stage.TOGETHER, ROUNDS[Stage.ALONE] - 1), (Stage.FINE, ROUNDS[Stage.TOGETHER])):
        method.stages.rounds = rounds
        method.stages.enter(stage)
    again.stages.load_state(method.stages.state())
    assert method.cut_short and again.cut_short and not method.stages.hurried
