"""What is demanded of an effect before it is trusted: its trial at the workers, its derivative, its random numbers.

The trial (`containers.effect_trial`) has looked at the file by itself; here whole predictions are asked for, as a fit
will ask. The last question, whether a diagnosis finds the effect again, is the diagnosis' own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectSpec, Value
from luxloop.errors import RemoteError
from luxloop.model import Model
from validation.effects.confounding import confounding
from validation.effects.confusing import Ground
from validation.effects.known import Known, acting, applied, is_smooth, nearly_off, off_values, typical, with_effect
from validation.effects.signatures import RUNS, Column, Projection, projected, signature
from validation.prediction import Predictor

Real = NDArray[np.float64]

STABLE = 0.25
"""By which a derivative may change where its step is halved or doubled, of its length."""
SHARED = 0.5
"""A small effect's difference with the same seed, at most, of that of two seeds."""
SMALL = 0.003
"""Of the typical size of an effect: what it then does is small beside the noise of few histories. Ten times as much
of an absorption darkened a chip by 1 %, which was 0.8 of that noise."""
HISTORIES = 131_072
TOLD = 5
"""How many others are named that look like it."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at. `ok` of None: nothing is demanded, it is told."""

    check: str
    ok: bool | None
    said: str


def trial_of(known: Known, name: str) -> Iterator[Finding]:
    """What the workers found when they tried the file; of the catalogue's effects nothing."""
    trial = known.trials.get(f"{name}.py")
    if trial is None:
        why = known.refused.get(f"{name}.py")
        yield Finding("trial", False, why) if why else Finding("trial", None, "of the catalogue: tried by its tests")
        return
    for one in trial["findings"]:
        if one["check"] != "end":
            yield Finding(one["check"], bool(one["ok"]), one["said"])
    why = known.refused.get(f"{name}.py", "")
    if why and all(one["ok"] for one in trial["findings"]):
        yield Finding("trial", False, why)


def derivative(ground: Ground, model: Model, spec: EffectSpec, columns: Sequence[Column]) -> Iterator[Finding]:
    """Whether each derivative at off is the same with half and with double the step."""
    if spec.by_chance or not is_smooth(spec):
        yield from _noisy_derivative(ground, model, spec)
        return
    halved, doubled = (signature(ground.sight, model, spec, scale=scale) for scale in (0.5, 2.0))
    for number, (one, half, double) in enumerate(zip(columns, halved, doubled, strict=True)):
        changes = [_change(other, one, ground.projection) for other in (half, double)]
        said = f"by {_name(one)}: {_percent(changes[0])} other with half, {_percent(changes[1])} with double the step"
        ok = max(changes) <= STABLE
        yield Finding("derivative", ok, said if ok else said + _mend(ground, model, spec, number))


def _noisy_derivative(ground: Ground, model: Model, spec: EffectSpec) -> Iterator[Finding]:
    """The same, beyond what two runs of Monte Carlo, or of walks, differ by; steps have no room to be doubled."""
    sights = [replace(ground.sight, run=run) for run in range(RUNS)]
    full, halved = ([signature(sight, model, spec, scale=scale) for sight in sights] for scale in (1.0, 0.5))
    for number, one in enumerate(full[0]):
        (mean, noise), (other, more) = (_parted(ground, [run[number] for run in of]) for of in (full, halved))
        chance = float(noise @ noise)
        both, length = chance + float(more @ more), float(mean @ mean) - chance
        if length <= both:
            said = f"by {_name(one)}: with half the step more noise than effect: nothing can be said"
            yield Finding("derivative", None, said)
            continue
        change = float((other - mean) @ (other - mean)) - both
        share, noisy = ((part / length) ** 0.5 for part in (max(change, 0.0), both))
        said = f"by {_name(one)}: {_percent(share)} other with half the step, beyond the noise ({_percent(noisy)})"
        ok = share <= STABLE
        yield Finding("derivative", ok, said if ok else said + _mend(ground, model, spec, number))


def _parted(ground: Ground, runs: Sequence[Column]) -> tuple[Real, Real]:
    """Whitened, what two runs have in common on average, and half of what they differ by."""
    first, second = (ground.projection.rows(one) for one in runs)
    return (first + second) / 2.0, (first - second) / 2.0


