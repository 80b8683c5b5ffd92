"""From settings to a finished run: client, run at the controller, designer, live view, result on record."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import distributions, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from agent.campaign import INTERRUPTED, Runner
from agent.checkpoints import Checkpoints
from agent.config import Campaign
from agent.designers import designer
from agent.effects_tried import EffectsKept, roomiest, sources, try_effects
from agent.in_words import plain
from agent.live import live
from agent.moves import Key, Space, start_of
from agent.progress import WALK, Found, Past, Progress
from agent.telling import run_argument
from agent.waiting import workers_watched
from luxloop import __version__
from luxloop.bus import Interrupt
from luxloop.campaign import Ended, Plan, RunId, Step
from luxloop.client import Client
from luxloop.door import LOST_S, RunDoor
from luxloop.endpoint import listening
from luxloop.errors import InputError, RemoteError
from luxloop.failure import printable
from luxloop.model import Model
from luxloop.model_file import find_model, to_toml
from luxloop.process import usable_cores
from luxloop.settings import Settings, usable, usable_cache
from luxloop.words import canonical, sha256_of

SAY_LOST_S = 5.0
PATIENCE_S = 300.0  # a worker that starts for the first time compiles its kernels


@dataclass(frozen=True)
class Launched:
    """A run that has ended: what was found, its journal's root, where it lies."""

    run: str
    found: Found
    ended: Ended
    interrupted: bool
    walk: tuple[Key, ...] = ()
    """The walk's designs, in the order in which they were told."""
    failures: tuple[tuple[str, int], ...] = ()
    """Why evaluations of this start failed, and how often, the most frequent first."""

    def document(self) -> dict[str, Any]:
        """As one object for machines."""
        return {
            "run": self.run,
            "folder": self.ended.folder,
            "records": self.ended.records,
            "root": self.ended.root,
            "interrupted": self.interrupted,
            **self.found.summary(),
            "best": plain(self.found.sound_best),
            "failures": [{"why": why, "steps": count} for why, count in self.failures],
        }


def launch(
    settings: Settings,
    campaign: Campaign,
    model: str,
    run: str | None = None,
    *,
    chosen: Model | None = None,
    kind: Literal["campaign", "grid"] = "campaign",
    local: bool = True,
    show: bool = False,
    say: bool = False,
) -> Launched:
    """Run a campaign to its end. Ctrl-C ends the walk after the steps under way; the journal is finished.

    `model` is a name or a file; it is not read where `chosen` is what was read of it before.
    `show` draws a live table on the terminal, `say` tells the run's id and folder at its start.

    Raises InputError for settings that do not fit, RemoteError where the controller refuses or cannot be reached.
    """
    chosen = chosen or find_model(model)
    name = run or f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{campaign.designer}"
    refuse_taken_id(settings, name, local)
    plan = campaign.plan(name, chosen, model, kind=kind)
    refuse_unready(campaign, plan)
    usable_cache(settings)
    return Start(settings, campaign, plan, chosen, local=local, show=show, say=say).go()


def refuse_unready(campaign: Campaign, plan: Plan) -> None:
    """InputError, before anything starts, where the designer lacks its package or cannot begin where it should."""
    learner = campaign.learner
    if learner is not None and not learner.random_actions and find_spec("torch") is None:
        mend = "pip install 'luxloop[designer]', or take one that does not learn: pattern, random, grid"
        raise InputError("designer", campaign.designer, "a designer whose packages are installed (torch)", mend)
    start_of(Space.of(plan), campaign.start or (learner.start if learner else None))


