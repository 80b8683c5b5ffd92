"""The dispatch core in random histories of a faulty world, against what must always hold."""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env_controller import events as e
from env_controller.scheduler import Scheduler


class FaultyWorld:
    """Workers that die, fall silent, lose and repeat messages, around one scheduler; checks after every event."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.core = Scheduler("e1", attempts=3, silence_s=6.0)
        for _ in range(8):  # so that what takes over 2 s is slow, and hedged
            self.core._durations.note("film", 0.1)
        self.now, self.polls = 0.0, 0
        self.slots = {"w0": 1, "w1": 1, "w2": 2, "w3": 2}
        self.wanted: Counter[str] = Counter()
        self.ended: Counter[str] = Counter()
        self.in_hand: dict[str, set[tuple[str, int]]] = {}  # what each worker believes it holds
        self.old: list[tuple[str, str, int]] = []  # deliveries that may come again
        self.accepted: Counter[str] = Counter()

    def send(self, event: e.Event) -> None:
        commands = self.core.handle(event)
        self.check_tries(commands)
        for command in commands:
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
            assert core.leases[task].worker != hedge.worker, "hedged by itself"
        assert all(name in core.workers for name in core.polls.values()), "a poll of a lost worker"
        for task, times in self.wanted.items():
            assert self.ended[task] + (task in core.tasks) == times, "a task was lost or ended twice"

    def check_tries(self, commands: list[e.Command]) -> None:
        """Who failed in a task gets it again only where all others have, too."""
        for command in commands:
            if isinstance(command, e.Grant) and command.task_id in self.core.tasks:
                failed = {one.worker for one in self.core.tasks[command.task_id].failures}
                assert command.worker not in failed or set(self.core.workers) <= failed, "tried again by the same"

    def step(self) -> None:
        self.now += self.random.choice([0.0, 0.01, 0.5, 3.0])
        worker = f"w{self.random.randrange(4)}"
        hand = self.in_hand.setdefault(worker, set())
        what = self.random.choice(
            [
                "submit",
                "join",
                "left",
                "cut",
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
        elif what == "cut":  # and it computes on what it was told to drop, too: more than it has slots for
            self.send(e.Left(self.now, worker, blame=False))
            hand |= {(task, attempt) for name, task, attempt in self.old if name == worker}
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
        """Say hello with all that is in hand; afterwards each is leased to this worker or it was told to stop.

        What was leased and is not in hand may be on its way.
        """
        told, before = set(), {(lease.task_id, lease.attempt) for lease in self.core.held_by(worker)}
        for command in self.core.handle(e.Joined(self.now, worker, "film", self.slots[worker], tuple(sorted(hand)))):
            if isinstance(command, e.Stop) and command.worker == worker:
                told.add((command.task_id, command.attempt))
        kept = {(lease.task_id, lease.attempt) for lease in self.core.held_by(worker)}
        assert kept >= hand - told, "a returned worker lost what it was not told to drop"
        assert kept <= before | hand, "a returned worker was given what it neither held nor named"
        assert not kept & told, "a returned worker keeps what it was told to drop"
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


def lived(seed: int, steps: int) -> tuple[list[e.Event], list[list[e.Command]]]:
    """The events of a random history, and what the core wanted done at each."""
    world = FaultyWorld(seed)
    events: list[e.Event] = []
    commands: list[list[e.Command]] = []
    handle = world.core.handle

    def recording(event: e.Event) -> list[e.Command]:
        events.append(event)
        commands.append(handle(event))
        return commands[-1]

    world.core.handle = recording  # type: ignore[method-assign]
    for _ in range(steps):
        world.step()
    return events, commands


def live_again(events: list[e.Event]) -> list[list[e.Command]]:
    """What a new core wants done at the same events."""
    again = Scheduler("e1", attempts=3, silence_s=6.0)
    for _ in range(8):
        again._durations.note("film", 0.1)
    return [again.handle(event) for event in events]


def test_the_same_events_give_the_same_commands() -> None:
    """Replaying a history through a new core gives command for command the same: nothing hides in clocks or order."""
    events, commands = lived(7, 300)
    assert live_again(events) == commands


@pytest.mark.parametrize("seed", range(20))
def test_time_in_which_we_were_deaf_is_as_if_it_had_not_been(seed: int) -> None:
    """With 50 s before every tick in which nobody listened, the core wants the same done at each event."""
    plain, deaf, later_s = [], [], 0.0
    for event in lived(seed, 300)[0]:
        at_s = int(event.at_s * 64) / 64  # sums of these are exact
        plain.append(replace(event, at_s=at_s))
        later_s += 50.0 * isinstance(event, e.Tick)
        gap = {"deaf_s": 50.0} if isinstance(event, e.Tick) else {}
        deaf.append(replace(event, at_s=at_s + later_s, **gap))
    assert live_again(deaf) == live_again(plain)
