"""The dispatch core alone: rules one by one, then random histories of a faulty world against the invariants."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env_controller import events as e
from env_controller.scheduler import Scheduler

A, B = "a" * 64, "b" * 64


class Story:
    """A scheduler with a clock of its own, for tests that read as a story."""

    def __init__(self, **options: float) -> None:
        self.core = Scheduler("e1", **options)  # type: ignore[arg-type]
        self.now = 0.0
        self.polls = 0

    def submit(self, task: str = A, **options: float) -> list[e.Command]:
        return self.core.handle(e.Submitted(self.now, task, "film", **options))  # type: ignore[arg-type]

    def join(self, worker: str = "w1", *holding: tuple[str, int]) -> list[e.Command]:
        return self.core.handle(e.Joined(self.now, worker, "film", holding=holding))

    def poll(self, worker: str = "w1", holding: tuple[str, ...] = (), hold: bool = True) -> list[e.Command]:
        self.polls += 1
        return self.core.handle(e.Polled(self.now, worker, self.polls, holding, hold))

    def deliver(
        self, worker: str = "w1", task: str = A, attempt: int = 1, verdict: str = "done", epoch: str = "e1"
    ) -> list[e.Command]:
        return self.core.handle(e.Delivered(self.now, worker, task, attempt, epoch, verdict, "why"))  # type: ignore[arg-type]

    def leased(self, worker: str = "w1", task: str = A) -> Story:
        self.join(worker)
        self.submit(task)
        assert self.poll(worker) == [e.Grant(self.polls, worker, task, 1)]
        return self


def test_a_task_goes_to_the_poll_that_waits() -> None:
    """Poll first or task first, the grant is the same."""
    first, second = Story(), Story()
    first.join()
    assert first.poll() == []
    assert first.submit() == [e.Grant(1, "w1", A, 1)]
    second.join()
    second.submit()
    assert second.poll() == [e.Grant(1, "w1", A, 1)]


def test_a_task_submitted_twice_is_one_task() -> None:
    """The same id from two askers is leased once and ends once."""
    story = Story().leased()
    assert story.submit() == []
    assert story.deliver() == [e.Receive("w1", A, 1, accepted=True), e.Finish(A, "done")]
    assert story.core.tasks == {}


def test_the_poll_that_waited_longest_is_served_first() -> None:
    """Polls are served in the order in which they came."""
    story = Story()
    for worker in ("w1", "w2"):
        story.join(worker)
        story.poll(worker)
    assert story.submit(A) == [e.Grant(1, "w1", A, 1)]
    assert story.submit(B) == [e.Grant(2, "w2", B, 1)]


def test_kinds_are_kept_apart() -> None:
    """A ray task is not given to a film worker."""
    story = Story()
    story.join()
    story.poll()
    assert story.core.handle(e.Submitted(0.0, A, "ray")) == []


def test_the_task_of_a_dead_worker_goes_to_the_next() -> None:
    """When the holder's process ends, the waiting poll of another worker gets the task as attempt 2."""
    story = Story().leased()
    story.join("w2")
    assert story.poll("w2") == []
    assert story.core.handle(e.Left(1.0, "w1")) == [e.Grant(2, "w2", A, 2)]
    assert story.deliver("w1") == [e.Receive("w1", A, 1, False, "attempt 1 of w1 is over, attempt 2 is with w2")]
    *_, finish = story.deliver("w2", attempt=2)
    assert isinstance(finish, e.Finish)
    assert (finish.code, len(finish.history)) == ("done", 1)
    assert finish.history[0].startswith("attempt 1: w1 was lost")


def test_a_silent_worker_loses_its_task_and_is_told_to_stop() -> None:
    """No word for longer than `silence_s` takes the lease; its late result is fenced."""
    story = Story(silence_s=6.0).leased()
    assert story.core.handle(e.Tick(6.0)) == []
    assert story.core.handle(e.Tick(6.1)) == [e.Stop("w1", A, 1)]
    story.now = 7.0
    assert story.deliver() == [e.Receive("w1", A, 1, False, "the task is not leased")]
    assert story.core.counts["fenced"] == 1


