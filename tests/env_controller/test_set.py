"""Real processes: a router, a controller, workers that can be killed; what a client sees of their faults."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from luxloop import __version__
from luxloop.bus import Heard, Inbox, ask_for
from luxloop.bus.frame import decode, encode
from luxloop.bus.keys import at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.client import Answer, Client
from luxloop.errors import RemoteError
from luxloop.failure import Failure
from luxloop.messages import Done, Heartbeat, Hello, Outcome, Pull, Receipt, Submit, Task
from luxloop.settings import Settings
from tests.conftest import handles, processes_with, start, stop, wait_for
from tests.forks import Process
from tests.running_set import RunningSet

SLEEPY = str(Path(__file__).parents[1] / "sleepy_worker.py")


def task(what: str = "nothing", **inputs: float) -> Task:
    """A task for the sleepy worker."""
    return Task(kind="sleepy", inputs={"what": what, **inputs}, version=__version__)


class Set(RunningSet):
    """A set with sleepy workers."""

    def add_worker(self) -> Process:
        """One more worker process."""
        return self.add(SLEEPY)

    def running(self) -> None:
        """Wait until a task is in a worker's hands."""
        wait_for(lambda: self.client.status(5.0).running, "a lease")

    def later(
        self, wanted: Task, patience_s: float = 30.0, limit_s: float = 600.0
    ) -> tuple[threading.Thread, list[Answer | Failure]]:
        """Ask in a thread; the list gets the answer or the failure."""
        got: list[Answer | Failure] = []

        def ask() -> None:
            try:
                with Client(self.settings, local=False, patience_s=patience_s) as client:
                    got.append(client.run(wanted, limit_s=limit_s))
            except RemoteError as error:
                got.append(error.failure)

        thread = threading.Thread(target=ask, daemon=True)
        thread.start()
        return thread, got


@pytest.fixture
def processes(settings: Settings) -> Iterator[Set]:
    """A running set with no worker yet."""
    running = Set(settings)
    yield running
    running.close()


def test_a_task_is_computed_and_its_array_arrives_whole(processes: Set) -> None:
    """An array above 1 MB goes by hash and comes out bit for bit; a small one rides in the frame."""
    processes.add_worker()
    for values in (10, 300_000):
        answer = processes.client.run(task("big", values=values))
        np.testing.assert_array_equal(answer.arrays["map"], np.arange(values, dtype="<f8"))


def test_a_large_array_travels_in_pieces_to_another_host(processes: Set, tmp_path: Path) -> None:
    """A client with a cache folder of its own, as on another host, gets the array over the bus."""
    processes.add_worker()
    elsewhere = processes.settings.model_copy(update={"cache": tmp_path / "other host"})
    with Client(elsewhere, local=False) as client:
        answer = client.run(task("big", values=300_000))
    np.testing.assert_array_equal(answer.arrays["map"], np.arange(300_000, dtype="<f8"))


def test_the_same_task_twice_is_computed_once(processes: Set) -> None:
    """A finished result serves whoever asks again; another seed is another task."""
    processes.add_worker()
    first = processes.client.run(task("nap", s=0.2))
    assert processes.client.run(task("nap", s=0.2)).result == first.result
    assert processes.client.status().done == 1
    processes.client.run(task("nap", s=0.21))
    assert processes.client.status().done == 2


@pytest.mark.parametrize(
    ("what", "code", "says"),
    [
        ("refuse", "bad_input", "ask for something else"),
        ("crash", "crashed", "told to crash"),
        ("nan", "crashed", "NaN or infinity in map"),
        ("die", "worker_lost", "attempt 3"),
        ("exit", "crashed", "SystemExit"),
        ("mojibake", "crashed", "caf?"),
        ("unsendable", "crashed", "got '|O'"),
    ],
)
def test_what_goes_wrong_in_a_worker_comes_back_typed(processes: Set, what: str, code: str, says: str) -> None:
    """Bad input, a crash, a NaN and a worker-killing task each end with their code; another task is served after."""
    for _ in range(4):
        processes.add_worker()
    processes.ready(4)
    with pytest.raises(RemoteError) as caught:
        processes.client.run(task(what))
    assert caught.value.failure.code == code
    assert says in caught.value.failure.text()
    assert processes.client.run(task("nothing", number=7)).result["number"] == 7


def test_no_worker_is_said_after_the_patience(processes: Set) -> None:
    """Without a worker of the kind the task ends as no_worker with a hint, not with silence."""
    with Client(processes.settings, local=False, patience_s=0.5) as client, pytest.raises(RemoteError) as caught:
        client.run(task())
    assert caught.value.failure.code == "no_worker"
    assert "luxloop serve" in caught.value.failure.mend


