"""The last question to an effect: hidden in data at 20 sigma, is it found again, or a group that it belongs to?

The data are the example images, or the curves of the example film, as the model with the effect would give them, with
noise of the example camera or instruments drawn once; then the model without it is diagnosed among all effects that
the workers know, of films their thickness and index free.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectParameter, EffectSpec
from luxloop.model import Model
from validation.comparing import Solver
from validation.diagnose.diagnosis import Diagnosis
from validation.diagnosing import Diagnosing
from validation.effects.checking import Finding
from validation.effects.confusing import Ground
from validation.effects.example_set import example_images, example_spectra
from validation.effects.known import Known, acting, applied, far_end, is_smooth, off_values, with_effect
from validation.effects.signatures import Column, projected
from validation.fit import curves_of, film_parameters
from validation.fit.parameters import free_paths
from validation.measured import MeasuredImage
from validation.observed import Observed
from validation.prediction import Predictor

Real = NDArray[np.float64]

SIGMA = 20.0
TRUTH_SEED, NOISE_SEED = 11, 12
TRUTH_HISTORIES, ANCHOR_HISTORIES = 16_000_000, 4_000_000
"""Where the twin cannot represent the effect: of each image, and of the Monte Carlo that the diagnosis is about."""
CHECK = "self-diagnosis"


def self_diagnosed(
    ground: Ground,
    predictor: Predictor,
    known: Known,
    model: Model,
    spec: EffectSpec,
    columns: Sequence[Column],
    progress: Callable[[float, str], None] = lambda *_: None,
) -> Finding:
    """Whether a diagnosis names the effect or its group; nothing is demanded where no single size can be hidden."""
    if any(one.per_chip for one in acting(spec)):
        return Finding(CHECK, None, "an effect of every chip has no single size to hide")
    one, value, sigma = loudest(spec, columns, projected(columns, ground.projection))
    if sigma < 1.0:
        return Finding(CHECK, None, "calibration imitates it wholly")
    truth = with_effect(model, applied(spec, off_values(spec) | {one.name: value}))
    observed = noisy_images(truth, predictor, spec) if ground.sight.views else noisy_spectra(truth, predictor)
    found = diagnosis(observed, predictor, known, model, spec, progress)
    return verdict_on(spec, found, f"{one.name} {value:.3g} {one.unit}".rstrip(), sigma)


def loudest(spec: EffectSpec, columns: Sequence[Column], rows: Real) -> tuple[EffectParameter, float, float]:
    """The parameter that shows most, the value at which it stands out by 20 sigma, or by fewer at its range's end."""
    by_name, lengths = {one.name: one for one in acting(spec)}, np.linalg.norm(rows, axis=1)
    best, found = -1.0, None
    for column, length in zip(columns, lengths, strict=True):
        one = by_name[column.parameter]
        off, power = float(one.off or 0.0), 2 if one.score_variable == "square" else 1
        room = abs(far_end(one) - off)
        most = float(length) * room**power
        if most > best:
            by = room * min(1.0, SIGMA / most) ** (1.0 / power) if most else 0.0
            best, found = most, (one, off + np.sign(far_end(one) - off) * by, min(most, SIGMA))
    assert found is not None  # noqa: S101  # an effect that shows has a column
    return found


def noisy_images(truth: Model, predictor: Predictor, spec: EffectSpec) -> Observed:
    """The example images of a model, with the noise of the example camera."""
    random = np.random.default_rng(NOISE_SEED)
    images = example_images(truth, predictor, 0 if is_smooth(spec) else TRUTH_HISTORIES, TRUTH_SEED)
    seen = tuple(replace(one, signal_dn=one.signal_dn + _noise(one, random)) for one in images)
    return Observed(seen, (), (), {})


def _noise(image: MeasuredImage, random: np.random.Generator) -> Real:
    signal_dn = image.signal_dn
    return np.sqrt(image.variance_dn2(signal_dn)) * random.standard_normal(signal_dn.shape)


def noisy_spectra(truth: Model, predictor: Predictor) -> Observed:
    """The curves of the example film as a model has it, with the errors of its instruments."""
    random = np.random.default_rng(NOISE_SEED)
    spectra = [
        replace(one, table=replace(one.table, value=random.normal(one.table.value, one.table.sigma)))
        for one in example_spectra(truth, predictor)
    ]
    films, films_at = film_parameters(spectra)
    return Observed((), tuple(curves_of(spectra, ())), tuple(films), films_at)


def diagnosis(
    observed: Observed,
    predictor: Predictor,
    known: Known,
    model: Model,
    spec: EffectSpec,
    progress: Callable[[float, str], None],
) -> Diagnosis:
    """Of data by the model without the effect; about Monte Carlo where the twin cannot represent it."""
    solver = Solver(None if is_smooth(spec) else ANCHOR_HISTORIES)
    free = tuple(free_paths(model)) if observed.of_modules else ()
    return Diagnosing(model, observed, predictor, known, solver, free, progress=progress).diagnosed()


def verdict_on(spec: EffectSpec, found: Diagnosis, hidden: str, sigma: float) -> Finding:
    """What is said of a diagnosis of data that hide an effect."""
    step, word = found.steps[0], found.verdict.word
    named = step.verdict.set
    group = step.confounding.group_of(named[0]) if named else ()
    said = f"{hidden} hidden, {sigma:.0f} sigma: {word}"
    if spec.name in named:
        return Finding(CHECK, True, f"{said}: {', '.join(named)}")
    if spec.name in group:
        return Finding(CHECK, True, f"{said}: {', '.join(named)}, of its group {', '.join(group)}")
    if sigma < SIGMA:
        return Finding(CHECK, None, f"{said}; at the end of its range these data hardly show it")
    return Finding(CHECK, False, f"{said}{': ' if named else ''}{', '.join(named)}")