def test_heartbeats_keep_a_lease() -> None:
    """A worker that beats keeps a long task."""
    story = Story(silence_s=6.0).leased()
    for second in range(1, 60):
        story.core.handle(e.Beat(float(second), "w1"))
        assert story.core.handle(e.Tick(second + 0.5)) == []


def test_a_task_over_its_limit_is_taken_away() -> None:
    """A worker that beats and never ends loses the task at the task's own limit."""
    story = Story()
    story.join()
    story.submit(limit_s=10.0)
    story.poll()
    for second in range(1, 11):
        story.core.handle(e.Beat(float(second), "w1"))
    assert story.core.handle(e.Tick(10.5)) == [e.Stop("w1", A, 1)]
    assert A in story.core.ready["film"]


def test_a_poison_task_is_set_aside_after_three_attempts() -> None:
    """Three workers die of a task; it ends as failed with the history of all three, and no fourth gets it."""
    story = Story(attempts=3)
    story.submit()
    commands: list[e.Command] = []
    for number in (1, 2, 3):
        story.join(f"w{number}")
        assert story.poll(f"w{number}") == [e.Grant(number, f"w{number}", A, number)]
        commands = story.core.handle(e.Left(0.0, f"w{number}"))
    (finish,) = commands
    assert isinstance(finish, e.Finish)
    assert finish.code == "worker_lost"
    assert len(finish.history) == 3
    story.join("w4")
    assert story.poll("w4") == []


def test_a_crash_is_tried_again_and_a_refusal_is_not() -> None:
    """An exception in the worker may be its own; a bad request stays bad."""
    crashed, refused = Story().leased(), Story().leased()
    assert crashed.deliver(verdict="crashed") == [e.Receive("w1", A, 1, accepted=True)]
    assert A in crashed.core.ready["film"]
    assert e.Finish(A, "refused") in refused.deliver(verdict="refused")


def test_a_result_of_an_earlier_epoch_is_fenced() -> None:
    """What was leased before the controller's restart does not count after it."""
    story = Story().leased()
    (receive,) = story.deliver(epoch="e0")
    assert isinstance(receive, e.Receive)
    assert not receive.accepted
    assert A in story.core.leases


def test_a_lease_that_was_lost_on_the_way_comes_back_without_blame() -> None:
    """A worker that polls and does not hold its lease never got it; the task is granted anew, no failure noted."""
    story = Story().leased()
    assert story.poll() == [e.Grant(2, "w1", A, 2)]
    assert story.core.tasks[A].failures == []


def test_a_worker_with_full_slots_gets_nothing_more() -> None:
    """A second poll while the only slot is taken is released."""
    story = Story().leased()
    story.submit(B)
    assert story.poll(holding=(A,)) == [e.Release(2)]


def test_handing_back_costs_no_attempt() -> None:
    """A draining worker returns its task; the next gets it and nothing is held against it."""
    story = Story().leased()
    story.join("w2")
    story.poll("w2")
    commands = story.core.handle(e.HandedBack(1.0, "w1", A, 1, "e1"))
    assert commands == [e.Receive("w1", A, 1, accepted=True), e.Grant(2, "w2", A, 2)]
    assert story.core.tasks[A].failures == []


def test_patience_ends_a_task_that_no_worker_comes_for() -> None:
    """With no worker of the kind a task waits its patience and fails as no_worker; with one it waits for ever."""
    alone, served = Story(), Story()
    alone.submit(patience_s=5.0)
    assert alone.core.handle(e.Tick(5.0)) == []
    assert alone.core.handle(e.Tick(5.1)) == [e.Finish(A, "no_worker")]
    served.join()
    served.submit(patience_s=5.0)
    assert served.core.handle(e.Tick(500.0)) == []


def test_withdrawing_stops_the_worker() -> None:
    """A withdrawn task ends as cancelled, its worker is told, its result no longer counts."""
    story = Story().leased()
    assert story.core.handle(e.Withdrawn(1.0, A)) == [e.Stop("w1", A, 1), e.Finish(A, "cancelled")]
    (receive,) = story.deliver()
    assert isinstance(receive, e.Receive)
    assert not receive.accepted