def test_a_worker_killed_in_a_task_is_replaced(processes: Set) -> None:
    """kill -9 while it computes: the next worker gets the task in a later attempt, and the client its answer."""
    victim = processes.add_worker()
    processes.ready(1)
    thread, got = processes.later(task("nap", s=1.0))
    processes.running()
    processes.add_worker()
    os.kill(victim.pid, signal.SIGKILL)
    thread.join(20)
    (answer,) = got
    assert isinstance(answer, Answer)
    assert answer.attempt >= 2


def test_200_tasks_while_workers_are_killed(processes: Set) -> None:
    """Each of 200 tasks is answered once with its own number while workers are killed at random and replaced."""
    rng = random.Random(5)
    for _ in range(2):
        processes.add_worker()
    processes.ready(2)
    finished, kills = threading.Event(), 0
    answers: dict[int, int] = {}

    def ask() -> None:
        wanted = (task("nap", s=0.03, number=number) for number in range(200))
        for number, answer in processes.client.map(wanted, lanes=4):
            assert isinstance(answer, Answer), answer
            assert number not in answers
            answers[number] = answer.result["number"]
        finished.set()

    thread = threading.Thread(target=ask)
    thread.start()
    while not finished.wait(rng.uniform(0.2, 0.6)) and thread.is_alive():
        alive = [worker for worker in processes.workers if worker.poll() is None]
        os.kill(rng.choice(alive).pid, signal.SIGKILL)
        kills += 1
        processes.add_worker()
    thread.join(60)
    assert answers == {number: number for number in range(200)}
    assert kills >= 3


def test_sigterm_finishes_a_short_task_and_leaves(processes: Set) -> None:
    """A worker told to go finishes what takes a second, delivers it, and ends with 0."""
    worker = processes.add_worker()
    processes.ready(1)
    thread, got = processes.later(task("nap", s=1.0))
    processes.running()
    worker.terminate()
    assert worker.wait(60) == 0
    thread.join(60)
    (answer,) = got
    assert isinstance(answer, Answer)
    assert answer.attempt == 1


@pytest.mark.parametrize("what", ["nap", "nap deaf"])
def test_sigterm_hands_back_a_long_task(processes: Set, what: str) -> None:
    """A long task, stoppable or deaf, is not finished but handed back, nothing held against it: the next does it."""
    worker = processes.add_worker()
    processes.ready(1)
    thread, got = processes.later(task(what, s=6.0))
    processes.running()
    worker.terminate()
    assert worker.wait(60) == 0
    wait_for(lambda: processes.client.status(5.0).queued.get("sleepy") == 1, "the task to be back in the queue")
    processes.add_worker()
    thread.join(60)
    (answer,) = got
    assert isinstance(answer, Answer)
    assert answer.attempt == 2
    assert answer.result["pid"] != worker.pid


def test_an_idle_worker_leaves_at_once(processes: Set) -> None:
    """SIGTERM to a worker that waits for work ends it, and it is off the list."""
    worker = processes.add_worker()
    processes.ready(1)
    worker.terminate()
    assert worker.wait(60) == 0
    wait_for(lambda: not processes.client.status().workers, "its absence to be seen")


def test_heartbeats_come_every_second_during_a_task(processes: Set) -> None:
    """While a task runs 5 s, no two heartbeats are more than 2 s apart, and they tell the progress."""
    processes.add_worker()
    processes.ready(1)
    inbox = Inbox()
    with ZenohBus(processes.settings) as bus:
        bus.subscribe(at(processes.settings.realm, "heartbeat"), inbox)
        thread, _ = processes.later(task("nap", s=5.0))
        thread.join(20)
    beats = []
    while (event := inbox.take(0.0)) is not None:
        assert isinstance(event, Heard)
        beats.append(decode(event.frame).expect(Heartbeat))
    working = [beat for beat in beats if beat.task_id == task("nap", s=5.0).id]
    assert len(working) >= 4
    assert max(b.sent_unix_s - a.sent_unix_s for a, b in pairwise(beats)) < 2.0
    assert [b.progress_ratio for b in working] == sorted(b.progress_ratio for b in working)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["stop", "hold gil"])
def test_a_worker_that_falls_silent_is_overtaken_and_fenced(settings: Settings, fault: str) -> None:
    """SIGSTOP, or a C call that holds the GIL: another worker finishes the task; the late result does not count."""
    processes = Set(settings.model_copy(update={"silence_s": 3.0}))
    try:
        victim = processes.add_worker()
        processes.ready(1)
        wanted = task("hold gil", s=8.0) if fault == "hold gil" else task("nap", s=2.0)
        thread, got = processes.later(wanted)
        processes.running()
        if fault == "stop":
            os.kill(victim.pid, signal.SIGSTOP)
        processes.add_worker()
        if fault == "stop":
            thread.join(20)
            os.kill(victim.pid, signal.SIGCONT)
            wait_for(lambda: processes.client.status().fenced >= 1 or processes.client.status().done >= 1, "the end")
            (answer,) = got
            assert isinstance(answer, Answer)
            assert answer.attempt == 2
        else:
            wait_for(lambda: processes.client.status().requeued >= 1, "the silence to be noticed")
            wait_for(lambda: processes.client.status().fenced >= 1, "the late result", 30.0)
        assert processes.client.run(task("nothing", number=3)).result["number"] == 3
    finally:
        processes.close()


