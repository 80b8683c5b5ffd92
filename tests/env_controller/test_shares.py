"""Whose turn it is at the dispatch core: shares, films, what is wanted ahead, and slow tasks that are hedged."""

from __future__ import annotations

from typing import Any

import pytest

from env_controller import events as e
from env_controller.scheduler import GROUPS
from env_controller.waiting import LOOK_AHEAD, group_of
from luxloop.messages import Task
from tests.env_controller.stories import A, B, Story


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
    assert story.core.counts["hedged"] == 1


def test_of_two_slow_tasks_the_older_is_hedged() -> None:
    """It is the likelier to hang; the younger is next."""
    story = slow_story()
    story.submit(B)
    story.poll("w2")
    story.now += 10.0
    for worker, task in (("w3", A), ("w4", B)):
        story.join(worker)
        assert story.poll(worker) == [e.Grant(story.polls, worker, task, 2)]


def test_nobody_hedges_its_own_task() -> None:
    """A place that its own worker has free is no second worker."""
    story = slow_story()
    story.join("w1", (A, 1), slots=2)
    assert story.poll("w1", holding=(A,)) == []
    assert story.poll("w2") == [e.Grant(story.polls, "w2", A, 2)]


def test_what_is_slow_goes_by_the_time_that_tasks_run() -> None:
    """Not by how long they had to wait: eight waited for a hundred seconds and ran for a tenth of one."""
    story = Story(silence_s=60.0)
    tasks = [f"{number}" * 64 for number in range(8)]
    for task in tasks:
        story.submit(task)
    story.now += 100.0
    story.join("w1")
    for task in tasks:
        assert story.granted("w1") == task
        story.now += 0.1
        story.deliver("w1", task)
    story.leased("w1", A)
    story.now += 3.0
    story.join("w2")
    assert story.poll("w2") == [e.Grant(story.polls, "w2", A, 2)]


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


@pytest.mark.parametrize(("crashed", "goes_on"), [(("w1", 1), ("w2", 2)), (("w2", 2), ("w1", 1))])
def test_no_task_ends_while_another_lease_of_it_runs(crashed: tuple[str, int], goes_on: tuple[str, int]) -> None:
    """Its last attempt failed here and goes on there: it is done if that is, and only then set aside if not."""
    for verdict, code in (("done", "done"), ("crashed", "crashed")):
        story = slow_story()
        story.core.attempts = 1
        story.poll("w2")
        worker, attempt = crashed
        assert story.deliver(worker, A, attempt, "crashed") == [e.Receive(worker, A, attempt, accepted=True)]
        worker, attempt = goes_on
        *_, finish = story.deliver(worker, A, attempt, verdict)
        assert isinstance(finish, e.Finish)
        assert (finish.code, len(finish.history)) == (code, 1 + (verdict == "crashed"))


def test_a_lease_that_outlived_the_last_failure_may_be_handed_back() -> None:
    """Nobody is to blame for that: the task is given away once more."""
    story = slow_story()
    story.core.attempts = 1
    story.poll("w2")
    story.deliver("w2", A, 2, "crashed")
    story.core.handle(e.HandedBack(story.now, "w1", A, 1, "e1"))
    assert story.poll("w1") == [e.Grant(story.polls, "w1", A, 3)]


def test_who_failed_in_a_task_does_not_hedge_it() -> None:
    """Another one may."""
    story = slow_story()
    story.deliver("w1", A, 1, "crashed")
    assert story.poll("w2") == [e.Grant(story.polls, "w2", A, 2)]
    story.now += 10.0
    assert story.poll("w1") == []
    story.join("w3")
    assert story.poll("w3") == [e.Grant(story.polls, "w3", A, 3)]


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
        task = story.granted()
        order.append(task[0])
        story.deliver("w1", task)
    assert order == ["0", "a", "1", "b", "2", "3"]


