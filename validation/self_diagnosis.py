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
from validation.diagnose.rounds import Diagnosis
from validation.diagnosing import Diagnosing
from validation.effects.checking import Finding
from validation.effects.confusing import Ground
from validation.effects.example_set import example_spectra, example_views, seen
from validation.effects.known import Known, acting, applied, far_end, is_smooth, off_values, with_effect
from validation.effects.signatures import Column, projected
from validation.fit import curves_of, film_parameters
from validation.fit.parameters import free_paths
from validation.measured import MeasuredImage
from validation.noise import rms_over_noise
from validation.observed import Observed
from validation.prediction import Predicted, Predictor
from validation.prediction.words import Traced

Real = NDArray[np.float64]

SIGMA = 20.0
TRUTH_SEED, NOISE_SEED = 11, 12
TRUTH_HISTORIES, ANCHOR_HISTORIES = 16_000_000, 4_000_000
"""Where the twin cannot represent the effect: of each image, and of the Monte Carlo that the diagnosis is about."""
MOST_NOISE = 0.3
"""Of the camera's, that such data may have of their own before nothing is demanded of a verdict about them."""
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
    noise = 0.0
    if not ground.sight.views:
        observed = noisy_spectra(truth, predictor)
    elif is_smooth(spec):
        observed = noisy_images(predictor.images(truth, example_views()))
    else:
        light, noise = monte_carlo(truth, predictor)
        observed = noisy_images(light)
    found = diagnosis(observed, predictor, known, model, spec, progress)
    finding = verdict_on(spec, found, f"{one.name} {value:.3g} {one.unit}".rstrip(), sigma)
    return finding if noise < MOST_NOISE else _undemanded(finding, noise)


def _undemanded(finding: Finding, noise: float) -> Finding:
    """What was found in data whose own noise a diagnosis may have seen."""
    if finding.ok:
        return finding
    why = f"; not demanded, for these data are Monte Carlo's, with {noise:.2f} of the camera's noise of their own"
    return replace(finding, ok=None, said=finding.said + why)


def monte_carlo(truth: Model, predictor: Predictor) -> tuple[list[Traced], float]:
    """The light of the example images, and the noise left in it: rms, in the example camera's, of the worst image.

    Without the chips' symmetry one exit stands for one instead of eight: 16 million histories leave 0.65 in an array
    then (by two halves, compared), and not each pixel by itself, so a test of structure sees it.
    """
    light = predictor.monte_carlo(truth, example_views(), TRUTH_HISTORIES, TRUTH_SEED)
    shares = []
    for one, image in zip(light, seen(light), strict=True):
        gain_dn = image.signal_dn.max() / one.irradiance_per_mm2.max()
        shares.append(rms_over_noise(gain_dn * one.error_per_mm2, image.variance_dn2(image.signal_dn)))
    return light, max(shares)


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


def noisy_images(light: Sequence[Predicted]) -> Observed:
    """The example images of some light, with the noise of the example camera."""
    random = np.random.default_rng(NOISE_SEED)
    return Observed(
        tuple(replace(one, signal_dn=one.signal_dn + _noise(one, random)) for one in seen(light)), (), (), {}
    )


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
