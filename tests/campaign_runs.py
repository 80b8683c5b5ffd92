"""Runs on disk for tests of the report: journals as a controller writes them, with numbers known beforehand."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env_controller.notes import note_records
from luxloop.campaign import AgentRecord, Begin, Fidelity, Note, Plan, Role, Step
from luxloop.design import Bounds, Design
from luxloop.failure import Failure
from luxloop.journal.journal import Journal
from luxloop.journal.topics import (
    Close,
    Record,
    log_record,
    map_record,
    opening,
    reply_record,
    request_record,
    step_record,
)
from luxloop.messages import Outcome, Task
from luxloop.model_file import find_model
from luxloop.ray import Film, RayRequest

SECOND_NS = 1_000_000_000
BEGUN_NS = 1_795_000_000 * SECOND_NS
FILM = Film(sha256="f" * 64, bytes=100)
ARGV = ["campaign", "run", "--id", "trial"]
START = Design.from_vector((150.0, 30.0, 500.0, 20.0, 5.5))
LEVEL_LX = 100_000.0


def plan_of(run: str = "trial", **changes: Any) -> Plan:
    """A campaign on the paper's model."""
    model = find_model("paper")
    return Plan(
        **{
            "run": run,
            "model": "paper",
            "environment": model.environment,
            "effects": model.effects,
            "bounds": Bounds.preset("paper-table3"),
            "reward": "r2",
            "walk": Fidelity(target_error_points=1.0),
            "final": Fidelity(target_error_points=0.3),
            "lanes": 2,
        }
        | changes
    )


def field_lx(design: Design, x_um: NDArray[Any], y_um: NDArray[Any]) -> NDArray[np.float64]:
    """An even, periodic illuminance (y, x): brightest above the chips, a known sum of cosines."""
    depth, k = 0.1 if design.dbr_pairs else 0.3, 2.0 * np.pi / design.spacing_um
    ripple = 0.02 * np.cos(3.0 * k * x_um) + depth * np.cos(k * x_um)
    return np.asarray(LEVEL_LX * (1.0 + ripple + depth * np.cos(k * y_um)[:, None]))


def map_of(design: Design, bins: int = 32) -> NDArray[np.float64]:
    """The field at the centres of equal squares of one cell."""
    at = ((np.arange(bins) + 0.5) / bins - 0.5) * design.spacing_um
    return field_lx(design, at, at)


class RunOnDisk:
    """Writes a run's journal step by step; `finish` ends it, `close` leaves it as a killed process would."""

    def __init__(
        self, folder: Path, plan: Plan | None = None, argv: Sequence[str] = ARGV, designer: str = "1-test"
    ) -> None:
        self.plan = plan or plan_of(folder.name)
        facts = {"argv": [*argv], "designer": "ddqn-fast", "seed": "7"}
        attachments = {"campaign.json": json.dumps({"designer": "ddqn-fast", "seed": 7})}
        begin = Begin(plan=self.plan, designer=designer, facts=facts, attachments=attachments)
        run, files = opening(begin)
        environment = {"python": "3.11.7", "numpy": "2.4.6", "cores": "2"}
        self.journal = Journal(folder, {"run": run, "environment": environment}, files)
        self.sequence = self.paused_ns = 0
        self.numbers: dict[int, int] = {}

    def evaluated(
        self, design: Design, uniformity: float, *, error: float = 0.01, lane: int = 0, seed: str | None = None,
        episode: int | None = None, method: str = "monte_carlo", role: Role = "finalist",
    ) -> Step:  # fmt: skip
        """A step that a worker computed; `seed` makes it a final one."""
        final = seed is not None
        request = RayRequest(
            environment=self.plan.environment, design=design, film=FILM if design.dbr_pairs else None,
            target_error_points=1.0, seed=seed or "1", exit_seed=seed or "1",
        )  # fmt: skip
        task = Task.of(request)
        metrics = metrics_of(uniformity, error)
        figures = {name: metrics[name] for name in metrics if name != "uniformity"}
        step = self._step(
            design, lane, uniformity=uniformity, uniformity_error=error, figures=figures, final=final,
            role=role if final else None, task_id=task.id, physics_s=0.5, controller_s=0.6,
        )  # fmt: skip
        at = self.sequence, self._now_ns()
        outcome = Outcome(task_id=task.id, result=result_of(design, metrics, method), worker="ray-1", compute_s=0.5)
        self._put(
            [request_record(task, *at), reply_record("ray", outcome, {}, *at), map_record(map_of(design), *at)],
            step,
            None if final or episode is None else episode,
        )
        return step

    def infeasible(self, design: Design, lane: int = 0) -> Step:
        """A step of a design that cannot be built."""
        step = self._step(design, lane, uniformity=0.0, feasible=False, reason="the receiver touches the chip")
        self._put([], step, 0)
        return step

    def failed(self, design: Design, lane: int = 0) -> Step:
        """A step whose worker was lost."""
        failure = Failure(code="worker_lost", message="ray-1 died three times")
        step = self._step(design, lane, uniformity=0.0, failure=failure)
        self._put([], step, 0)
        return step

    def note(self, result: dict[str, Any]) -> None:
        """What the designer puts on record at the end."""
        note = Note(run=self.plan.run, designer="1-test", result=result)
        self.journal.put(note_records(note, self.sequence, self._now_ns()), lambda _: None)

    def finish(self, reason: str = "budget: 12 evaluations", *, complete: bool = True) -> None:
        """End the run as the controller does."""
        line = Close(reason, complete).line
        self.journal.put([log_record(line, self.sequence, self._now_ns())], lambda _: None)
        self.journal.finish()
        self.journal.close()

    def close(self) -> None:
        """Leave the journal unfinished."""
        self.journal.close()

    def _step(self, design: Design, lane: int, **found: Any) -> Step:
        number = self.numbers.get(lane, -1) + 1
        self.numbers[lane] = number
        state = tuple(np.clip(self.plan.bounds.normalise(design), -1.0, 1.0).tolist())
        return Step(
            run=self.plan.run, lane=lane, number=number, design=design, state=state, **{"reward": 0.0} | found
        )

    def _put(self, records: Sequence[Record], step: Step, episode: int | None) -> None:
        at = self.sequence, self._now_ns()
        of_step = [*records, step_record(step, *at)]
        if episode is not None:
            agent = AgentRecord(lane=step.lane, number=step.number, episode=episode, epsilon=1.0 / (1 + episode))
            note = Note(run=self.plan.run, designer="1-test", agent=agent)
            of_step += note_records(note, *at)
        self.journal.put(of_step, lambda _: None)
        self.sequence += 1

    def _now_ns(self) -> int:
        return BEGUN_NS + (self.sequence + 1) * SECOND_NS + self.paused_ns