def test_a_worker_is_given_the_film_it_had() -> None:
    """Of the next eight; then the oldest goes first."""
    story = Story()
    story.join()
    for number, group in enumerate("fgfggggggf"):
        story.submit(f"{number}" * 64, group=group)
    order = []
    for _ in range(10):
        task = story.granted()
        order.append(int(task[0]))
        story.deliver("w1", task)
    assert order == [0, 2, 9, 1, 3, 4, 5, 6, 7, 8]


def test_of_idle_workers_the_one_that_had_the_group_gets_the_task() -> None:
    """However long another has waited; if that one is busy, any other, and then both have had it."""
    story = Story(silence_s=60.0)
    story.join("w1")
    story.join("w2")
    story.submit(A, group="anchor")
    story.poll("w1")
    story.poll("w2")  # waits from now on
    story.deliver("w1", A)
    story.poll("w1")
    assert story.submit(B, group="anchor") == [e.Grant(story.polls, "w1", B, 1)]
    third = "c" * 64
    assert story.submit(third, group="anchor") == [e.Grant(story.polls - 1, "w2", third, 1)]
    story.deliver("w1", B)
    story.deliver("w2", third)
    story.poll("w1")
    story.poll("w2")
    assert story.submit("d" * 64, group="another") == [e.Grant(story.polls - 1, "w1", "d" * 64, 1)]
    story.deliver("w1", "d" * 64)
    story.poll("w1")
    assert story.submit("e" * 64, group="anchor") == [
        e.Grant(story.polls - 1, "w2", "e" * 64, 1)
    ]  # the last to have it


@pytest.mark.parametrize(
    ("after_s", "asks", "waited_for"),
    [(0.01, True, True), (0.2, True, True), (0.01, False, True), (0.3, False, False), (1.0, False, False)],
)
def test_the_worker_that_had_the_group_is_waited_for_between_two_tasks(
    after_s: float, asks: bool, waited_for: bool
) -> None:
    """It has delivered and asks in a moment. If it does not, the next sign of another one gives the task to that."""
    story = Story(silence_s=60.0)
    story.join("w1")
    story.join("w2")
    story.submit(A, group="anchor")
    story.poll("w1")
    story.poll("w2")
    waits = story.polls
    story.deliver("w1", A)
    story.now += after_s
    submitted = story.submit(B, group="anchor")
    assert submitted == ([] if waited_for else [e.Grant(waits, "w2", B, 1)])
    if asks:
        assert story.poll("w1") == [e.Grant(story.polls, "w1", B, 1)]
    elif waited_for:
        assert story.core.handle(e.Beat(story.now, "w2")) == [e.Grant(waits, "w2", B, 1)]


def had_by_w1(**options: float) -> Story:
    """w1 has had a task of the group "anchor"; w2 waits, since before."""
    story = Story(**options)
    story.join("w1")
    story.join("w2")
    story.submit(A, group="anchor")
    story.poll("w1")
    story.poll("w2")
    story.deliver("w1", A)
    return story


def test_a_worker_whose_link_was_cut_still_has_its_groups() -> None:
    """It says hello again under its name: another process would have another one."""
    story = had_by_w1(silence_s=60.0)
    story.join("w1")
    story.poll("w1")
    assert story.submit(B, group="anchor") == [e.Grant(story.polls, "w1", B, 1)]


def test_a_silent_worker_that_had_the_group_is_passed_over() -> None:
    """So is one that has all that it can hold."""
    story = had_by_w1(silence_s=6.0)
    story.poll("w1")
    story.now += 10.0
    story.core.handle(e.Beat(story.now, "w2"))
    assert story.submit(B, group="anchor") == [e.Grant(story.polls - 1, "w2", B, 1)]
    story = had_by_w1(silence_s=60.0)
    story.poll("w1")
    story.core.polls[99] = "w1"  # a second poll of a worker with one slot
    story.submit(B, group="anchor")
    assert story.submit("c" * 64, group="anchor") == [e.Grant(2, "w2", "c" * 64, 1)]


