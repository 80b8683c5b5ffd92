"""A storm: campaigns one after the other while faults fall on their processes; then the checker."""

from __future__ import annotations

import heapq
import random
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import TypeVar

from tests.nemesis.checker import Broken, check_history, check_run, content
from tests.nemesis.faults import Fault, Heal, drawn, inject, kinds_for
from tests.nemesis.lab import Lab
from tests.nemesis.network import NotPermittedError, SmallDisk, Wire

DESIGNERS = ("ddqn-fast", "pattern", "random")
CALM_S = 90.0  # a campaign must end so soon after the last fault
LOOK_S = 0.05
PATIENCE_S = 15.0  # so long at most a fault waits for a step
Member = TypeVar("Member", Wire, SmallDisk)


@dataclass
class Weather:
    """What a storm was and what it broke."""

    seed: int
    faults: Counter[str] = field(default_factory=Counter)
    campaigns: int = 0
    steps: int = 0
    tasks: int = 0
    attempts: int = 0
    fenced: int = 0
    epochs: int = 0
    seconds: float = 0.0
    broken: list[Broken] = field(default_factory=list)
    not_permitted: list[str] = field(default_factory=list)
    resident_mb: list[dict[str, float]] = field(default_factory=list)
    """At the start, the most ever seen, at the end."""
    ages_s: dict[str, float] = field(default_factory=dict)
    """For how long the processes of the end had lived."""


def storm(
    folder: Path,
    seconds: float,
    seed: int,
    *,
    evaluations: int = 60,
    designers: Sequence[str] = DESIGNERS,
    spared: tuple[str, ...] = (),
    tell: Callable[[str], object] = lambda _: None,
) -> Weather:
    """Blow for so long, then heal everything, let the campaign end, and check all that can be checked."""
    weather = Weather(seed)
    with ExitStack() as stack:
        wire = _permitted(stack, Wire, weather)
        disk = _permitted(stack, lambda: SmallDisk(folder / "runs"), weather)
        lab = stack.enter_context(Lab(folder, wire=wire))
        clean = {designer: _calm(lab, designer, evaluations) for designer in dict.fromkeys(designers)}
        weather.resident_mb = [lab.resident_mb(), lab.resident_mb()]
        faults = Faults(lab, disk, seed, weather, spared, tell)
        begun_s = time.monotonic()
        for number, designer in enumerate(cycle(designers)):
            if time.monotonic() >= begun_s + seconds:
                break
            lab.begin(f"storm-{number}-{designer}", designer, evaluations)
            faults.blow(begun_s + seconds)
            if not _ends(lab, faults, weather):
                break
            weather.campaigns += 1
            weather.broken += check_run(lab.settings.runs_dir / lab.run, lab.history.read(), clean[designer])
        faults.heal_all()
        _count(lab, weather)
        weather.seconds = time.monotonic() - begun_s
    return weather


def _calm(lab: Lab, designer: str, evaluations: int) -> str:
    """The content of a campaign that nothing disturbs."""
    lab.complete(f"calm-{designer}", designer, evaluations)
    return content(lab.settings.runs_dir / lab.run)


def _ends(lab: Lab, faults: Faults, weather: Weather) -> bool:
    """Whether the campaign has ended, or does once everything is healed."""
    if not lab.finished.is_set():
        faults.heal_all()
    ended = lab.finished.wait(CALM_S)
    weather.steps += lab.told()
    if not ended:
        weather.broken.append(Broken("a campaign ends", f"{lab.run} had not {CALM_S:g} s after the last fault"))
    return ended


class Faults:
    """The faults of a seed, done to a lab one after the other; several may last at once, one for each target."""

    def __init__(
        self,
        lab: Lab,
        disk: SmallDisk | None,
        seed: int,
        weather: Weather,
        spared: tuple[str, ...],
        tell: Callable[[str], object],
    ) -> None:
        self._lab, self._disk, self._weather, self._tell = lab, disk, weather, tell
        self._drawn = drawn(seed, kinds_for(lab, disk), spared)
        self._rng = random.Random(f"how {seed}")  # which bytes are lost; when, is drawn with the fault
        self._draw()
        self._lasting: list[tuple[float, int, Fault, Heal]] = []

    def blow(self, until_s: float) -> None:
        """Go on with faults until the campaign has ended or the time is over."""
        while time.monotonic() < until_s and not self._lab.finished.wait(LOOK_S):
            while self._lasting and self._lasting[0][0] <= time.monotonic():
                self._heal()
            if self._is_time():
                if all(fault.target != self._next.target for *_, fault, _ in self._lasting):
                    self._inject(self._next)
                self._draw()
            self._look()

    def _draw(self) -> None:
        self._next = next(self._drawn)
        self._next_s = time.monotonic() + self._next.gap_s
        self._at = self._lab.run, self._lab.told()

    def _is_time(self) -> bool:
        """Whether the next fault is due: after its gap, and where it waits after a step has been told."""
        now_s = time.monotonic()
        still = self._at == (self._lab.run, self._lab.told())
        waits = self._next.waits and still and now_s < self._next_s + PATIENCE_S
        return now_s >= self._next_s and not waits

    def heal_all(self) -> None:
        """Undo what lasts."""
        while self._lasting:
            self._heal()

    def _inject(self, fault: Fault) -> None:
        self._tell(f"{fault.kind}, {fault.target}, {fault.dwell_s:g} s")
        self._lab.history.note("fault", kind=fault.kind, target=fault.target, dwell_s=fault.dwell_s)
        heal = inject(self._lab, fault, self._disk, self._rng)
        number = self._weather.faults.total()
        heapq.heappush(self._lasting, (time.monotonic() + fault.dwell_s, number, fault, heal))
        self._weather.faults[fault.kind] += 1

    def _heal(self) -> None:
        _, _, fault, heal = heapq.heappop(self._lasting)
        heal()
        self._lab.history.note("healed", kind=fault.kind, target=fault.target)

    def _look(self) -> None:
        most = self._weather.resident_mb[1]
        for name, resident_mb in self._lab.resident_mb().items():
            most[name] = max(most.get(name, 0.0), resident_mb)


def _permitted(stack: ExitStack, make: Callable[[], Member], weather: Weather) -> Member | None:
    try:
        return stack.enter_context(make())
    except NotPermittedError as error:
        weather.not_permitted.append(str(error))
        return None


def _count(lab: Lab, weather: Weather) -> None:
    """What the history shows of the whole storm."""
    lab.history.note("looked")
    history = lab.history.read()
    weather.broken += check_history(history, quiet_s=5.0)
    seen = Counter(one["what"] for one in history)
    weather.tasks, weather.attempts, weather.epochs = seen["accepted"], seen["granted"], seen["epoch"]
    weather.fenced = sum(one["what"] == "delivered" and not one["taken"] for one in history)
    weather.resident_mb.append(lab.resident_mb())
    weather.ages_s = lab.ages_s()