def metrics_of(uniformity: float, error: float) -> dict[str, Any]:
    """The metrics of a ray result that a report reads."""

    def one(value: float, standard_error: float) -> dict[str, float]:
        return {"value": value, "standard_error": standard_error, "bias": 0.0, "truncation": 0.0}

    return {
        "uniformity": one(uniformity, error),
        "mean_illuminance_lx": one(LEVEL_LX * (2.0 - uniformity), 100.0 * error),
        "optical_efficiency": one(0.2, 1e-4),
        "hot_spot_ratio": one(1.2, 0.01),
    }


def result_of(design: Design, metrics: dict[str, Any], method: str) -> dict[str, Any]:
    """A ray result with all that a report reads; the twin has no ledger."""
    half_um = design.spacing_um / 2.0

    def shares(*pairs: tuple[str, float]) -> dict[str, Any]:
        return {name: {"value": value, "standard_error": 1e-4} for name, value in pairs}

    result: dict[str, Any] = {
        "metrics": metrics,
        "cut": {"y_um": 0.0, "window_um": [-half_um, half_um]},
        "map": {"x_um": [-half_um, half_um], "y_um": [-half_um, half_um]},
        "histories": 65_536,
        "method": method,
        "warnings": [],
    }
    if method == "twin":
        return result
    ledger = shares(("receiver", 0.2), ("chip", 0.7312), ("substrate", 0.05), ("dbr", 0.0), ("edge", 0.0),
                    ("trapped", 0.0188), ("roulette", 0.0), ("emitted", 1.0))  # fmt: skip
    events = shares(("through_dbr", 0.0312), ("from_sides", 0.06), ("after_top_reflection", 0.05),
                    ("after_receiver", 0.07))  # fmt: skip
    return result | {"ledger": ledger, "ledger_defect": 1e-15, "optical_events": events}


def whole_run(folder: Path) -> dict[str, Step]:
    """A run with all there can be: walk of two lanes, infeasible and failed steps, finalists, start, no DBR."""
    run = RunOnDisk(folder)
    steps: dict[str, Step] = {}
    wide = START.model_copy(update={"width_um": 40.0})
    for i in range(12):
        design = START.model_copy(
            update={"thickness_um": 20.0 + 5.0 * (i // 2), "distance_um": 150.0 + 10.0 * (i % 2)}
        )
        step = run.evaluated(design, 0.70 + 0.02 * i, lane=i % 2, episode=i // 4)
        steps.setdefault("first", step)
        steps["last"] = step
    steps["known"] = run.evaluated(START, 0.70, lane=0, episode=3)
    run.infeasible(START.model_copy(update={"distance_um": 100.0, "thickness_um": 55.0}), lane=1)
    run.failed(wide, lane=1)
    steps["second"] = run.evaluated(steps["last"].design, 0.905, error=0.003, seed="101")
    steps["best"] = run.evaluated(wide, 0.912, error=0.004, seed="102")
    steps["start"] = run.evaluated(START, 0.6951, error=0.002, seed="103", role="start")
    steps["again"] = run.evaluated(wide, 0.912, error=0.004, seed="105", role="best")
    plain = wide.model_copy(update={"dbr_pairs": 0.0})
    steps["bare"] = run.evaluated(plain, 0.65, error=0.003, seed="104", role="without_dbr")
    run.note({"reason": "budget: 12 evaluations", "evaluations": 12})
    run.finish()
    return steps