def test_an_unknown_worker_is_asked_to_introduce_itself() -> None:
    """After a restart of the controller old workers poll; they are told to say hello."""
    assert Story().poll("ghost") == [e.Introduce(1)]


class TestComingBack:
    """A worker that was lost sight of and still computes: the router restarted, the link was cut, we were busy."""

    def test_it_keeps_the_lease_that_still_stands(self) -> None:
        """Hello again with the attempt in hand changes nothing, and the result counts."""
        story = Story().leased()
        assert story.join("w1", (A, 1)) == []
        assert e.Finish(A, "done") in story.deliver()

    def test_it_goes_on_where_nobody_else_has_begun(self) -> None:
        """Lost with its token, back before another took the task: same attempt, no failure noted any longer."""
        story = Story().leased()
        story.core.handle(e.Left(1.0, "w1"))
        assert A in story.core.ready["film"]
        assert story.join("w1", (A, 1)) == []
        assert story.core.tasks[A].failures == []
        assert A not in story.core.ready.get("film", {})
        assert story.deliver() == [e.Receive("w1", A, 1, accepted=True), e.Finish(A, "done")]

    def test_it_is_stopped_where_another_has_begun(self) -> None:
        """Somebody else's attempt 2 runs: attempt 1 is dropped, and its result would be fenced."""
        story = Story().leased()
        story.core.handle(e.Left(1.0, "w1"))
        story.join("w2")
        assert story.poll("w2") == [e.Grant(2, "w2", A, 2)]
        assert story.join("w1", (A, 1)) == [e.Stop("w1", A, 1)]
        assert story.core.leases[A].worker == "w2"

    def test_it_is_stopped_where_the_task_has_ended(self) -> None:
        """Withdrawn or done meanwhile: drop it."""
        story = Story().leased()
        story.core.handle(e.Left(1.0, "w1"))
        story.core.handle(e.Withdrawn(1.0, A))
        assert story.join("w1", (A, 1)) == [e.Stop("w1", A, 1)]

    def test_without_it_the_task_is_free_again(self) -> None:
        """Back with empty hands: the task is queued at once, nobody to blame."""
        story = Story().leased()
        assert story.join("w1") == []
        assert A in story.core.ready["film"]
        assert story.core.tasks[A].failures == []

    def test_a_link_of_ours_that_was_cut_is_nobody_s_fault(self) -> None:
        """When it is the controller that lost the router, ten such losses do not set a task aside."""
        story = Story(attempts=3)
        story.submit()
        for number in range(1, 11):
            story.join()
            assert story.poll() == [e.Grant(number, "w1", A, number)]
            story.core.handle(e.Left(0.0, "w1", blame=False))
        assert story.core.tasks[A].failures == []


def test_a_poll_that_was_given_up_gets_no_task() -> None:
    """A worker with one slot that polls anew has given the older poll up: the task goes to the new one."""
    story = Story()
    story.join()
    assert story.poll() == []
    assert story.poll() == [e.Release(1)]
    assert story.submit() == [e.Grant(2, "w1", A, 1)]


def test_nothing_is_left_of_a_kind_whose_queue_is_empty() -> None:
    """Thousands of kinds that came once do not stay."""
    story = Story()
    for number in range(100):
        story.core.handle(e.Submitted(0.0, f"{number:064x}", f"kind{number}"))
        story.core.handle(e.Withdrawn(0.0, f"{number:064x}"))
    assert story.core.ready == {}


def test_the_story_of_a_task_names_each_step() -> None:
    """The story outlives the task and reads from submission to end."""
    story = Story().leased()
    story.deliver()
    assert story.core.story(A) == [
        "0.000 submitted",
        "0.000 attempt 1 leased to w1",
        "0.000 ended: done",
    ]


def slow_story() -> Story:
    """Two workers; it is known that tasks take a tenth of a second; A has been with w1 for ten seconds."""
    story = Story(silence_s=60.0)
    story.join("w1")
    story.join("w2")
    for number in range(8):
        story.submit(f"{number}" * 64)
        story.poll("w1")
        story.now += 0.1
        story.deliver("w1", f"{number}" * 64)
    story.submit(A)
    story.poll("w1")
    story.now += 10.0
    return story


