"""What the report of a campaign shows, from its journal alone: the document, and the arrays of its curves and maps.

    document, arrays = document_of(folder)

A run that goes on, was killed, or found nothing has a document too: what is not on record is None or empty.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from agent.moves import key_of
from agent.recorded import (
    Details,
    Document,
    Recorded,
    Told,
    details,
    distinct,
    has_episodes,
    object_in,
    recorded,
    wall_s,
)
from agent.report_arrays import Arrays, episode_arrays, line_of, pareto_arrays, walk_arrays
from agent.report_numbers import difference, estimate, grid_of
from luxloop.campaign import REWARDS, Plan, Role, Step
from luxloop.model import Model

TOP = 10  # of the walk, in the table of designs
FAILURES = 20  # shown
CUT_POINTS = 257
SETTINGS = "campaign.json"


class Roles(NamedTuple):
    """What the final evaluations were for: the finalists, the best first; that one again; the start; without DBR."""

    finalists: list[Told]
    best: Told | None
    start: Told | None
    without_dbr: Told | None

    @property
    def with_dbr(self) -> Told | None:
        """What the design without its DBR is compared with."""
        return self.best if self.without_dbr else None


def document_of(folder: Path) -> tuple[Document, Arrays]:
    """The document of a run's report and its arrays.

    Parameters
    ----------
    folder : of the run, with its journal.

    Returns
    -------
    document : plain values; uniformities in [0, 1], errors are standard errors.
    arrays : `walk_*` (step,) in the order in which the designer was told; `episode_*` (episode,); `pareto_*`
        (design,); `best_map_lx`, `with_map_lx`, `bare_map_lx` (y, x), row 0 at the lowest y, with `*_cut_x_um`,
        `*_cut_lx`, `*_cut_error_lx` of the line of Eq. 8.

    Raises
    ------
    InputError : no journal there.
    """
    run = recorded(folder)
    walk = sorted(run.walk, key=lambda told: (told.step.number, told.step.lane))
    roles = roles_of(run.finals)
    designs = distinct(walk)
    best = roles.best or max(designs, key=_uniformity, default=None)
    shown = {"best": best, "with": roles.with_dbr, "bare": roles.without_dbr}
    found = details(folder, [told for told in (*shown.values(), *run.finals) if told])
    in_walk = {key_of(told.step.design): told for told in designs}

    def row(told: Told | None) -> Document | None:
        return None if told is None else row_of(told, found, in_walk.get(key_of(told.step.design)))

    arrays = walk_arrays(walk) | episode_arrays(walk) | pareto_arrays(designs)
    document: Document = {
        "command": "campaign report",
        **_provenance(run),
        "counts": _counts(run.told, walk, designs),
        "times": _times(run, walk),
        "best": row(best),
        "best_is_final": roles.best is not None,
        "best_is_confirmed": bool(roles.best and roles.best.step.role == "best"),
        "best_at": best_at(walk),
        "start": row(roles.start or next(iter(designs), None)),
        "finalists": [row(told) for told in roles.finalists],
        "top": [row(told) for told in sorted(designs, key=_uniformity, reverse=True)[:TOP]],
        "gain": difference(row(best), row(roles.start)),
        "dbr": {"with": row(roles.with_dbr), "without": row(roles.without_dbr),
                **(difference(row(roles.with_dbr), row(roles.without_dbr)) or {})},
        "grid": grid_of(run.plan, designs),
        "failures": [_failure(told) for told in run.told if told.step.failure][:FAILURES],
        "shown": {},
    }  # fmt: skip
    for name, told in shown.items():
        if told is not None:
            document["shown"][name], more = shown_of(told, found, run.plan, name)
            arrays |= more
    return document, arrays


def roles_of(finals: Sequence[Told]) -> Roles:
    """What each final evaluation was for, as the runner said; those that failed are none of `finals`."""
    of_role = {role: [told for told in finals if told.step.role == role] for role in get_args(Role)}
    finalists = sorted(of_role["finalist"], key=_uniformity, reverse=True)
    best, start, bare = (next(iter(of_role[role]), None) for role in ("best", "start", "without_dbr"))
    return Roles(finalists, best or next(iter(finalists), None), start, bare)


def row_of(told: Told, found: Details, in_walk: Told | None = None) -> Document:
    """A design and what was found of it; `in_walk` is what the walk had said, with other random numbers."""
    step = told.step
    request = found.requests.get(step.task_id or "", {})
    figures = {
        name: step.figures.get(name) for name in ("mean_illuminance_lx", "optical_efficiency", "hot_spot_ratio")
    }
    walked = in_walk is not None and step.final and estimate(in_walk)
    return {
        "design": step.design.model_dump(mode="json"),
        "f": step.design.f,
        "uniformity": estimate(told),
        **figures,
        "final": step.final,
        "lane": step.lane,
        "number": step.number,
        "sequence": told.sequence,
        "task_id": step.task_id,
        "seed": request.get("seed"),
        "in_walk": walked or None,
    }


def best_at(walk: Sequence[Told]) -> Document | None:
    """When the best of the walk was met: steps, different designs and episodes up to it."""
    evaluated = [told for told in walk if told.evaluated]
    if not evaluated:
        return None
    best = max(evaluated, key=_uniformity)
    until = walk[: walk.index(best) + 1]
    agent = best.agent
    episode = agent.episode if agent and has_episodes(walk) else None
    return {
        "step": len(until),
        "evaluations": len(distinct(until)),
        "episode": episode,
        "uniformity": estimate(best),
    }


def shown_of(told: Told, found: Details, plan: Plan, name: str) -> tuple[Document, Arrays]:
    """Map, cut, ledger and optical events of one design, as far as they are on record, and its arrays."""
    result = found.results.get(told.step.task_id or "", {})
    kept = ("ledger", "ledger_defect", "optical_events", "histories", "method", "map", "cut", "warnings", "metrics")
    document = {key: result.get(key) for key in kept}
    document["command"] = simulate_command(told, plan, found.requests.get(told.step.task_id or ""))
    document["sequence"], document["task_id"] = told.sequence, told.step.task_id
    map_lx = found.maps.get(told.sequence)
    if map_lx is None or not (result.get("map") and result.get("cut")):  # where its values lie is not on record
        return document, {}
    half_um = result["map"]["x_um"][1]
    x_um = np.linspace(-2.0 * half_um, 2.0 * half_um, CUT_POINTS)
    cut_lx = line_of(map_lx, half_um, x_um, result["cut"]["y_um"])
    document["band"] = "recorded" if told.step.cut else "estimated"
    return document, {
        f"{name}_map_lx": map_lx,
        f"{name}_cut_x_um": x_um,
        f"{name}_cut_lx": cut_lx,
        f"{name}_cut_error_lx": _cut_error_lx(told.step, x_um, cut_lx),
    }


def _cut_error_lx(step: Step, x_um: NDArray[np.float64], cut_lx: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard errors along the line; where a step has no cut on record, as if the extremes shared that of U."""
    if step.cut is None:
        return step.uniformity_error / (math.sqrt(2.0) * max(step.uniformity, 1e-9)) * cut_lx
    known_um = np.array(step.cut.x_um)
    return np.asarray(np.interp(x_um, known_um, step.cut.illuminance_error_lx, period=known_um[-1] - known_um[0]))


