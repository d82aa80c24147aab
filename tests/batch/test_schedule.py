"""Who fits what next, and that nothing is lost, done twice or waited for in vain."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from mitsvbrdf.batch.schedule import Scheduler, Work


def make(*costs, **limits):
    """A scheduler of work called a, b, c."""
    return Scheduler([Work(chr(97 + number), cost) for number, cost in enumerate(costs)], **limits)


def order(scheduler):
    """All that waits, as it is handed out."""
    found = []
    while work := scheduler.hand_out("w"):
        found.append(work.identity)
        scheduler.finished("w", "done")
    return "".join(found)


def test_the_largest_goes_first_and_equals_in_their_order():
    assert order(make(1, 3, 2, 3)) == "bdca"


def test_what_was_refused_is_not_tried_again():
    scheduler = make(1)
    scheduler.hand_out("w")
    assert scheduler.finished("w", "failed") == "failed"
    assert scheduler.waiting == 0 and not scheduler.running


def test_what_crashed_is_tried_again_after_all_others_and_so_often():
    for state in ("crashed", "timeout", "memory"):
        scheduler, found = make(5, 1, retries=2), []
        while work := scheduler.hand_out("w"):
            found.append((work.identity, scheduler.finished("w", state if work.identity == "a" else "done")))
        assert found == [("a", "again"), ("b", "done"), ("a", "again"), ("a", "failed")]


def test_without_retries_a_crash_is_the_end():
    scheduler = make(1, retries=0)
    scheduler.hand_out("w")
    assert scheduler.finished("w", "crashed") == "failed"


def test_what_was_lost_goes_to_the_front_again_and_again_up_to_a_limit():
    scheduler = make(1, 1, 1, most_lost=2)
    found = []
    for _ in range(3):
        assert scheduler.hand_out("w").identity == "a"
        found.append(scheduler.lost("w"))
    assert found == [(Work("a", 1), "again"), (Work("a", 1), "again"), (Work("a", 1), "failed")]
    assert order(scheduler) == "bc"


def test_a_loss_does_not_count_as_a_try():
    scheduler = make(1, retries=1, most_lost=5)
    for _ in range(5):
        scheduler.hand_out("w")
        scheduler.lost("w")
    scheduler.hand_out("w")
    assert scheduler.finished("w", "crashed") == "again"


def test_an_idle_worker_that_is_lost_takes_nothing_along():
    scheduler = make(1)
    assert scheduler.lost("w") is None and scheduler.waiting == 1


def test_what_is_put_back_is_the_next_and_counts_as_nothing():
    scheduler = make(1, 1, retries=0, most_lost=0)
    scheduler.hand_out("w")
    scheduler.put_back("w")
    assert order(scheduler) == "ab" and scheduler.ended == {"done": 2, "failed": 0, "again": 0}


def test_what_was_found_done_is_not_handed_out_again():
    scheduler = make(1)
    scheduler.hand_out("w")
    scheduler.found_done("w")
    assert scheduler.hand_out("w") is None and scheduler.ended["done"] == 1


class AnyBatch(RuleBasedStateMachine):
    """Whatever happens in whatever order; the books are kept here once more."""

    @initialize(costs=st.lists(st.sampled_from([1.0, 2.0, 5.0]), max_size=8), retries=st.integers(0, 2),
                most_lost=st.integers(0, 3))
    def start(self, costs, retries, most_lost):
        self.all = {str(number) for number in range(len(costs))}
        self.scheduler = Scheduler([Work(str(number), cost) for number, cost in enumerate(costs)], retries,
                                   most_lost)
        self.retries, self.most_lost = retries, most_lost
        self.waiting, self.running, self.ended = set(self.all), {}, []
        self.crashes, self.losses = dict.fromkeys(self.all, 0), dict.fromkeys(self.all, 0)

    @rule(worker=st.sampled_from("xyz"))
    def hand_out(self, worker):
        if worker in self.running:
            return
        work = self.scheduler.hand_out(worker)
        assert (work is None) == (not self.waiting)
        if work:
            self.waiting.remove(work.identity)
            self.running[worker] = work.identity

    @precondition(lambda self: getattr(self, "running", None))
    @rule(data=st.data(), state=st.sampled_from(["done", "failed", "crashed", "timeout", "memory"]))
    def finish(self, data, state):
        worker = data.draw(st.sampled_from(sorted(self.running)))
        identity = self.running.pop(worker)
        verdict = self.scheduler.finished(worker, state)
        if state in ("done", "failed"):
            assert verdict == state
        else:
            self.crashes[identity] += 1
            assert verdict == ("again" if self.crashes[identity] <= self.retries else "failed")
        self._note(identity, verdict)

    @precondition(lambda self: getattr(self, "running", None))
    @rule(data=st.data(), how=st.sampled_from(["lose", "found_done", "put_back"]))
    def otherwise(self, data, how):
        worker = data.draw(st.sampled_from(sorted(self.running)))
        identity, verdict = self.running.pop(worker), "done"
        if how == "lose":
            self.losses[identity] += 1
            work, verdict = self.scheduler.lost(worker)
            assert work.identity == identity
            assert verdict == ("again" if self.losses[identity] <= self.most_lost else "failed")
        elif how == "put_back":
            self.scheduler.put_back(worker)
            verdict = "again"
        else:
            self.scheduler.found_done(worker)
        self._note(identity, verdict)

    def _note(self, identity, verdict):
        if verdict == "again":
            self.waiting.add(identity)
        else:
            self.ended.append(identity)

    @invariant()
    def nothing_is_lost_or_done_twice(self):
        if not hasattr(self, "all"):
            return
        assert self.scheduler.waiting == len(self.waiting)
        assert {worker: work.identity for worker, work in self.scheduler.running.items()} == self.running
        assert sorted([*self.waiting, *self.running.values(), *self.ended]) == sorted(self.all)

    def teardown(self):
        """From wherever it got to, a batch in which nothing dies any more comes to its end."""
        if not hasattr(self, "all"):
            return
        for worker in list(self.running):
            self.ended.append(self.running.pop(worker))
            self.scheduler.finished(worker, "done")
        while work := self.scheduler.hand_out("x"):
            self.scheduler.finished("x", "done")
            self.ended.append(work.identity)
        assert sorted(self.ended) == sorted(self.all)


TestAnyBatch = AnyBatch.TestCase
TestAnyBatch.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