def test_a_router_restart_loses_nothing(processes: Set) -> None:
    """Kill and restart the router while a task runs: the worker goes on, delivers, nothing is begun anew."""
    processes.add_worker()
    processes.ready(1)
    thread, got = processes.later(task("nap", s=4.0))
    processes.running()
    stop(processes.router)
    time.sleep(1.0)
    processes.router = start(processes.settings, "-m", "luxloop", "serve", "router", "--quiet")
    thread.join(40)
    (answer,) = got
    assert isinstance(answer, Answer)
    assert answer.attempt == 1
    assert processes.client.run(task("nothing", number=4)).result["number"] == 4


def test_a_controller_restart_loses_nothing(processes: Set) -> None:
    """Kill the controller while a task runs: the only worker says hello at once, long before its task would end."""
    processes.add_worker()
    processes.ready(1)
    before = processes.client.status().epoch
    thread, got = processes.later(task("nap", s=6.0), patience_s=5.0)
    processes.running()
    stop(processes.controller)
    processes.controller = start(processes.settings, "-m", "luxloop", "serve", "controller", "--quiet")
    thread.join(40)
    (answer,) = got
    assert isinstance(answer, Answer)
    assert processes.client.status().epoch != before


def test_a_second_controller_is_refused(processes: Set) -> None:
    """Two controllers on one realm would lease every task twice; the second ends with a clear error."""
    second = subprocess.run(
        [sys.executable, "-m", "luxloop", "serve", "controller", "--router", processes.settings.router],
        capture_output=True,
        timeout=30,
        check=False,
        text=True,
    )
    assert second.returncode == 1
    assert "already serves" in second.stderr


def test_a_controller_without_a_router_can_be_stopped(settings: Settings) -> None:
    """It waits for the router, and ends with 0 when it is told to; it does not hang in the session's opening."""
    process = start(settings, "-m", "luxloop", "serve", "controller", "--quiet")
    try:
        wait_for(lambda: handles(process.pid, signal.SIGTERM), "the controller to take charge of signals", 60.0)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(1.0)
        process.terminate()
        assert process.wait(20) == 0
    finally:
        stop(process)


def test_leaving_a_map_withdraws_what_is_under_way(processes: Set) -> None:
    """Break out of the loop: the tasks still running are cancelled, the workers free within seconds."""
    for _ in range(3):  # whichever is asked for first, none waits for a nap
        processes.add_worker()
    processes.ready(3)
    wanted = [task("nothing"), task("nap", s=60.0), task("nap", s=61.0)]
    for number, answer in processes.client.map(wanted, lanes=3):
        assert (number, isinstance(answer, Answer)) == (0, True)
        break
    wait_for(lambda: processes.client.status().running == 0, "the tasks to be cancelled", 15.0)
    assert processes.client.run(task("nothing", number=6)).result["number"] == 6


@pytest.mark.slow
def test_a_computation_that_does_not_end_is_ended_with_its_process(processes: Set) -> None:
    """Over its limit and deaf to the cancel: the worker's process ends by itself, and is not counted on."""
    worker = processes.add_worker()
    processes.ready(1)
    thread, got = processes.later(task("nap deaf", s=60.0), limit_s=1.0, patience_s=1.0)
    assert worker.wait(60) == 1
    thread.join(60)
    (failure,) = got
    assert isinstance(failure, Failure)
    assert failure.code == "no_worker"
    assert "over its limit of 1 s" in failure.text()


def test_a_withdrawn_task_is_cancelled_on_the_worker(processes: Set) -> None:
    """After the withdrawal the asker is told `cancelled`, and the worker is free for the next, not after 120 s."""
    processes.add_worker()
    processes.ready(1)
    asker, codes = Client(processes.settings, local=False), list[str]()

    def ask() -> None:
        with pytest.raises(RemoteError) as caught:
            asker.run(task("nap", s=120.0))
        codes.append(caught.value.failure.code)

    thread = threading.Thread(target=ask)
    thread.start()
    processes.running()
    processes.client.withdraw(task("nap", s=120.0))  # another's: not ours to take back
    assert processes.client.status().running == 1
    asker.withdraw(task("nap", s=120.0))
    thread.join(60)
    asker.close()
    assert codes == ["cancelled"]
    begin = time.monotonic()
    processes.client.run(task("nothing", number=5))
    assert time.monotonic() - begin < 60.0


