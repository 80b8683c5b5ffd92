"""The dispatch core alone: its rules one by one."""

from __future__ import annotations

import pytest

from env_controller import events as e
from tests.env_controller.stories import A, B, Story


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


def test_the_limit_of_a_task_is_the_longest_that_was_asked_for() -> None:
    """A campaign's task that a client has asked for before, with little patience."""
    story = Story()
    story.join()
    story.submit(limit_s=10.0)
    story.poll()
    story.submit(limit_s=100.0)
    story.submit(limit_s=1.0)
    for second in range(1, 101):
        story.core.handle(e.Beat(float(second), "w1"))
        assert story.core.handle(e.Tick(float(second))) == []
    assert story.core.handle(e.Tick(100.5)) == [e.Stop("w1", A, 1)]


def test_time_in_which_we_were_deaf_is_held_against_nobody() -> None:
    """Not against a worker's silence, a task's limit or its asker's patience; afterwards all go on as before."""
    story = Story(silence_s=6.0)
    story.join()
    story.submit(limit_s=10.0)
    story.poll()
    story.core.handle(e.Submitted(0.0, B, "ray", patience_s=10.0))
    assert story.core.handle(e.Tick(5.0)) == []
    assert story.core.handle(e.Tick(55.0, deaf_s=50.0)) == []
    story.core.handle(e.Beat(56.0, "w1"))
    assert story.core.handle(e.Tick(60.0)) == []
    assert story.core.handle(e.Tick(60.5)) == [e.Stop("w1", A, 1), e.Finish(B, "no_worker")]


def test_a_silent_worker_is_overtaken_although_we_were_deaf() -> None:
    """Nothing was heard of it before, nor in the time that counts."""
    story = Story(silence_s=6.0).leased()
    assert story.core.handle(e.Tick(55.0, deaf_s=50.0)) == []
    assert story.core.handle(e.Tick(56.0)) == []
    assert story.core.handle(e.Tick(56.5)) == [e.Stop("w1", A, 1)]


def test_who_was_heard_when_we_came_to_is_silent_from_then_on() -> None:
    """The beat lay in the inbox of a controller that was deaf for 50 s: it does not count for the 50 s to come."""
    story = Story(silence_s=6.0).leased()
    story.core.handle(e.Beat(50.0, "w1"))
    assert story.core.handle(e.Tick(50.0, deaf_s=50.0)) == []
    assert story.core.handle(e.Tick(56.5)) == [e.Stop("w1", A, 1)]


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