def test_the_slowest_task_is_hedged_when_nothing_else_waits() -> None:
    """An idle worker gets it too; the first to deliver ends it, the other is told to stop."""
    story = slow_story()
    assert story.poll("w2") == [e.Grant(story.polls, "w2", A, 2)]
    assert story.deliver("w2", A, 2) == [
        e.Receive("w2", A, 2, accepted=True),
        e.Stop("w1", A, 1),
        e.Finish(A, "done"),
    ]
    assert not story.deliver("w1", A, 1)[0].accepted  # type: ignore[attr-defined]
    assert story.core.hedged == 1


def test_the_slow_one_may_still_win() -> None:
    """The first attempt counts as long as nobody else delivered."""
    story = slow_story()
    story.poll("w2")
    assert story.deliver("w1", A, 1)[1:] == [e.Stop("w2", A, 2), e.Finish(A, "done")]
    assert story.core.leases == story.core.hedges == {}


def test_what_waits_goes_before_a_hedge() -> None:
    """An idle worker takes a ready task first, and no task gets a third lease."""
    story = slow_story()
    story.submit(B)
    assert story.poll("w2") == [e.Grant(story.polls, "w2", B, 1)]
    story.deliver("w2", B)
    story.poll("w2")
    story.join("w3")
    assert story.poll("w3") == []


def test_a_task_that_is_not_slow_is_not_hedged() -> None:
    """Nor one of a kind of which little is known."""
    story = slow_story()
    story.now -= 9.0
    assert story.poll("w2") == []
    new = Story(silence_s=60.0).leased("w1", A)
    new.join("w2")
    new.now += 50.0
    assert new.poll("w2") == []


@pytest.mark.parametrize("lost", ["w1", "w2"])
def test_of_two_leases_one_may_be_lost(lost: str) -> None:
    """The other goes on alone, nothing is queued again; then it too is lost, and the task is ready."""
    story, other = slow_story(), "w2" if lost == "w1" else "w1"
    story.poll("w2")
    story.core.handle(e.Left(story.now, lost, "gone"))
    assert story.core.hedges == {}
    assert story.core.leases[A].worker == other
    assert A not in story.core.ready.get("film", ())
    story.core.handle(e.Left(story.now, other, "gone"))
    assert A in story.core.ready["film"]


def test_two_shares_get_task_for_task() -> None:
    """A campaign with ten tasks waiting does not hold up one with two."""
    story = Story()
    story.join()
    for number in range(10):
        story.submit(f"{number}" * 64, share="long")
    for task in (A, B):
        story.submit(task, share="short")
    order = []
    for _ in range(6):
        (grant,) = story.poll()
        order.append(grant.task_id[0])  # type: ignore[attr-defined]
        story.deliver("w1", grant.task_id)  # type: ignore[attr-defined]
    assert order == ["0", "a", "1", "b", "2", "3"]


def test_a_worker_is_given_the_film_it_had() -> None:
    """Of the next eight; then the oldest goes first."""
    story = Story()
    story.join()
    for number, group in enumerate("fgfggggggf"):
        story.submit(f"{number}" * 64, group=group)
    order = []
    for _ in range(10):
        (grant,) = story.poll()
        order.append(int(grant.task_id[0]))  # type: ignore[attr-defined]
        story.deliver("w1", grant.task_id)  # type: ignore[attr-defined]
    assert order == [0, 2, 9, 1, 3, 4, 5, 6, 7, 8]


def test_what_is_wanted_ahead_waits_for_all_else_until_it_is_wanted_now() -> None:
    """A film that may be needed is computed when nothing else is; once asked for in earnest it is like others."""
    story = Story()
    story.join()
    story.submit(A, ahead=True)
    story.submit(B)
    assert story.poll()[0].task_id == B  # type: ignore[attr-defined]
    story.deliver("w1", B)
    story.submit("c" * 64)
    story.submit(A)
    story.submit("d" * 64)
    (grant,) = story.poll()
    assert grant.task_id == "c" * 64  # type: ignore[attr-defined]
    story.deliver("w1", "c" * 64)
    assert story.poll()[0].task_id == A  # type: ignore[attr-defined]