def test_who_has_the_group_and_waits_is_not_kept_from_it_by_another_who_had_it() -> None:
    """Two have it; one has just delivered, the other is idle."""
    story = had_by_w1(silence_s=60.0)
    story.submit(B, group="anchor")
    story.now += 1.0
    story.core.handle(e.Tick(story.now))
    story.poll("w1")
    story.deliver("w2", B)
    assert story.submit("c" * 64, group="anchor") == [e.Grant(story.polls, "w1", "c" * 64, 1)]


def test_a_task_that_was_left_to_a_worker_that_went_is_given_at_the_next_tick() -> None:
    """Nobody else has to say anything first."""
    story = had_by_w1(silence_s=60.0)
    assert story.submit(B, group="anchor") == []
    story.core.handle(e.Left(story.now, "w1", "gone"))
    story.now += 0.25
    assert story.core.handle(e.Tick(story.now)) == [e.Grant(story.polls, "w2", B, 1)]


def test_what_has_no_group_pushes_none_out() -> None:
    """Small requests between two about the same anchor; of groups only so many are remembered."""
    story = Story(silence_s=60.0)
    story.join("w1")

    def one(task: str, group: str) -> None:
        story.submit(task, group=group)
        story.poll("w1")
        story.deliver("w1", task)

    one(A, "anchor")
    for number in range(2 * GROUPS):
        one(f"{number:064x}", "")
    assert story.core.workers["w1"].groups == ["anchor"]
    for number in range(2 * GROUPS):
        one(f"{number:064x}", f"anchor {number}")
    assert story.core.workers["w1"].groups == [f"anchor {2 * GROUPS - 1 - back}" for back in range(GROUPS)]


def test_the_oldest_of_a_share_is_overtaken_seven_times_at_most() -> None:
    """However many of the worker's last group keep coming."""
    story = Story()
    story.join()
    story.submit(A, group="x")
    story.poll()
    story.submit(B, group="y")
    order = []
    for number in range(20):
        for ahead in (2 * number, 2 * number + 1):
            story.submit(f"{ahead:064x}", group="x")
        story.deliver("w1", A if not order else order[-1])
        order.append(story.granted())
        if order[-1] == B:
            break
    assert order.index(B) == LOOK_AHEAD - 1


def test_one_without_a_group_does_not_overtake() -> None:
    """First come, first served, of tasks of which nothing is known."""
    story = Story()
    story.join()
    story.submit("0" * 64)
    story.poll()
    story.submit(A, group="x")
    story.submit(B)
    story.deliver("w1", "0" * 64)
    assert story.poll() == [e.Grant(story.polls, "w1", A, 1)]


def test_predictions_about_one_anchor_are_a_group() -> None:
    """Whatever is asked of them; another anchor, other exits or no anchor are not."""

    def group(**changes: Any) -> str:
        given = {"shots": ["one"], "columns": [], "anchor": {"histories": 1000, "shots": []}, "exit_seed": "1"}
        return group_of(Task(kind="ray", inputs=given | changes, version="1"))

    anchored = {"histories": 1000, "shots": ["one"]}
    assert group() == group(columns=["environment.receiver.reflectance"]) != ""
    assert group(anchor=anchored) == group(anchor=anchored, shots=["moved"])
    others = (group(shots=["moved"]), group(anchor={"histories": 2000, "shots": []}), group(exit_seed="2"))
    assert len({group(), *others}) == 4
    assert group(anchor=None) == group(anchor="mine") == group(anchor={"histories": 0, "shots": []}) == ""


def test_what_is_wanted_ahead_waits_for_all_else_until_it_is_wanted_now() -> None:
    """A film that may be needed is computed when nothing else is; once asked for in earnest it is like others."""
    story = Story()
    story.join()
    story.submit(A, ahead=True)
    story.submit(B)
    assert story.granted() == B
    story.deliver("w1", B)
    story.submit("c" * 64)
    story.submit(A)
    story.submit("d" * 64)
    assert story.granted() == "c" * 64
    story.deliver("w1", "c" * 64)
    assert story.granted() == A