class TestBadMessages:
    """Whatever arrives at the controller is answered, and it goes on."""

    def ask(self, processes: Set, row: str, frame: bytes) -> Failure:
        """Send a frame and return the failure that comes back."""
        with ZenohBus(processes.settings) as bus:
            with pytest.raises(RemoteError) as caught:
                ask_for(bus, at("luxloop", row, kind="sleepy"), frame, 5.0)
            assert processes.client.status().version == __version__
            return caught.value.failure

    def test_garbage(self, processes: Set) -> None:
        """Bytes that are no frame."""
        assert self.ask(processes, "submit", b"garbage" * 10).code == "bad_input"

    def test_every_truncation_is_named(self, processes: Set) -> None:
        """A frame cut short anywhere is refused as such."""
        frame = encode(Submit(task=task(), asker="me"))
        for length in range(0, len(frame) - 8, 37):  # the last bytes may be padding
            assert self.ask(processes, "submit", frame[:length]).field in ("frame", "Submit", "schema", "kind")

    def test_another_schema_version(self, processes: Set) -> None:
        """A message of another schema is refused with both numbers and the mend."""
        frame = encode(Submit(task=task(), asker="me")).replace(b'"schema": 1', b'"schema": 2')
        failure = self.ask(processes, "submit", frame)
        assert (failure.field, failure.value, failure.allowed) == ("schema", "2", "1")
        assert "same release" in failure.mend

    def test_another_release(self, processes: Set) -> None:
        """A task of another release is refused, naming both."""
        other = Task(kind="sleepy", inputs={}, version="99.0")
        failure = self.ask(processes, "submit", encode(Submit(task=other, asker="me")))
        assert failure.code == "version"
        assert "99.0" in failure.message
        assert __version__ in failure.message

    def test_a_message_on_the_wrong_key(self, processes: Set) -> None:
        """A heartbeat is no question."""
        failure = self.ask(processes, "submit", encode(Heartbeat(worker="w", kind="sleepy")))
        assert (failure.field, failure.value) == ("message", "'Heartbeat'")

    def test_a_stranger_s_result_is_fenced(self, processes: Set) -> None:
        """A result for a task the sender was never given is not accepted, and changes nothing."""
        outcome = Outcome(task_id=task().id, result={})
        done = Done(worker="stranger", kind="sleepy", attempt=1, epoch="e0", outcome=outcome)
        with ZenohBus(processes.settings) as bus:
            receipt = ask_for(bus, at("luxloop", "done", kind="sleepy"), done, 5.0).expect(Receipt)
        assert not receipt.accepted
        assert processes.client.status().done == 0

    def test_a_pull_of_another_epoch(self, processes: Set) -> None:
        """A worker of before the restart is told to say hello again."""
        pull = encode(Pull(worker="w1", kind="sleepy", epoch="old"))
        assert self.ask(processes, "pull", pull).code == "stale"

    def test_a_worker_of_another_release(self, processes: Set) -> None:
        """It is not let in."""
        from luxloop.messages import Describe

        describe = Describe(worker="w1", kind="sleepy", version="99.0", host="h", pid=1)
        assert self.ask(processes, "hello", encode(Hello(describe=describe))).code == "version"


def test_a_client_starts_what_it_needs_and_stops_it(settings: Settings) -> None:
    """With nothing running the client starts a set of processes, uses it, and leaves none of them behind."""
    with Client(settings) as client:
        assert client.settings.router != settings.router
        status = client.status()
        assert status.version == __version__
    with pytest.raises(RemoteError):
        Client(client.settings, local=False)


@pytest.mark.parametrize("after_s", [0.4, 0.8, 1.2, None])
def test_a_killed_client_leaves_no_processes(settings: Settings, after_s: float | None) -> None:
    """kill -9 of a client that starts a set, at any moment of the start or after it: all of it ends by itself."""
    code = (
        "import time\nfrom luxloop.client import Client\nfrom luxloop.settings import Settings\n"
        "client = Client(Settings())\nprint('ready', flush=True)\ntime.sleep(60)\n"
    )
    environment = os.environ | {"LUXLOOP_ROUTER": settings.router, "LUXLOOP_CACHE": str(settings.cache)}
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    if after_s is None:
        assert process.stdout.readline() == "ready\n"
        assert len(processes_with(f"LUXLOOP_CACHE={settings.cache}")) >= 4
    else:
        time.sleep(after_s)
    process.kill()
    process.wait()
    process.stdout.close()
    wait_for(lambda: not processes_with(f"LUXLOOP_CACHE={settings.cache}"), "the set to end", 15.0)