def simulate_command(told: Told, plan: Plan, request: Mapping[str, Any] | None) -> str:
    """The command line that computes the same figures of a design again."""
    how = plan.final if told.step.final else plan.walk
    design = ",".join(f"{value:.10g}" for value in key_of(told.step.design))
    words = ["luxloop", "simulate", "--design", design, "--model", plan.model or "MODEL"]
    words += ["--method", how.method] if how.method != "monte_carlo" else []
    if how.histories is not None:
        words += ["--histories", str(how.histories)]
    else:
        words += ["--target-error", f"{how.target_error_points:g}", "--budget", f"{how.budget_s:g}"]
    seed = str((request or {}).get("seed", how.seed))
    words += ["--seed", seed]
    if how.stored_exits or how.method == "twin":
        words += ["--stored-exits"] * how.stored_exits + ["--exit-seed", str((request or {}).get("exit_seed", seed))]
    return shlex.join(words)


def _provenance(run: Recorded) -> Document:
    """Who made this, with what, and what the journal says of itself."""
    plan = run.plan
    facts = object_in(run.facts.get("facts") or "{}", "facts")
    model = Model(name="of the run", environment=plan.environment, effects=plan.effects)
    settings = object_in(run.attachments[SETTINGS], SETTINGS) if SETTINGS in run.attachments else {}
    return {
        "run": plan.run,
        "kind": plan.kind,
        "folder": run.folder.name,
        "state": run.state,
        "ended": run.close.reason if run.close else "",
        "designer": str(facts.get("designer", "")),
        "seed": facts.get("seed"),
        "command_line": next(iter(run.command_lines), ""),
        "later_command_lines": run.command_lines[1:],
        "model": {"name": plan.model, "sha256": model.sha256, "effects": [effect.name for effect in plan.effects]},
        "plan": plan.model_dump(mode="json"),
        "reward": {"name": plan.reward, "formula": REWARDS[plan.reward]},
        "settings": settings,
        "result": run.notes[-1] if run.notes else None,
        "lines": run.lines,
        "chain": {"records": run.records, "root": run.root},
        "version": run.facts.get("version", ""),
        "environment": run.environment,
        "attachments": {name: sha256(data).hexdigest() for name, data in sorted(run.attachments.items())},
    }


def _counts(told: Sequence[Told], walk: Sequence[Told], designs: Sequence[Told]) -> Document:
    return {
        "steps": len(walk),
        "evaluations": len(designs),
        "known_before": sum(one.evaluated and one.step.cached for one in walk),
        "infeasible": sum(not one.step.feasible for one in walk),
        "out_of_bounds": sum(one.step.feasible and bool(one.step.reason) for one in walk),
        "failed": sum(one.step.failure is not None for one in told),
        "finals": len(told) - len(walk),
        "episodes": len({one.agent.episode for one in walk if one.agent}) if has_episodes(walk) else None,
    }


def _times(run: Recorded, walk: Sequence[Told]) -> Document:
    """When, how long without pauses, and how long the workers computed, of the walk and of all."""
    last_ns = max((told.time_ns for told in run.told), default=0)
    return {
        "first_utc": _utc(run.begun_ns),
        "last_utc": _utc(last_ns),
        "walk_s": wall_s(walk),
        "wall_s": wall_s(run.told),
        "walk_physics_s": sum(told.step.physics_s for told in walk),
        "physics_s": sum(told.step.physics_s for told in run.told),
    }


def _failure(told: Told) -> Document:
    step = told.step
    assert step.failure is not None  # noqa: S101  # the caller looked
    return {"lane": step.lane, "number": step.number, "design": str(step.design), "failure": step.failure.text()}


def _uniformity(told: Told) -> float:
    return told.step.uniformity


def _utc(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns / 1e9, UTC).isoformat(timespec="seconds") if time_ns else ""