class TestElsewhere:
    """What a worker failed in is not given to it again while another one of its kind is listed."""

    def test_it_waits_for_the_other_one(self) -> None:
        """However busy that is; meanwhile the one that failed gets what else there is."""
        story = Story().leased("w2", B)
        story.leased("w1", A)
        story.deliver("w1", A, verdict="crashed")
        assert story.poll("w1") == []
        assert story.submit("c" * 64) == [e.Grant(story.polls, "w1", "c" * 64, 1)]
        story.deliver("w2", B)
        assert story.poll("w2") == [e.Grant(story.polls, "w2", A, 2)]

    def test_one_broken_worker_fails_no_task(self) -> None:
        """It fails in each of them once, as fast as it can; the other one, which takes its time, in none."""
        story, tasks = Story(attempts=3), [f"{number:064x}" for number in range(5)]
        story.leased("good", B)
        story.join("broken")
        for task in tasks:
            story.submit(task)
            assert story.granted("broken") == task
            story.deliver("broken", task, verdict="crashed")
        assert story.poll("broken") == []
        story.deliver("good", B)
        found = []
        for _ in tasks:
            found.append(story.granted("good"))
            story.deliver("good", found[-1], attempt=2)
        assert sorted(found) == tasks
        assert (story.core.counts["done"], story.core.counts["failed"]) == (6, 0)

    def test_where_all_have_failed_any_may_try_again(self) -> None:
        """And alone a worker gets it at once."""
        story = Story(attempts=4).leased()
        story.deliver(verdict="crashed")
        assert story.poll("w1") == [e.Grant(story.polls, "w1", A, 2)]
        story.join("w2")
        story.deliver("w1", attempt=2, verdict="crashed")
        assert story.granted("w2") == A
        story.deliver("w2", attempt=3, verdict="crashed")
        assert story.poll("w1") == [e.Grant(story.polls, "w1", A, 4)]

    def test_it_is_given_back_when_the_other_one_has_gone(self) -> None:
        """The next tick gives it to who waits."""
        story = Story().leased()
        story.join("w2")
        story.deliver(verdict="crashed")
        assert story.poll("w1") == []
        story.core.handle(e.Left(0.0, "w2"))
        assert story.core.handle(e.Tick(0.25)) == [e.Grant(story.polls, "w1", A, 2)]

    def test_not_even_where_it_has_its_group(self) -> None:
        """Of two that wait the one that had the anchor is preferred, but not for what it failed in."""
        story = Story()
        story.join("w1")
        story.submit(A, group="anchor")
        story.poll("w1")
        story.join("w2")
        story.deliver("w1", verdict="crashed")
        assert story.poll("w1") == []
        assert story.poll("w2") == [e.Grant(story.polls, "w2", A, 2)]

    def test_who_comes_back_with_it_has_not_failed(self) -> None:
        """Its link was cut: once it is handed back, the same worker may have it."""
        story = Story().leased()
        story.join("w2")
        story.core.handle(e.Left(0.0, "w1"))
        story.join("w1", (A, 1))
        story.core.handle(e.HandedBack(0.0, "w1", A, 1, "e1"))
        assert story.poll("w1") == [e.Grant(story.polls, "w1", A, 2)]


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


@pytest.mark.parametrize("in_hand", [False, True])
def test_patience_begins_when_the_last_worker_goes(in_hand: bool) -> None:
    """What waited behind a busy worker, or was in its hands, has not been waiting for one to come."""
    story = Story().leased("w1", B)
    story.submit(A, patience_s=5.0)
    if in_hand:
        story.deliver("w1", B)
        assert story.granted("w1") == A
    story.core.handle(e.Left(100.0, "w1"))
    assert story.core.handle(e.Tick(104.0)) == []
    (finish,) = story.core.handle(e.Tick(106.0))
    assert isinstance(finish, e.Finish)
    assert (finish.task_id, finish.code) == (A, "no_worker")


def test_withdrawing_stops_the_worker() -> None:
    """A withdrawn task ends as cancelled, which is no failure; its worker is told, its result no longer counts."""
    story = Story().leased()
    assert story.core.handle(e.Withdrawn(1.0, A)) == [e.Stop("w1", A, 1), e.Finish(A, "cancelled")]
    assert story.core.counts["failed"] == 0
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

    def test_it_goes_on_with_no_more_than_it_has_places_for(self) -> None:
        """Back with one place less: the first stays, the other is dropped and waits for another worker."""
        story = Story()
        story.join("w1", slots=2)
        for task in (A, B):
            story.submit(task)
            story.poll("w1", holding=tuple(story.core.leases))
        story.core.handle(e.Left(1.0, "w1"))
        assert story.join("w1", (A, 1), (B, 1), slots=1) == [e.Stop("w1", B, 1)]
        assert [lease.task_id for lease in story.core.held_by("w1")] == [A]
        assert B in story.core.ready["film"]

    def test_it_is_stopped_where_the_task_has_ended(self) -> None:
        """Withdrawn or done meanwhile: drop it."""
        story = Story().leased()
        story.core.handle(e.Left(1.0, "w1"))
        story.core.handle(e.Withdrawn(1.0, A))
        assert story.join("w1", (A, 1)) == [e.Stop("w1", A, 1)]

    def test_without_it_the_next_poll_tells(self) -> None:
        """Back with empty hands the lease may be on its way; who polls without it never got it, nobody to blame."""
        story = Story().leased()
        assert story.join("w1") == []
        assert story.core.leases[A].attempt == 1
        assert story.poll() == [e.Grant(2, "w1", A, 2)]
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