class FaultyWorld:
    """Workers that die, fall silent, lose and repeat messages, around one scheduler; checks after every event."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.core = Scheduler("e1", attempts=3, silence_s=6.0)
        for _ in range(8):  # so that what takes over 2 s is slow, and hedged
            self.core._durations.note("film", 0.1)
        self.now, self.polls = 0.0, 0
        self.wanted: Counter[str] = Counter()
        self.ended: Counter[str] = Counter()
        self.in_hand: dict[str, set[tuple[str, int]]] = {}  # what each worker believes it holds
        self.old: list[tuple[str, str, int]] = []  # deliveries that may come again
        self.accepted: Counter[str] = Counter()

    def send(self, event: e.Event) -> None:
        for command in self.core.handle(event):
            if isinstance(command, e.Grant) and self.random.random() > 0.1:  # one grant in ten is lost on the way
                self.in_hand.setdefault(command.worker, set()).add((command.task_id, command.attempt))
            if isinstance(command, e.Finish):
                self.ended[command.task_id] += 1
            if isinstance(command, e.Receive) and command.accepted and isinstance(event, e.Delivered):
                self.accepted[command.task_id] += event.verdict == "done"
        self.check()

    def check(self) -> None:
        core = self.core
        ready = [task for queue in core.ready.values() for task in queue]
        assert len(ready) == len(set(ready))
        assert set(ready) | set(core.leases) == set(core.tasks), "a task is neither ready nor leased"
        assert not set(ready) & set(core.leases), "a task is both ready and leased"
        for name, worker in core.workers.items():
            assert len(core.held_by(name)) <= worker.slots, "more leases than slots"
        for lease in (*core.leases.values(), *core.hedges.values()):
            assert lease.worker in core.workers, "leased to a lost worker"
        for task, hedge in core.hedges.items():
            assert core.leases[task].attempt != hedge.attempt, "hedged by itself"
        assert all(name in core.workers for name in core.polls.values()), "a poll of a lost worker"
        for task, times in self.wanted.items():
            assert self.ended[task] + (task in core.tasks) == times, "a task was lost or ended twice"

    def step(self) -> None:
        self.now += self.random.choice([0.0, 0.01, 0.5, 3.0])
        worker = f"w{self.random.randrange(4)}"
        hand = self.in_hand.setdefault(worker, set())
        what = self.random.choice(
            [
                "submit",
                "join",
                "left",
                "poll",
                "poll",
                "deliver",
                "deliver",
                "again",
                "tick",
                "beat",
                "back",
                "withdraw",
            ]
        )
        if what == "submit":
            task = self.random.choice("abcdefgh") * 64
            if task not in self.core.tasks:
                self.wanted[task] += 1
            share, ahead = self.random.choice("xyz"), self.random.random() < 0.2
            self.send(e.Submitted(self.now, task, "film", share=share, group=self.random.choice("fg"), ahead=ahead))
        elif what == "join":
            if self.random.random() < 0.5:
                hand.clear()
            self.join(worker, hand)
        elif what == "left":
            if self.random.random() < 0.5:  # else only its link was lost, and it computes on
                hand.clear()
            self.send(e.Left(self.now, worker, blame=self.random.random() < 0.7))
        elif what == "poll":
            self.polls += 1
            holding = tuple(task for task, _ in hand)
            self.send(e.Polled(self.now, worker, self.polls, holding, self.random.random() < 0.7))
        elif what in ("deliver", "back") and hand:
            task, attempt = self.random.choice(sorted(hand))
            hand.discard((task, attempt))
            self.old.append((worker, task, attempt))
            if what == "back":
                self.send(e.HandedBack(self.now, worker, task, attempt, "e1"))
            else:
                self.deliver(worker, task, attempt, self.random.choice(["done", "done", "refused", "crashed"]))
        elif what == "again" and self.old:
            self.deliver(*self.random.choice(self.old), "done")
        elif what == "tick":
            self.send(e.Tick(self.now))
        elif what == "beat":
            self.send(e.Beat(self.now, worker))
        elif what == "withdraw" and self.random.random() < 0.3:
            self.send(e.Withdrawn(self.now, self.random.choice("abcdefgh") * 64))

    def join(self, worker: str, hand: set[tuple[str, int]]) -> None:
        """Say hello with all that is in hand; afterwards each is leased to this worker or it was told to stop."""
        told = set()
        for command in self.core.handle(e.Joined(self.now, worker, "film", holding=tuple(sorted(hand)))):
            if isinstance(command, e.Stop) and command.worker == worker:
                told.add((command.task_id, command.attempt))
        kept = {(lease.task_id, lease.attempt) for lease in self.core.held_by(worker)}
        assert kept == hand - told, "a returned worker keeps what it was told to drop, or the other way round"
        self.old += [(worker, task, attempt) for task, attempt in told]
        hand -= told
        self.check()

    def deliver(self, worker: str, task: str, attempt: int, verdict: str) -> None:
        epoch = self.random.choice(["e1", "e1", "e1", "e0"])
        leases = (self.core.leases.get(task), self.core.hedges.get(task))
        rightful = epoch == "e1" and any(own and (own.worker, own.attempt) == (worker, attempt) for own in leases)
        before = self.accepted[task]
        self.send(e.Delivered(self.now, worker, task, attempt, epoch, verdict))  # type: ignore[arg-type]
        assert self.accepted[task] - before == (rightful and verdict == "done"), "a fenced delivery was accepted"

    def settle(self) -> None:
        """One honest worker comes; everything that is still wanted must end."""
        self.send(e.Joined(self.now, "honest", "film"))
        for worker in ("w0", "w1", "w2", "w3"):
            self.send(e.Left(self.now, worker))
        for _ in range(200):
            if not self.core.tasks:
                break
            self.polls += 1
            self.in_hand["honest"] = set()
            self.send(e.Polled(self.now, "honest", self.polls, hold=False))
            for task, attempt in self.in_hand["honest"]:
                self.send(e.Delivered(self.now, "honest", task, attempt, "e1", "done"))
        assert self.core.tasks == {}, "work was left lying"
        assert self.ended == +self.wanted


@settings(max_examples=150, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32), steps=st.integers(1, 150))
def test_random_histories_keep_the_invariants(seed: int, steps: int) -> None:
    """Whatever dies, is lost, comes late or twice: each task ends once, fenced results stay out, slots are kept."""
    world = FaultyWorld(seed)
    for _ in range(steps):
        world.step()
    world.settle()


@pytest.mark.parametrize("mutation", ["_fence", "_requeue"])
def test_the_invariants_notice_a_broken_core(mutation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With fencing off, or with tasks of lost workers dropped, the random histories fail: the check has teeth."""
    if mutation == "_fence":
        monkeypatch.setattr(Scheduler, "_fence", lambda self, *what: "" if what[1] in self.leases else "ended")
    else:
        monkeypatch.setattr(
            Scheduler, "_requeue", lambda self, lease, *_, **__: self.leases.pop(lease.task_id) and []
        )
    with pytest.raises((AssertionError, KeyError)):
        live_through_histories(50, 100)


def live_through_histories(count: int, steps: int) -> None:
    """So many random histories, one after the other."""
    for seed in range(count):
        world = FaultyWorld(seed)
        for _ in range(steps):
            world.step()
        world.settle()


def test_the_same_events_give_the_same_commands() -> None:
    """Replaying a history through a new core gives command for command the same: nothing hides in clocks or order."""
    world = FaultyWorld(7)
    events: list[e.Event] = []
    commands: list[list[e.Command]] = []
    handle = world.core.handle

    def recording(event: e.Event) -> list[e.Command]:
        events.append(event)
        commands.append(handle(event))
        return commands[-1]

    world.core.handle = recording  # type: ignore[method-assign]
    for _ in range(300):
        world.step()
    again = Scheduler("e1", attempts=3, silence_s=6.0)
    for _ in range(8):
        again._durations.note("film", 0.1)
    assert [again.handle(event) for event in events] == commands
