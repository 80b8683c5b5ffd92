"""The faults: what they are, how they are drawn from a seed, how they are done to a lab and undone again."""

from __future__ import annotations

import os
import random
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mcap.writer import MCAP0_MAGIC

from luxloop.journal.reader import segments_of
from luxloop.journal.scan import Scan
from tests.nemesis.lab import LINKS, MEMBERS, Lab
from tests.nemesis.network import SmallDisk

Kind = Literal[
    "kill", "stop", "hold the GIL", "restart", "slow link", "reset link", "cut link", "pull the wire", "full disk",
    "torn write", "tail lost", "kill all",
]  # fmt: skip
WORKERS = ("film", "ray-1", "ray-2")
CANDIDATES: dict[Kind, tuple[str, ...]] = {
    "kill": MEMBERS,
    "stop": MEMBERS,
    "hold the GIL": WORKERS,
    "restart": ("router", "controller"),
    "slow link": LINKS,
    "reset link": LINKS,
    "cut link": LINKS,
    "pull the wire": ("ray-2",),
    "full disk": ("runs",),
    "torn write": ("controller",),
    "tail lost": ("controller",),
    "kill all": ("all",),
}
"""What each kind may hit."""
DWELLS_S: dict[Kind, tuple[float, ...]] = {
    "stop": (0.5, 2.0, 5.0, 8.0),  # the lease is 4 s, the silence 6 s
    "hold the GIL": (1.0, 8.0),
    "slow link": (3.0,),
    "cut link": (1.0, 6.0),
    "pull the wire": (2.0, 7.0),
    "full disk": (0.5, 2.0),
}
OFTEN: dict[Kind, int] = {"kill": 6, "stop": 4}
"""How much more often than once in a round; all others once."""
GAPS_S = (0.2, 3.0)
WAITING = 0.6
SLOW_BYTES_PER_S, SLOW_DELAY_S = 60_000.0, 0.05
LOST_BYTES = (1, 60)

Heal = Callable[[], object]


@dataclass(frozen=True)
class Fault:
    """What happens to whom, for how long (0: it heals by itself), so long after the one before; most wait besides
    until the campaign has gone on, else a storm would only be a pause."""

    kind: Kind
    target: str
    dwell_s: float
    gap_s: float
    waits: bool


def drawn(seed: int, kinds: tuple[Kind, ...], spared: tuple[str, ...] = ()) -> Iterator[Fault]:
    """The faults of a seed, without end; `spared` are never hit."""
    rng = random.Random(seed)
    often = [kind for kind in kinds for _ in range(OFTEN.get(kind, 1))]
    while True:
        kind = rng.choice(often)
        target = rng.choice(CANDIDATES[kind])
        dwell_s = rng.choice(DWELLS_S.get(kind, (0.0,)))
        gap_s, waits = rng.uniform(*GAPS_S), rng.random() < WAITING
        if target not in spared:
            yield Fault(kind, target, dwell_s, gap_s, waits)


def kinds_for(lab: Lab, disk: SmallDisk | None) -> tuple[Kind, ...]:
    """Those that this machine permits."""
    lacking = {"pull the wire"} if lab.wire is None else set()
    lacking |= {"full disk"} if disk is None else set()
    return tuple(kind for kind in CANDIDATES if kind not in lacking)


def inject(lab: Lab, fault: Fault, disk: SmallDisk | None, rng: random.Random) -> Heal:
    """Do it; what is returned undoes it."""
    target = fault.target
    match fault.kind:
        case "kill":
            lab.kill(target)
        case "kill all":
            lab.kill(*MEMBERS)
        case "restart":
            lab.signal(target, signal.SIGTERM)
        case "stop":
            return _stop(lab, target)
        case "hold the GIL":
            lab.hold_gil(target, fault.dwell_s)
        case "slow link":
            lab.links[target].slow(SLOW_BYTES_PER_S, SLOW_DELAY_S)
            return lab.links[target].fast
        case "reset link":
            lab.links[target].reset()
        case "cut link":
            lab.links[target].cut()
            return lab.links[target].heal
        case "pull the wire":
            assert lab.wire is not None
            lab.wire.cut()
            return lab.wire.heal
        case "full disk":
            assert disk is not None
            disk.fill()
            return disk.empty
        case "torn write":
            _torn_write(lab, rng)
        case "tail lost":
            _tail_lost(lab, rng)
    return lambda: None


def _stop(lab: Lab, target: str) -> Heal:
    """SIGSTOP; the process that was stopped goes on later, if it is still there."""
    with lab.lock:
        process = lab.processes.get(target)
        if process is None:
            return lambda: None
        process.send_signal(signal.SIGSTOP)
    return lambda: process.send_signal(signal.SIGCONT)  # nothing where it has ended meanwhile


def _torn_write(lab: Lab, rng: random.Random) -> None:
    """The controller is killed in the middle of a batch: the beginning of one is at the journal's end."""
    with lab.lock:
        lab.kill("controller")
        path = _unfinished(lab)
        if path is not None:
            tear(path, rng)


def tear(path: Path, rng: random.Random) -> None:
    """Append the beginning of a batch to a segment, the last one's, cut where it is no whole commit.

    Only its index records may be missing of a batch that is a commit: twice the same would be a forged journal.
    """
    scan = Scan(path)
    ends = [scan.read_bytes for _ in scan]  # at each commit: where the one before it ended
    if len(ends) < 2 or scan.left_bytes:  # no batch of a run that is open, or torn before
        return
    whole_bytes = path.stat().st_size
    batch = path.read_bytes()[ends[-1] : scan.read_bytes]
    cut = len(batch)
    while cut > 1:
        cut = rng.randint(1, cut - 1)
        with suppress(OSError), path.open("ab", buffering=0) as file:  # on a full disk it is torn earlier
            file.write(batch[:cut])
        torn = Scan(path)
        if sum(1 for _ in torn) == len(ends) and not torn.fault:
            return
        os.truncate(path, whole_bytes)


def _tail_lost(lab: Lab, rng: random.Random) -> None:
    """Everything is killed and the disk has lied: the journal's last bytes are gone, told steps with them."""
    with lab.lock:
        lab.kill("controller", "designer")
        path = _unfinished(lab)
        if path is not None:
            with path.open("rb+") as file:
                file.truncate(max(path.stat().st_size - rng.randint(*LOST_BYTES), 0))
        lab.history.note("tail lost", run=lab.run, steps=lab.on_record())


def _unfinished(lab: Lab) -> Path | None:
    """The segment that the controller wrote when it was killed; None where there is none, or it was finished."""
    paths = segments_of(lab.settings.runs_dir / lab.run) if lab.run else []
    if not paths or lab.finished.is_set() or paths[-1].read_bytes().endswith(MCAP0_MAGIC):
        return None
    return paths[-1]
