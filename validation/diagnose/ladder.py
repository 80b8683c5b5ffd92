"""The ladder: errors of one version of a model after another, fitted and held out, down to the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from luxloop.errors import InputError
from luxloop.model import Model
from luxloop.model_file import parse_toml
from validation.diagnose.ground import Ground
from validation.diagnose.held_out import folds_by_blocks, folds_of, held_out, levels_of, percent
from validation.fit import Fit
from validation.model_versions import Version
from validation.sample_values import is_by_sample

NAMES = {
    "fitted_percent": "fitted %", "held_out_percent": "held-out %", "blocks_percent": "held-out in blocks %",
    "noise_percent": "noise %", "p": "p", "curves_fitted_percent": "curves: fitted %",
    "curves_held_out_percent": "curves: held-out %", "curves_noise_percent": "curves: noise %",
}  # fmt: skip
"""Of the numbers of a rung: how a version's errors call them."""
BEFORE = "before: "
"""Leads the errors of the model that a version was made from, where that had none of its own."""


@dataclass(frozen=True)
class Rung:
    """What a model leaves: rms errors in percent of the mean signal, p of structure."""

    fitted_percent: float
    held_out_percent: float | None
    """None: there are images of one sample only."""
    noise_percent: float
    """Of the camera and of the prediction's own Monte Carlo: what a right model leaves."""
    p: float
    blocks_percent: float | None = None
    """Of halves of every image, left out in turn: what tells of values that each sample has of its own."""
    curves_fitted_percent: float | None = None
    """Of curves beside images, of the mean value of those of a unit; effects on films are seen in them alone."""
    curves_held_out_percent: float | None = None
    curves_noise_percent: float | None = None

    @classmethod
    def of(cls, ground: Ground, blocks: bool = False) -> Rung:
        """Of a fit and its structure; `blocks`: halves of the images are left out, too."""
        fit, folds = ground.fit, folds_of(ground.fit)
        held = held_out(fit, folds) if folds else None
        halves = held_out(fit, folds_by_blocks(fit)).rms_percent if blocks else None
        fitted, noise = _percents(fit, curves=not fit.problem.images)
        rung = cls(fitted, None if held is None else held.rms_percent, noise, ground.structure.p, halves)
        if not (fit.problem.images and fit.problem.curves):
            return rung
        fitted, noise = _percents(fit, curves=True)
        left_out = None if held is None else held.curves_percent
        return replace(
            rung, curves_fitted_percent=fitted, curves_held_out_percent=left_out, curves_noise_percent=noise
        )

    def errors(self, lead: str = "") -> dict[str, float]:
        """As a version keeps them."""
        return {
            f"{lead}{words}": value for name, words in NAMES.items() if (value := getattr(self, name)) is not None
        }


def _percents(fit: Fit, *, curves: bool) -> tuple[float, float]:
    """The error in what was fitted and that of noise alone, of the images or of the curves."""
    count = fit.whitening.count
    rows = slice(count, None) if curves else slice(count)
    if curves:
        sigma = np.concatenate([*fit.whitening.curve_sigma])
        squares, variance = (fit.residual[rows] * sigma) ** 2, sigma**2
    else:
        images = fit.problem.images
        each = zip(images, fit.signals_dn, strict=True)
        squares = np.concatenate([(one.signal_dn - dn)[one.used] for one, dn in each]) ** 2
        variance = np.concatenate([fit.variance_dn2(number)[one.used] for number, one in enumerate(images)])
    level = levels_of(fit)[rows]
    return percent(squares, level), percent(variance, level)


def ladder(known: Sequence[Version], texts: Mapping[int, str]) -> dict[str, Any]:
    """The rungs of all versions that have errors, and the parameters that moved, as plain values.

    Raises InputError where no version has errors.
    """
    rows, models = [], {}
    for number, version in enumerate(known):
        following = known[number + 1].errors if number + 1 < len(known) else {}
        numbers = _numbers(version.errors) or _numbers(following, BEFORE)
        if numbers is None:
            continue
        numbers["blocks_percent"] = numbers["blocks_percent"] or following.get(f"{BEFORE}{NAMES['blocks_percent']}")
        model = _model(texts[version.number])
        models[version.number] = model
        effects = [effect.name for effect in model.effects] if model is not None else []
        rows.append({"version": version.number, "command": version.command, "effects": effects, **numbers})
    if not rows:
        mend = "luxloop add and luxloop calibrate keep what they find"
        raise InputError(
            "--model", f"{len(known)} versions, none fitted", "a model file with a version that was fitted", mend
        )
    return {"rungs": rows, "parameters": _moved(models)}


def _numbers(errors: Mapping[str, float], lead: str = "") -> dict[str, float | None] | None:
    found = {name: errors.get(f"{lead}{words}") for name, words in NAMES.items()}
    return found if found["fitted_percent"] is not None else None


def _model(text: str) -> Model | None:
    try:
        return parse_toml(text, "")
    except InputError:
        return None  # kept as it was, though it is no model


def _moved(models: Mapping[int, Model | None]) -> list[dict[str, Any]]:
    """Parameters that all samples have in common and that differ between versions, with their priors."""
    known = [model for model in models.values() if model is not None]
    paths = list(dict.fromkeys(path for model in known for path in model.fit if not is_by_sample(model, path)))
    rows = []
    for path in paths:
        values = [None if model is None else model.leaves().get(path) for model in models.values()]
        if len({value for value in values if value is not None}) < 2:
            continue
        fit = next(model.fit[path] for model in known if path in model.fit)
        prior = "" if fit.prior_mean is None else f"{fit.prior_mean:g} +- {fit.prior_sd:g}"
        texts = [
            "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value) for value in values
        ]
        rows.append({"path": path, "prior": prior, "values": texts})
    return rows
