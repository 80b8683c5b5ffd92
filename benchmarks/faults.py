"""What a client notices of faults: the time until it has its answer when a worker, a router, a controller fails.

    python benchmarks/faults.py [--long]

Each row: a task under way, one fault, and the seconds from the fault to the answer at the client beyond what the rest
of the computation takes. `--long` adds a task of 60 s and the longest gap between its heartbeats.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import threading
import time
from contextlib import suppress
from itertools import pairwise

from benchmarks.processes import SLEEPY, Processes, percentile, table, wait_for
from luxloop import __version__
from luxloop.bus import Heard, Inbox
from luxloop.bus.frame import decode
from luxloop.bus.keys import at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.client import Answer
from luxloop.errors import RemoteError
from luxloop.messages import Heartbeat, Task

NAP_S = 1.0


def task(what: str = "nap", s: float = NAP_S, number: int = 0) -> Task:
    """A task of the sleepy worker."""
    return Task(kind="sleepy", inputs={"what": what, "s": s, "number": number}, version=__version__)


class Asking(threading.Thread):
    """Asks for one task and notes when the answer came."""

    def __init__(self, processes: Processes, wanted: Task) -> None:
        super().__init__(daemon=True)
        self._processes, self._wanted = processes, wanted
        self.answered_s = 0.0
        self.answer: Answer | None = None
        self.start()
        wait_for(lambda: processes.client.status(5.0).running == 1)

    def run(self) -> None:
        """Ask and wait."""
        with suppress(RemoteError):  # a row that is over before its answer closes the client; others notice
            self.answer = self._processes.client.run(self._wanted)
            self.answered_s = time.monotonic()


def lost_s(asking: Asking, fault_s: float, rest_s: float) -> str:
    """Seconds the fault cost, and which attempt answered."""
    asking.join(60)
    if asking.answer is None:
        raise RuntimeError("no answer")
    return f"{asking.answered_s - fault_s - rest_s:.2f} s, attempt {asking.answer.attempt}"


def kill_worker() -> str:
    """SIGKILL of the worker that computes; another waits."""
    with Processes((SLEEPY,), (SLEEPY,)) as processes:
        asking = Asking(processes, task())
        holder = next(w for w in processes.client.status().workers if w.task_id).describe.pid
        begin = time.monotonic()
        os.kill(holder, signal.SIGKILL)
        return lost_s(asking, begin, NAP_S)


def silence(what: str) -> str:
    """The worker that computes is stopped, or holds the GIL; another waits. Silence is noticed after `silence_s`."""
    with Processes((SLEEPY,), (SLEEPY,)) as processes:
        asking = Asking(processes, task("hold gil", 12.0) if what == "gil" else task())
        holder = next(w for w in processes.client.status().workers if w.task_id).describe
        begin = time.monotonic()
        if what == "stop":
            os.kill(holder.pid, signal.SIGSTOP)
        took = wait_for(lambda: processes.client.status().requeued == 1)
        if what == "stop":
            lost = lost_s(asking, begin, NAP_S)
            os.kill(holder.pid, signal.SIGCONT)
            return f"requeued after {took:.2f} s; {lost}"
        wait_for(lambda: processes.client.status().fenced == 1)
        return f"requeued after {took:.2f} s, the late result fenced after {time.monotonic() - begin:.2f} s"


def restart(which: str) -> str:
    """The router, or the controller, is killed while a task runs, and started again at once."""
    with Processes((SLEEPY,)) as processes:
        asking = Asking(processes, task(s=2.0))
        begin = time.monotonic()
        victim = processes.router if which == "router" else processes.controller
        victim.kill()
        victim.wait()
        again = processes.start("-m", "luxloop", "serve", which, "--quiet")
        if which == "router":
            processes.router = again
        else:
            processes.controller = again
        return lost_s(asking, begin, 2.0)


def random_kills(tasks: int, seed: int) -> str:
    """Tasks of 30 ms while workers are killed with -9 at random moments and replaced."""
    rng = random.Random(seed)
    answers: dict[int, int] = {}
    twice = kills = 0
    with Processes((SLEEPY,), (SLEEPY,)) as processes:
        done = threading.Event()

        def ask() -> None:
            nonlocal twice
            for number, answer in processes.client.map((task("nap", 0.03, n) for n in range(tasks)), lanes=4):
                if isinstance(answer, Answer):
                    twice += number in answers
                    answers[number] = answer.result["number"]
            done.set()

        threading.Thread(target=ask, daemon=True).start()
        while not done.wait(rng.uniform(0.1, 0.4)):
            alive = [worker for worker in processes.workers if worker.poll() is None]
            rng.choice(alive).kill()
            kills += 1
            processes.workers.append(processes.start(SLEEPY))
        requeued = processes.client.status().requeued
    right = sum(answers.get(n) == n for n in range(tasks))
    return (
        f"{right} of {tasks} answered once with their own number, {twice} twice, {kills} kills, {requeued} requeued"
    )


def heartbeat_gap(s: float) -> str:
    """Longest time between two heartbeats while a task of `s` seconds runs."""
    inbox, sent = Inbox(), []
    with Processes((SLEEPY,)) as processes, ZenohBus(processes.settings) as bus:
        bus.subscribe(at(processes.settings.realm, "heartbeat"), inbox)
        asking = Asking(processes, task("nap deaf", s))
        while asking.is_alive():
            event = inbox.take(1.0)
            if isinstance(event, Heard):
                sent.append(decode(event.frame).expect(Heartbeat).sent_unix_s)
    gaps = [later - earlier for earlier, later in pairwise(sent)]
    return f"longest gap {max(gaps):.2f} s, p50 {percentile(gaps, 50):.2f} s, {len(sent)} heartbeats"


def main(long: bool) -> None:
    """Print the table."""
    rows = [
        ["kill -9 of the worker, another idle", kill_worker()],
        ["SIGSTOP of the worker, another idle (silence_s 6)", silence("stop")],
        ["worker holds the GIL 12 s, another idle (silence_s 6)", silence("gil")],
        ["kill -9 and restart of the router", restart("router")],
        ["kill -9 and restart of the controller", restart("controller")],
        ["200 tasks, workers killed at random", random_kills(200, 1)],
    ]
    if long:
        rows.append(["a task of 60 s that never looks up", heartbeat_gap(60.0)])
    table("faults: what they cost the client", rows, ["fault", "measured"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--long", action="store_true")
    main(parser.parse_args().long)
