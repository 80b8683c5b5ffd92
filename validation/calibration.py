"""Calibration: candidates by least mean square error as in the paper, then the continuous fit with its errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from luxloop.model import Model, Surface
from luxloop.units import unit_of
from validation.comparing import Comparison, Solver, compared
from validation.fit import Profile, profile
from validation.observed import Observed
from validation.prediction import Predictor
from validation.virtual_realistic import KINDS, PARTS, Experiment, Stage

Way = Literal["in turn", "joint"]
NORMAL_95 = 1.959964
CORRELATED = 0.95
"""Beyond it two parameters are said to be hardly told apart."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What a calibration came to: the stages of the paper's experiment, the model before and after."""

    stages: tuple[Stage, ...]
    before: Comparison
    after: Comparison
    profiles: tuple[Profile, ...]
    way: Way | None
    asked: tuple[str, ...]
    """The paths of the model that were to be fitted, those among them that these data say nothing of."""

    @property
    def free(self) -> tuple[str, ...]:
        """The parameters that were fitted, of the model and of films, as far as these data see them."""
        unknowns = self.after.fit.problem.unknowns
        paths = (*unknowns.model_paths, *unknowns.other_paths)
        return tuple(path for path in paths if np.isfinite(self.after.fit.error(path)))

    def document(self) -> dict[str, Any]:
        """Everything that is told, as plain values."""
        fit, after = self.after.fit, self.after.document()
        return {
            "sentence": self.sentence,
            "solver": self.after.solver.document(),
            "trusted": fit.trusted,
            "reason": "; ".join(fit.distrust),
            "stages": [stage.document() for stage in self.last_stages],
            "rounds": self._rounds(),
            "fit": {
                "parameters": [self._parameter(path) for path in self.free],
                "unseen": [path for path in self.asked if path not in self.free and path in fit.problem.model.fit],
                "left_out": [path for path in self.asked if path not in fit.problem.model.fit],
                "correlation": [[float(value) for value in row] for row in self._correlation()],
                "correlated": self._correlated(),
                "profiles": [
                    {"path": one.name, "x": list(map(float, one.values)), "chi2": list(map(float, one.chi2_above))}
                    for one in self.profiles
                ],
                "chi2_per_pixel": fit.chi2_per_row,
                "iterations": fit.iterations,
                "gap": fit.gap,
            },
            "errors": [_errors("before", self.before), _errors("after", self.after)],
            "structure": after["structure"],
            "shots": after["shots"],
        }

    @property
    def sentence(self) -> str:
        """What to say first."""
        if not self.after.observed.of_modules:
            paths = self.after.fit.problem.unknowns.other_paths
            films = dict.fromkeys(path.partition(".")[2].rpartition(".layers.")[0] for path in paths)
            return f"spectra of {', '.join(films) or 'films'} fitted"
        substrate, receiver = (named(getattr(self.after.fit.model.environment, part)) for part in PARTS)
        return f"substrate {substrate}; receiver {receiver}"

    @property
    def last_stages(self) -> list[Stage]:
        """The last stage of each surface."""
        return list({stage.part: stage for stage in self.stages}.values())

    def _rounds(self) -> list[dict[str, Any]]:
        """What the experiment in turn came to, stage by stage; the joint one has none."""
        stages = self.stages if self.way == "in turn" else ()
        return [
            {"round": 1 + number // 2, **self._chosen(number), "mse": stage.best.mse}
            for number, stage in enumerate(stages)
        ]

    def _chosen(self, number: int) -> dict[str, str]:
        """Both surfaces as they stood after a stage."""
        start = self.before.fit.model.environment
        chosen: dict[str, str] = {part: named(getattr(start, part)) for part in PARTS}
        for stage in self.stages[: number + 1]:
            for candidate in stage.best.candidates:
                chosen[candidate.part] = str(candidate)
        return chosen

    def _parameter(self, path: str) -> dict[str, Any]:
        before, fit = self.before.fit, self.after.fit
        value, error = fit.value(path), fit.error(path)
        (limits,) = (one for one in fit.problem.unknowns.parameters if one.name == path)
        prior = (limits.prior_mean, limits.prior_sd) if np.isfinite(limits.prior_sd) else (None, None)
        start = before.value(path) if path in before.names else before.model.leaves()[path]
        return {
            "path": path, "unit": unit_of(path), "start": start, "value": value,
            "error": error, "lower95": max(value - NORMAL_95 * error, limits.lower),
            "upper95": min(value + NORMAL_95 * error, limits.upper), "prior_mean": prior[0],
            "prior_sd": prior[1], "at_limit": path in fit.at_limit,
        }  # fmt: skip

    def _correlation(self) -> Any:
        fit = self.after.fit
        rows = [fit.names.index(path) for path in self.free]
        return fit.correlation[np.ix_(rows, rows)]

    def _correlated(self) -> list[str]:
        """Pairs that the data hardly tell apart, in words."""
        correlation = self._correlation()
        return [
            f"{one} and {other} are correlated by {correlation[i, j]:+.2f}: only a combination of them is known"
            for i, one in enumerate(self.free)
            for j, other in enumerate(self.free[:i])
            if abs(correlation[i, j]) > CORRELATED
        ]


def calibrated(
    model: Model,
    observed: Observed,
    predictor: Predictor,
    solver: Solver,
    *,
    way: Way | None,
    free: Sequence[str],
    progress: Callable[[float, str], None] = lambda *_: None,
    cache: Path | None = None,
) -> Calibrated:
    """The paper's experiment (`way`; None leaves it out) and the continuous fit of the parameters `free`.

    Raises InputError where there are no images of single chips or of arrays to decide by.
    """
    progress(0.0, "the model as it is")
    before = compared(model, observed, predictor, replace(solver, most_histories=0), cache=cache)
    stages: list[Stage] = []
    if way is not None:
        found = before.fit
        named = found.problem.unknowns.named(found.values)
        experiment = Experiment(observed.images, found.poses, named, predictor, solver.anchor(model))
        if way == "joint":
            stages = list(experiment.joint(model, progress))
            for stage in stages:
                model = stage.best.candidates[-1].applied(model)
        else:
            for after_stage, stage in experiment.in_turn(model, progress):
                model = after_stage
                stages.append(stage)
    kept = [path for path in free if path in model.fit and (observed.of_modules or path.startswith("effects."))]
    progress(0.0, "the fit, with Monte Carlo" if solver.histories else "the fit")
    after = compared(model, observed, predictor, solver, free=kept, cache=cache)
    progress(0.5, "profiles")
    held = [path for path in kept if path not in after.fit.at_limit and np.isfinite(after.fit.error(path))]
    profiles = tuple(profile(after.fit, path) for path in held)
    return Calibrated(tuple(stages), before, after, profiles, way, tuple(free))


def named(surface: Surface) -> str:
    """A surface in words: its kind by the paper's name where it has one, its reflectance."""
    kind = next((name for name, sigma_deg in KINDS.items() if sigma_deg == surface.sigma_deg), None)
    return f"{kind or f'Gaussian {surface.sigma_deg:.3g} deg'}, {100.0 * surface.reflectance:.4g} %"


def _errors(name: str, found: Comparison) -> dict[str, Any]:
    rows = {shot["id"]: shot for shot in found.document()["shots"]}
    return {
        "model": name,
        "rms_error_percent": {shot: row["rms_error_percent"] for shot, row in rows.items()},
        "noise_percent": {shot: row["noise_percent"] for shot, row in rows.items()},
    }
