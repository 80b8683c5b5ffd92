"""The measurement that would tell rivals apart: what is expected of candidate images, before one is taken.

Candidates are samples like those that were measured, at another distance, with other pairs, single or as an array,
at four times the exposure, and a repeat. Of each the columns are predicted by the twin, its noise by the camera that
took the others and by the Monte Carlo that they are compared with; `separation` says how many sigma would then lie
between the rivals. A further image of a sample that was measured is that image with more frames: the pattern of the
camera, the noise of Monte Carlo and what that sample has of its own stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectSpec, Value
from luxloop.errors import InputError, RemoteError
from luxloop.model import Model
from validation.dataset.manifest import Sample
from validation.diagnose.columns import FitSight
from validation.diagnose.proposal import Proposal
from validation.diagnose.refitted import Refitted
from validation.diagnose.separation import Rows, sigma_left
from validation.effects.known import applied, nearly_off, off_values, with_effect
from validation.effects.signatures import HISTORIES, RUNS, Sight
from validation.fit import Fit
from validation.fit.model_noise import NoiseBlock
from validation.fit.parameters import tied
from validation.fit.problem import Evaluation, sensor_of, view_of
from validation.fit.whitening import Whitening
from validation.measured import MeasuredImage
from validation.prediction import POSE_COLUMNS, Anchored, Pose, Predictor, Sensor
from validation.prediction.differences import Moved
from validation.sample_values import LEAD, with_sample

Real = NDArray[np.float64]

NEAR_UM = 100.0
"""Another distance: at it the lobe of light is seen at other angles on the same pixels."""
MANY_PAIRS = 9.5
EXPOSURES = 4.0


@dataclass(frozen=True, eq=False)
class Rivals:
    """Effects at their fitted sizes on one fit: what a further image is to tell apart."""

    fit: Fit
    refits: Sequence[Refitted]
    predictor: Predictor
    beyond_twin: frozenset[str]
    """Names of effects that the twin cannot represent."""

    def proposals(self, heard: Callable[[float, str], None] = lambda *_: None) -> list[Proposal]:
        """All candidates, the best first. Empty where not two of the rivals have a size that an image shows."""
        usable = [one for one in self.refits if _has_size(one) and "modules" in one.candidate.effect.acts_on]
        if not image_can_tell(self.fit.problem.images, [one.candidate.effect for one in usable]):
            return []
        changes = self._changes(usable)
        here = self._on_measured(self.fit.problem.images, changes)
        prior_sd = self._prior_sd(self._shared)
        now = _separation([here], prior_sd, usable)
        found = []
        samples = [image.sample for image in self.fit.problem.images]
        shots = (*(one.shot.id for one in self.fit.problem.images), *(one.id for one in self.fit.problem.curves))
        candidates = list(candidates_of(samples))
        for number, (words, sample, exposure) in enumerate(candidates):
            heard(number / len(candidates), words)
            try:
                if sample in samples:
                    rows = [self._on_measured(self._with_more_of(sample, exposure), changes)]
                else:
                    rows = [here, self._there(sample, exposure, usable)]
            except (InputError, RemoteError) as error:  # a sample that cannot be built is no proposal
                if isinstance(error, RemoteError) and error.failure.code != "bad_input":
                    raise
                continue
            sigma = _separation(rows, prior_sd, usable)
            found.append(Proposal(words, sample, exposure, sigma, now, sample in samples, shots))
        return sorted(found, key=lambda one: -one.expected_sigma)

    @property
    def _paths(self) -> tuple[str, ...]:
        """Of the model, what a further image says more of: not what other samples have of their own."""
        return tuple(path for path in self.fit.problem.unknowns.model_paths if not path.startswith(LEAD))

    @property
    def _shared(self) -> tuple[str, ...]:
        """All that a further image says more of: the gain, too, where it follows the exposure."""
        return (*self._paths, *(name for name in self.fit.names if name == "gain"))

    def _prior_sd(self, names: Sequence[str]) -> Real:
        """Of unknowns of the fit; inf without a prior."""
        by_name = {one.name: one.prior_sd for one in self.fit.problem.unknowns.parameters}
        return np.array([by_name[name] for name in names])

    def _changes(self, usable: Sequence[Refitted]) -> dict[str, list[Real]]:
        """What each effect of its fitted size does to what was measured: images in DN, then curves; by its name."""
        fit = self.fit
        sight = FitSight.of(fit, self.predictor, self.beyond_twin)
        scales = [fit.gains[one.shot.id] for one in fit.problem.images]
        scales += [fit.value(f"{one.id}.scale") if one.free_scale else 1.0 for one in fit.problem.curves]
        return {
            one.candidate.effect.name: [
                scale * part for scale, part in zip(scales, self._change(sight, one), strict=True)
            ]
            for one in usable
        }

    def _on_measured(self, images: Sequence[MeasuredImage], changes: Mapping[str, list[Real]]) -> Rows:
        """The columns on the rows that were measured, by the noise of these images; those of curves stay."""
        at = replace(self._measured, problem=replace(self.fit.problem, images=tuple(images)))
        white = at.whitening()
        columns = at.columns(white)
        own = np.isin(self.fit.names, self._shared)
        effects = {name: _white(white, change) for name, change in changes.items()}
        return Rows(columns[own], columns[~own], self._prior_sd(self.fit.names)[~own], effects)

    def _with_more_of(self, sample: Sample, exposure: float) -> list[MeasuredImage]:
        """The images; the first one of a sample is the mean with another of `exposure` times its light.

        Its dark is the same.
        """
        images, more = list(self.fit.problem.images), 1.0 + exposure
        at = next(number for number, one in enumerate(images) if one.sample.id == sample.id)
        one = images[at]
        constant_dn2 = (one.constant_dn2 - one.dark_dn2) / more + one.dark_dn2
        images[at] = replace(one, constant_dn2=constant_dn2, slope_dn=one.slope_dn / more)
        return images

    def _there(self, sample: Sample, exposure: float, usable: Sequence[Refitted]) -> Rows:
        """The columns that an image of a sample would have, with a peak as bright as those that were taken.

        Its gain (or what that errs by from its exposure), its offset and its place are its own, under priors as those
        of the images.
        """
        fit, like, paths = self.fit, _nearest(self.fit.problem.images, sample), self._paths
        at = self.fit.problem.unknowns.named(self.fit.values)
        view = replace(view_of(like, Pose()), sample=sample, sensor=sensor_of(like, at))
        traced = any(effect.name in self.beyond_twin for effect in fit.model.effects)
        anchor = Anchored(fit.model, RUNS * HISTORIES) if traced else None
        (found,) = self.predictor.images(fit.model, [view], (*paths, *POSE_COLUMNS), anchor)
        peak_dn = max(float(signal[image.used].max()) for image, signal in _lit(fit))
        gain = peak_dn / float(found.irradiance_per_mm2.max())
        signal = gain * found.irradiance_per_mm2
        sigma = np.sqrt(like.variance_dn2(signal) / exposure + (like.prnu * signal) ** 2)
        view = replace(view, sensor=Sensor(gain, 0.0, like.camera.full_scale_dn - like.camera.black_level_dn))
        sight = Sight(self.predictor, [view], beyond_twin=self.beyond_twin)
        block = self._noise(like, found.irradiance_per_mm2, gain / sigma)

        def rows(images: Sequence[Real]) -> Real:
            white = np.array([(one / sigma).ravel() for one in images]).reshape(len(images), signal.size)
            if block is not None and len(images):
                block.take_out(white)
            return white

        by_gain = signal if found.by_gain_per_mm2 is None else gain * found.by_gain_per_mm2
        by_offset = np.ones_like(signal) if found.by_offset is None else found.by_offset
        nuisances = [by_gain, by_offset, *(gain * found.jacobian_per_mm2[name] for name in POSE_COLUMNS)]
        names = ("gain_error" if tied(like) else "gain", "offset_dn", *POSE_COLUMNS)
        shared = [gain * found.jacobian_per_mm2[path] for path in paths]
        shared += [by_gain / at["gain"]] if tied(like) else []
        changes = rows([gain * self._change(sight, one)[0] for one in usable])
        return Rows(
            rows(shared),
            rows(nuisances),
            self._prior_sd([f"{like.shot.id}.{name}" for name in names]),
            {one.candidate.effect.name: row for one, row in zip(usable, changes, strict=True)},
        )

    @cached_property
    def _measured(self) -> Evaluation:
        """What the fit predicts of the images that were taken."""
        return self.fit.problem.evaluate(self.fit.values)

    def _noise(self, like: MeasuredImage, light_per_mm2: Real, weight: Real) -> NoiseBlock | None:
        """What Monte Carlo leaves in a further image: the same share of the light as in one that was taken.

        `weight` (row, column): whitens by the camera's noise. None where there is no Monte Carlo.
        """
        at = next(number for number, one in enumerate(self.fit.problem.images) if one is like)
        predicted = self._measured.predicted[at]
        if predicted.noise_per_mm2 is None:
            return None
        share = light_per_mm2.sum() / predicted.irradiance_per_mm2.sum()
        columns = (share * weight * predicted.noise_per_mm2).reshape(len(predicted.noise_per_mm2), -1)
        return NoiseBlock.of(np.arange(light_per_mm2.size), columns)

    def _change(self, sight: Sight, one: Refitted) -> tuple[Real, ...]:
        """What an effect of its fitted size does to the images of the model without it."""
        effect = one.candidate.effect
        model = sight.at(self.fit.model, effect)
        there, off = self._at_size(model, one), model
        if effect.walks:
            values = next(other.parameters for other in there.effects if other.name == effect.name)
            off = with_effect(model, applied(effect, nearly_off(effect, values)))
        moved = [Moved(1.0, there), Moved(-1.0, off)]
        return sight.summed(moved, not effect.twin, lender=model, walks=effect.walks)

    def _at_size(self, model: Model, one: Refitted) -> Model:
        """The model with the effect as it was fitted: in the shape that it ended with, to which its size belongs.

        Of one that samples have each their own of, a further sample would have that of the one that scored.
        """
        spec, off = one.candidate.effect, off_values(one.candidate.effect, dict(one.shape))
        own: dict[str, dict[str, Value]] = {}
        for each in () if one.candidate.is_switch else (one.candidate, *one.candidate.others):
            own.setdefault(each.sample, dict(off))[each.parameter.name] = one.size[each.path]
        model = with_effect(model, applied(spec, own.get(one.candidate.sample, off)))
        for image in self.fit.problem.images if one.candidate.sample else ():
            model = with_sample(model, image.sample.id, spec.name, own.get(image.sample.id, off))
        return model


def left_out_of(refits: Sequence[Refitted]) -> list[str]:
    """Names of rivals with numbers of their own chip by chip: no size of them that a further image would show."""
    return [one.candidate.effect.name for one in refits if not _has_size(one)]


def image_can_tell(images: Sequence[MeasuredImage], effects: Sequence[EffectSpec]) -> bool:
    """Whether there are images, and two effects or more that a further one would show: those of films are in none."""
    return bool(images) and sum("modules" in one.acts_on for one in effects) > 1


def candidates_of(samples: Sequence[Sample]) -> Iterator[tuple[str, Sample, float]]:
    """(words, sample, exposure ratio) of what could be measured next, from what was."""
    seen = set()
    arrays = [one for one in samples if one.layout == "array"] or list(samples)
    pairs = sorted({one.dbr_pairs for one in samples} | {0.0, MANY_PAIRS})
    for base in (arrays[0], next((one for one in samples if one.layout == "single"), arrays[0])):
        for distance in dict.fromkeys((base.distance_um, NEAR_UM)):
            for count in pairs:
                words = f"{base.layout}, {f'{count:g} pairs' if count else 'no DBR'}, D = {distance / 1000.0:.2f} mm"
                name = f"next-{base.layout}-{count:g}-{distance:g}".replace(".", "_")
                name += "-again" * any(one.id == name for one in samples)
                sample = base.model_copy(update={"id": name, "dbr_pairs": count, "distance_um": distance})
                there = next((one for one in samples if _same(sample, one)), None)
                if (words, there is None) not in seen:
                    seen.add((words, there is None))
                    yield (words if there is None else f"{words} (a repeat)"), there or sample, 1.0
    base = arrays[0]
    yield f"{base.id} again at {EXPOSURES:g} times the exposure (or frames)", base, EXPOSURES


def _white(white: Whitening, change: Sequence[Real]) -> Real:
    """Whitened rows of images, then of curves."""
    count = len(white.used)
    curves = [part / sigma for part, sigma in zip(change[count:], white.curve_sigma, strict=True)]
    return np.concatenate([white.rows(change[:count]), *curves])


def _separation(rows: Sequence[Rows], prior_sd: Real, usable: Sequence[Refitted]) -> float:
    """The least of what is left of the first effect beside each of the others."""
    first, *others = (one.candidate.effect.name for one in usable)
    return min(sigma_left(rows, prior_sd, first, [other]) for other in others)


def _has_size(one: Refitted) -> bool:
    return one.model is not None and not one.candidate.is_group


def _same(one: Sample, other: Sample) -> bool:
    return one.model_copy(update={"id": ""}) == other.model_copy(update={"id": ""})


def _nearest(images: Sequence[MeasuredImage], sample: Sample) -> MeasuredImage:
    """An image of the same layout, whose camera and binning a further one would have."""
    return next((one for one in images if one.sample.layout == sample.layout), images[0])


def _lit(fit: Fit) -> Iterator[tuple[MeasuredImage, Real]]:
    return zip(fit.problem.images, fit.signals_dn, strict=True)