@dataclass(frozen=True)
class Start:
    """One start of a run's designer, the first or a later one: `on_record` is what the journal held before it."""

    settings: Settings
    campaign: Campaign
    plan: Plan
    model: Model
    on_record: tuple[Step, ...] = ()
    past: Past | None = None
    root: str | None = None
    local: bool = True
    show: bool = False
    say: bool = False

    def go(self) -> Launched:
        """Walk to the end, evaluate the finalists, finish the journal."""
        campaign, plan = self.campaign, self.plan
        workers = ray_workers(campaign.lanes)
        with (
            interruptible() as interrupted,
            Client(self.settings, local=self.local, patience_s=PATIENCE_S, ray_workers=workers) as client,
            self._begun(client) as door,
            workers_watched(client, warn if self.say else lambda _: None),
            live(self.show, plan.run, campaign.stop.evaluations, client) as look,
            to_go_on_with(door),
        ):
            door.on_lost = lost(self.show)
            if self.say:
                warn(f"run {plan.run} in {door.begun.folder}" + self._on_record(door))
            checkpoints = self._checkpoints(door)
            runner = checkpoints.restored(lambda: self._runner(door, checkpoints, look, interrupted), self.on_record)
            found = runner.run(campaign.finalists, without_dbr=plan.kind == "campaign")
            if found.reason != INTERRUPTED:
                door.note(result=found.summary())
            elif runner.progress.stage == WALK:
                checkpoints.save(runner)
            walk = tuple(runner.designer.known.uniformity)
            stopped = found.reason == INTERRUPTED
            ended = door.end(found.reason, complete=not stopped)
            return Launched(plan.run, found, ended, stopped, walk, tuple(runner.failures.most_common()))

    def _begun(self, client: Client) -> RunDoor:
        """The open run. Before it is begun, its workers have shown that they can do what the model's effects ask."""
        plan = self.plan
        if self.say and self.model.effects:
            warn("trying the model's effects")
        for idle in try_effects(client, self.model, plan.model, roomiest(plan), plan.walk.method):
            warn(idle)
        return RunDoor.begin(client, plan, self._facts(), self._attachments(), **self._which())

    def _which(self) -> dict[str, Any]:
        """Whether a run is gone on with, and which journal of it is meant."""
        return {"resume": self.past is not None, "root": self.root}

    @staticmethod
    def _on_record(door: RunDoor) -> str:
        return f", {door.begun.steps} steps are on record" if door.begun.steps else ""

    def _facts(self) -> dict[str, Any]:
        return {
            "argv": [printable(word) for word in sys.argv[1:]],
            "version": __version__,
            "model_sha256": self.model.sha256,
            "campaign_sha256": sha256_of(self.campaign),
            "seed": str(self.campaign.seed),
            "designer": self.campaign.designer,
        }

    def _attachments(self) -> dict[str, str]:
        """The files that say what is run: model and own effects, settings, packages, what other rooms have on it."""
        files = {
            "model.toml": to_toml(self.model),
            "campaign.json": canonical(self.campaign).decode(),
            "packages.txt": packages(),
            **sources(self.model, self.settings.effects_dir),
        }
        for point in entry_points(group="luxloop.attachments"):
            files |= point.load()(self.model.environment)
        return files

    def _checkpoints(self, door: RunDoor) -> Checkpoints:
        """Beside the journal, where that is within reach."""
        folder = Path(door.begun.folder)
        if folder != (self.settings.runs_dir / self.plan.run).resolve():
            warn(f"the set at {self.settings.router} keeps its runs elsewhere: {folder}")
        return Checkpoints(folder if folder.is_dir() else None, self.plan, warn)

    def _runner(
        self, door: RunDoor, checkpoints: Checkpoints, look: Callable[[Progress], None], interrupted: threading.Event
    ) -> Runner:
        """A fresh designer, and what drives it."""
        campaign, left = self.campaign, Interrupt()
        chooser = designer(
            campaign.designer, Space.of(self.plan), seed=campaign.seed, lanes=campaign.lanes, start=campaign.start,
            learning=campaign.learner,
        )  # fmt: skip
        return Runner(
            EffectsKept(door, self.on_record, left), chooser, campaign.stop, lanes=campaign.lanes, seed=campaign.seed,
            look=look, stop_wanted=interrupted.is_set, past=self.past, on_turn=checkpoints.on_turn,
            on_walk_end=lambda end: door.note(log=end.line), on_leave=left.set,
        )  # fmt: skip


@contextmanager
def running_set(settings: Settings, *, local: bool) -> Iterator[Settings]:
    """Settings of a set that runs: one that answers already, or one of our own for as long as this lasts."""
    usable_cache(settings)
    with Client(settings, local=local, patience_s=PATIENCE_S, ray_workers=ray_workers(usable_cores())) as client:
        yield client.settings


def ray_workers(lanes: int) -> int:
    """Ray-tracing workers that a campaign starts where no set runs: one for each core, as far as its lanes go."""
    return max(1, min(lanes, usable_cores()))


@contextmanager
def to_go_on_with(door: RunDoor) -> Iterator[None]:
    """An error that ends a run says by which command it goes on, with the folder of runs where that is needed."""
    command = f"luxloop campaign resume {run_argument(Path(door.begun.folder))}"
    try:
        yield
    except RemoteError as error:
        mend = error.failure.mend
        if error.failure.code in ("no_router", "no_controller"):
            mend = f"{mend}; then {command}" if mend else command
        elif mend == f"luxloop campaign resume {door.run}":  # the controller does not know where this side looks
            mend = command
        else:
            raise
        raise RemoteError(error.failure.model_copy(update={"mend": mend})) from error


def lost(show: bool) -> Callable[[float], None]:
    """Says on stderr, every few seconds, that nothing is heard from the controller."""
    told_s = [-SAY_LOST_S]

    def tell(lost_s: float) -> None:
        now_s = time.monotonic()
        if now_s - told_s[0] >= SAY_LOST_S:  # every lane has lost it: one line for all of them
            told_s[0] = now_s
            warn(f"nothing heard from the controller for {lost_s:.0f} s; given up after {LOST_S:g}")

    return tell if show else lambda _: None


def warn(text: str) -> None:
    """A line for people."""
    sys.stderr.write(f"luxloop: {text}\n")


def refuse_taken_id(settings: Settings, name: str, local: bool) -> None:
    """InputError where that is no id, or a run of it lies in our own folder: before anything is started."""
    try:
        TypeAdapter(RunId).validate_python(name)
    except ValidationError:
        allowed = "1 to 60 small letters, digits and '-', the first no '-'"
        raise InputError("--id", name, allowed, "e.g. trial-2") from None
    folder = settings.runs_dir / name
    if local and not listening(settings.router):
        usable(settings.runs_dir, "--runs", "name another folder by --runs or LUXLOOP_RUNS")
    if local and folder.exists():
        raise InputError(
            "--id", name, f"an id that {settings.runs_dir} does not hold", "take another, or leave it out"
        )


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C or SIGTERM sets; the second Ctrl-C interrupts at once."""
    event = threading.Event()

    def note(_number: int, _frame: Any) -> None:
        if event.is_set():
            raise KeyboardInterrupt
        event.set()
        if sys.stderr.isatty():
            sys.stderr.write("\nfinishing the steps under way; once more to leave at once\n")

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    in_main = threading.current_thread() is threading.main_thread()
    if in_main:
        for number in before:
            signal.signal(number, note)
    try:
        yield event
    finally:
        if in_main:
            for number, handler in before.items():
                signal.signal(number, handler)


def packages() -> str:
    """The installed distributions, one a line."""
    told = [one.metadata for one in distributions()]  # each is parsed once: 0.04 s for 74, not 0.16
    found = {f"{one['Name']}=={one['Version']}" for one in told if one["Name"]}
    return "\n".join(sorted(found, key=str.lower)) + "\n"