def _mend(ground: Ground, model: Model, spec: EffectSpec, number: int) -> str:
    """What to do about a derivative that is another one with another step."""
    allowed = f"; allowed {_percent(STABLE)}"
    if is_smooth(spec) and ground.sight.views:
        first, second = (signature(replace(ground.sight, run=run), model, spec)[number] for run in range(RUNS))
        if (apart := _change(second, first, ground.projection)) > STABLE:
            said = f"{allowed}: by other walks inside the chips it is {_percent(apart)} other"
            chance = "where a share of the light goes another way outside them write by_chance = True"
            return f"{said}; {chance}, else each value has its own: write walks = True"
    return f"{allowed}: is score = 'square' right, or a range smaller?"


def _name(one: Column) -> str:
    return one.parameter + (f" of chip {one.chip}" if one.chip is not None else "")


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"


def _change(other: Column, one: Column, projection: Projection) -> float:
    rows, others = projection.rows(one), projection.rows(other)
    length = float(np.linalg.norm(rows))
    return float(np.linalg.norm(others - rows)) / length if length else 0.0


def shared_numbers(ground: Ground, predictor: Predictor, model: Model, spec: EffectSpec) -> Finding:
    """Whether Monte Carlo with the effect draws the random numbers of the run where it is nearly off.

    Not of that without it: a chip or module that has lost the symmetries of the square has other bins.
    """
    view = replace(ground.sight.views[-2], sensor=None)
    values = _small(spec, view.sample.rows * view.sample.columns)
    small = with_effect(model, applied(spec, values))
    off = with_effect(model, applied(spec, nearly_off(spec, values))) if acting(spec) else model
    (base,), (again,), (moved,) = (
        predictor.monte_carlo(at, [view], HISTORIES, seed) for at, seed in ((off, 1), (off, 2), (small, 1))
    )
    alone = _rms(base.irradiance_per_mm2 - again.irradiance_per_mm2)
    together = _rms(base.irradiance_per_mm2 - moved.irradiance_per_mm2)
    said = f"same seed: {together / alone:.3f} of the difference of two seeds (a small effect, {HISTORIES:,} rays)"
    if spec.walks:
        return Finding("random numbers", None, f"{said}; not demanded, each value has walks of its own")
    return Finding("random numbers", together <= SHARED * alone, said)


def _small(spec: EffectSpec, chips: int) -> dict[str, Value]:
    """Near off: by a small share of the typical size."""
    off, there = off_values(spec, chips=chips), typical(spec, chips)
    return {one.name: _between(off[one.name], there[one.name]) for one in spec.parameters}


def _between(off: Value, there: Value) -> Value:
    if isinstance(off, tuple) and isinstance(there, tuple):
        return tuple(a + SMALL * (b - a) for a, b in zip(off, there, strict=True))
    if isinstance(off, float | int) and isinstance(there, float | int):
        return off + SMALL * (there - off)
    return there


def _rms(image: Real) -> float:
    return float(np.sqrt(np.mean(image**2)))


def likeness(
    ground: Ground, model: Model, spec: EffectSpec, columns: Sequence[Column], others: Sequence[EffectSpec]
) -> list[tuple[str, float]]:
    """(effect, cosine) of all others that show, the most alike first; none where calibration imitates it wholly."""
    mine = projected(columns, ground.projection)
    if not mine.any():
        return []
    found = []
    for other in others:
        if other.name == spec.name:
            continue
        try:
            theirs = projected(ground.columns(model, other), ground.projection)
        except RemoteError:  # what cannot be predicted here cannot be compared with
            continue
        if theirs.any():
            found.append((other.name, abs(float(confounding({"one": mine, "other": theirs}).cosines[0, 1]))))
    return sorted(found, key=lambda pair: -pair[1])


def looks_like(near: Sequence[tuple[str, float]], ground: str) -> Finding:
    """The sentence that a user needs most."""
    if not near:
        return Finding("looks like", None, f"calibration imitates it wholly, on {ground}: the data cannot show it")
    name, cosine = near[0]
    then = ", ".join(f"{other} {value:.2f}" for other, value in near[1:TOLD])
    said = f"your effect is {cosine:.2f} the same as {name} for {ground}" + (f"; then {then}" if then else "")
    return Finding("looks like", None, said)
