"""What a step costs beyond its physics: bus, agent, journal, learner; and how well many workers are kept busy.

    python benchmarks/campaign_overhead.py [--steps 1000] [--workers 64]

Workers that compute nothing answer for PC2 and PC3, with maps of 64 x 64; everything else is real: router, controller
and workers are processes, each step is on the disk before it is told. `fast` is the double DQN with its 4 updates a
step, `random` has no learner. The last tables have workers that sleep 100 ms a task: efficiency is the share of the
whole time that they slept for tasks, plain ones as any client asks for them, or steps of a campaign.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

from agent.campaign import Runner
from agent.config import Campaign, Stop
from agent.designers import designer
from agent.moves import Space
from benchmarks.processes import Processes, percentile, table
from luxloop import __version__
from luxloop.campaign import Step
from luxloop.client import Answer
from luxloop.door import RunDoor
from luxloop.journal.reader import RunJournal
from luxloop.messages import Task
from luxloop.model_file import find_model

PRETEND = str(Path(__file__).parents[1] / "tests" / "pretend_worker.py")


def cpu_s(pid: int) -> float:
    """CPU time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Timed:
    """A door that notes how long each action took."""

    def __init__(self, door: RunDoor) -> None:
        self._door, self.run, self.designer = door, door.run, door.designer
        self.took_ms: list[float] = []

    def act(self, action: object) -> Step:
        """The step, timed."""
        begin_s = time.perf_counter()
        step = self._door.act(action)  # type: ignore[arg-type]
        self.took_ms.append(1e3 * (time.perf_counter() - begin_s))
        return step


def walk(processes: Processes, name: str, lanes: int, steps: int) -> list[object]:
    """A row: time a step, latency, CPU a step of each process, bytes a step."""
    campaign = Campaign(designer=name, lanes=lanes, stop=Stop(evaluations=10**6))
    plan = campaign.plan(f"{name}-{lanes}", find_model("paper"), "paper")
    chooser = designer(name, Space.of(plan), seed=1, lanes=lanes, learning=campaign.learner)
    with RunDoor.begin(processes.client, plan) as opened:
        door = Timed(opened)
        runner = Runner(door, chooser, campaign.stop, lanes=lanes, seed=1)
        runner._stop_wanted = lambda: runner.progress.steps >= steps
        before_s = cpu_s(processes.controller.pid)
        own_s, begin_s = time.process_time(), time.perf_counter()
        runner.run(1)
        wall_s, own_s = time.perf_counter() - begin_s, time.process_time() - own_s
        controller_s = cpu_s(processes.controller.pid) - before_s
        folder = Path(opened.end("done").folder)
    count, seen = len(door.took_ms), runner.progress
    size = sum(path.stat().st_size for path in folder.glob("*.mcap"))
    begin_s = time.perf_counter()
    stored = sum(1 for _ in RunJournal(folder).steps())
    opened_ms = 1e3 * (time.perf_counter() - begin_s)
    assert stored == count
    return [
        name, lanes, count, f"{1e3 * wall_s / count:.2f}",
        f"{percentile(door.took_ms, 50):.1f}", f"{percentile(door.took_ms, 99):.1f}",
        f"{1e3 * controller_s / count:.2f}", f"{1e3 * (own_s - seen.learner_s) / count:.2f}",
        f"{1e3 * seen.learner_s / count:.2f}", f"{size / count:,.0f}", f"{opened_ms:.0f}",
    ]  # fmt: skip


def overhead(steps: int) -> None:
    """The first table."""
    heads = ("designer", "lanes", "steps", "ms a step", "act p50, ms", "p99", "controller CPU ms", "designer CPU ms",
             "learner CPU ms", "bytes a step", "read all, ms")  # fmt: skip
    rows = []
    with Processes((PRETEND, "film"), (PRETEND, "ray"), (PRETEND, "ray")) as processes:
        walk(processes, "random", 2, 100)
        for name, lanes in (("random", 1), ("random", 4), ("ddqn-fast", 1), ("ddqn-fast", 4), ("ddqn-paper", 4)):
            rows.append(walk(processes, name, lanes, steps))
    table("a step beyond its physics, workers that compute nothing", rows, heads)


def efficiency(workers: int, nap_s: float, seconds: float) -> None:
    """The second table: plain tasks, as any client asks for them, then steps of a campaign."""
    rows = []
    with Processes((PRETEND, "film"), *([(PRETEND, "ray", str(nap_s))] * workers)) as processes:
        tasks = int(workers * seconds / nap_s)
        begin_s = time.perf_counter()
        asked = processes.client.map((nap(number) for number in range(tasks)), lanes=2 * workers)
        count = sum(isinstance(answer, Answer) for _, answer in asked)
        rows.append(
            ["tasks", workers, 2 * workers, *_efficiency(count, time.perf_counter() - begin_s, workers, nap_s)]
        )
        lanes = min(64, 2 * workers)
        campaign = Campaign(designer="random", lanes=lanes, stop=Stop(evaluations=tasks))
        plan = campaign.plan(f"nap-{lanes}-{workers}", find_model("paper"), "paper")
        chooser = designer("random", Space.of(plan), seed=lanes, lanes=lanes)
        with RunDoor.begin(processes.client, plan) as door:
            runner = Runner(door, chooser, campaign.stop, lanes=lanes, seed=1)
            begin_s = time.perf_counter()
            runner.run(1, without_dbr=False)
            wall_s = time.perf_counter() - begin_s
        rows.append(["steps", workers, lanes, *_efficiency(runner.progress.steps, wall_s, workers, nap_s)])
    heads = ("what", "workers", "at once", "count", "per s", "efficiency")
    table(f"ray workers that sleep {1e3 * nap_s:.0f} ms a task", rows, heads)


def nap(number: int) -> Task:
    """A task for a pretending ray worker."""
    design = {"distance_um": 100.0, "width_um": 10.0, "number": number}
    return Task(kind="ray", inputs={"design": design}, version=__version__)


def _efficiency(count: int, wall_s: float, workers: int, nap_s: float) -> list[object]:
    return [count, f"{count / wall_s:.0f}", f"{100.0 * count * nap_s / workers / wall_s:.1f} %"]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--workers", type=int, nargs="+", default=[8, 64])
    parser.add_argument("--seconds", type=float, default=10.0)
    chosen = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    overhead(chosen.steps)
    for number in chosen.workers:
        efficiency(number, 0.1, chosen.seconds)
