"""Truths of a blind test: surroundings drawn about a model, poses, and what is hidden in which set.

Everything follows from the seed. What a model frees is drawn from its priors, or, where it has none, by a tenth of
its range about the model's value; never nearer to a limit than a tenth of the range, where a fit could not be judged.
What is known of a truth before its images are looked at is drawn about it for every set (decision 76).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from luxloop.effect import did_you_mean
from luxloop.errors import InputError
from luxloop.model import Fit, Model
from validation import blind
from validation.blind_test.groups import group_of
from validation.dataset.manifest import CameraFacts, Sample
from validation.fit.parameters import free_paths

SHIFT_PX, ROTATION_DEG = 0.5, 0.1
"""Standard deviations of poses."""
MARGIN = 0.1
"""Of a range: truths keep as far from its ends."""
TRIES = 10_000
"""For a value that lies within."""
SEEDS = 2**48
SURROUNDINGS, PLAN, LIGHT, NOISE, KNOWN_BEFORE = 11, 12, 13, 14, 15
"""What the seed is drawn for."""


@dataclass(frozen=True)
class Truth:
    """A scene without anything hidden; several sets may share it."""

    number: int
    model: Model
    """The model with the truth's values: what a perfect calibration would find."""
    poses: tuple[blind.Pose, ...]
    seed: int
    """Of its walks."""

    @property
    def surroundings(self) -> blind.Surroundings:
        """In the words of the blind forward model."""
        return surroundings_of(self.model)

    def document(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "number": self.number, "surroundings": asdict(self.surroundings),
            "poses": [asdict(pose) for pose in self.poses],
        }  # fmt: skip


@dataclass(frozen=True)
class Planned:
    """A set before it is made."""

    id: str
    light: str
    truth: int
    count: int
    """Things to hide."""
    outside: bool
    """Whether they are outside of the catalogue."""
    seed: int
    """Of its noise, and of what hidden things draw."""


@dataclass(frozen=True)
class Counts:
    """How many sets of each sort are asked for."""

    sets: int
    outside: int = 0
    two: int = 0
    nothing: int = 0
    draws: int = 20
    """Sets with nothing hidden that share a light."""
    per_truth: int = 4
    """Sets with something hidden that share a truth."""

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        hidden = self.outside + self.two + self.nothing
        if hidden > self.sets:
            mend = "the others have one effect of the catalogue"
            raise InputError("--sets", self.sets, f"at least --outside + --two + --nothing, {hidden}", mend)

    @property
    def one(self) -> int:
        """Sets with one effect of the catalogue."""
        return self.sets - self.outside - self.two - self.nothing


def planned(counts: Counts, seed: int) -> list[Planned]:
    """The sets by number of their truth. Their names are shuffled: a name says nothing of what is hidden."""
    random = np.random.default_rng((seed, PLAN))
    width = len(str(counts.sets))
    names = [f"set-{number + 1:0{width}d}" for number in random.permutation(counts.sets)]
    sorts = [(1, False)] * counts.one + [(1, True)] * counts.outside + [(2, False)] * counts.two
    sorts = [sorts[k] for k in random.permutation(len(sorts))]
    found, truths = [], -(-len(sorts) // counts.per_truth)
    for number, (count, outside) in enumerate(sorts):
        name = names.pop()
        found.append(
            Planned(name, f"of-{name}", number // counts.per_truth, count, outside, _seed(random))
        )  # fmt: skip
    for number in range(counts.nothing):
        truth = truths + number // counts.draws
        light = f"of-{names[-1]}" if number % counts.draws == 0 else found[-1].light
        found.append(Planned(names.pop(), light, truth, 0, False, _seed(random)))
    return found


def truth_of(number: int, model: Model, images: int, seed: int) -> Truth:
    """The truth of a number: it does not depend on how many others there are."""
    random = np.random.default_rng((seed, SURROUNDINGS, number))
    for path in free_paths(model):
        model = model.with_value(path, _drawn(random, model, path))
    drawn = random.standard_normal((images, 3)) * (SHIFT_PX, SHIFT_PX, ROTATION_DEG)
    poses = tuple(blind.Pose(*(float(one) for one in row)) for row in drawn)
    return Truth(number, model, poses, _seed(np.random.default_rng((seed, LIGHT, number))))


def priors_of(truth: Truth, seed: int) -> dict[str, float]:
    """Means of priors by path, drawn about a truth: of what was measured before each set was, by somebody else.

    Cut only where a prior may not lie, beyond the limits of a fit: the nearer a cut is, the more of it sets share.
    """
    random = np.random.default_rng((seed, KNOWN_BEFORE))
    leaves, fit = truth.model.leaves(), truth.model.fit
    known = {path: (float(leaves[path]), fit[path].prior_sd) for path in free_paths(truth.model)}
    return {path: _within(random, fit[path], path, at, sd) for path, (at, sd) in known.items() if sd is not None}


def _drawn(random: np.random.Generator, model: Model, path: str) -> float:
    fit = model.fit[path]
    mean, sd = fit.prior_mean, fit.prior_sd
    if mean is None or sd is None:
        mean, sd = float(model.leaves()[path]), MARGIN * (fit.upper - fit.lower)
    return _within(random, fit, path, mean, sd, MARGIN)


def _within(random: np.random.Generator, fit: Fit, path: str, mean: float, sd: float, margin: float = 0.0) -> float:
    """A normal number between a path's limits, as far from them as that share of their distance."""
    room = margin * (fit.upper - fit.lower)
    lower, upper = fit.lower + room, fit.upper - room
    for _ in range(TRIES):
        value = float(random.normal(mean, sd))
        if lower <= value <= upper:
            return value
    allowed = f"a prior with room between {lower:g} and {upper:g}, where it is drawn from"
    raise InputError(f'fit."{path}"', f"{mean:g} +- {sd:g}", allowed, "move its limits, or the prior")


def _seed(random: np.random.Generator) -> int:
    return int(random.integers(SEEDS))


# In the words of the blind forward model


def surroundings_of(model: Model) -> blind.Surroundings:
    """The environment of a model. Raises InputError for what the blind forward model does not have."""
    at = model.environment
    if model.effects or model.samples:
        raise InputError("--model", model.name, "a model without effects", "they are what is looked for")
    words = {"spectrum": "averaged", "emission": "isotropic", "indices": "fixed", "spacing_is": "pitch",
             "distance_from": "substrate"}  # fmt: skip
    for name, word in words.items():
        if getattr(at, name) != word:
            mend = "the blind forward model has nothing else"
            raise InputError(f"environment.{name}", getattr(at, name), word, mend)
    if at.receiver.sigma_deg is not None:
        raise InputError("environment.receiver", "gaussian", "lambertian", "the blind forward model has nothing else")
    if at.substrate.sigma_deg is None:
        raise InputError("environment.substrate", "lambertian", "gaussian", "it has nothing else")
    try:
        return blind.Surroundings(
            substrate_reflectance=at.substrate.reflectance,
            substrate_sigma_deg=at.substrate.sigma_deg,
            receiver_reflectance=at.receiver.reflectance,
            chip_absorption_per_cm=at.chip_absorption_per_cm,
            active_layer_depth=at.active_layer_depth,
            chip_bottom=at.chip_bottom,
            n_gan=at.n_gan,
            n_aln=at.n_aln,
            gan_nm=at.gan_layer_nm,
            aln_nm=at.aln_layer_nm,
            layer_order=at.layer_order,
            peak_nm=at.peak_nm,
            fwhm_nm=at.fwhm_nm,
        )
    except ValueError as error:
        raise InputError("--model", model.name, "surroundings of the blind forward model", str(error)) from None


def sample_of(one: Sample) -> blind.Sample:
    """A sample of a plan. Raises InputError for one that the blind forward model cannot build."""
    try:
        return blind.Sample(
            id=one.id, rows=one.rows, columns=one.columns, distance_um=one.distance_um, width_um=one.width_um,
            spacing_um=one.spacing_um, thickness_um=one.thickness_um, dbr_pairs=one.dbr_pairs,
            module_half_um=one.half_um(),
        )  # fmt: skip
    except ValueError as error:
        raise _refused(error) from None


def camera_of(one: CameraFacts, pixels: int) -> blind.Camera:
    """A declared camera. Raises InputError for one that the blind forward model does not have."""
    if one.prnu_percent:
        raise InputError("camera.prnu_percent", one.prnu_percent, "0", "the blind forward model has no fixed pattern")
    if one.gain_mode != "free":
        mend = "a further image of a set is exposed alone, so its DN per ms is its own: leave gain_mode out"
        raise InputError("camera.gain_mode", one.gain_mode, "free", mend)
    try:
        return blind.Camera(
            rows=pixels, columns=pixels, pixel_um=one.pixel_um, bit_depth=one.bit_depth,
            gain_dn_per_e=one.gain_dn_per_e, read_noise_e=one.read_noise_e, full_well_e=one.full_well_e,
            black_level_dn=one.black_level_dn,
        )  # fmt: skip
    except ValueError as error:
        raise _refused(error) from None


def _refused(error: ValueError) -> InputError:
    """Of "FIELD = VALUE: ALLOWED is needed", as the blind forward model says it."""
    field, _, rest = str(error).partition(" = ")
    value, _, allowed = rest.partition(": ")
    mend = "change it in the plan: the blind forward model traces nothing else"
    return InputError(field, float(value), allowed.removesuffix(" is needed"), mend)


# Kinds


class Kinds:
    """Kinds in a drawn order, each taken as often as any other."""

    def __init__(self, names: Sequence[str], seed: int) -> None:
        """Raises InputError for a name that is no kind."""
        for name in names:
            if name not in blind.KINDS:
                mend = did_you_mean(name, blind.KINDS) or f"they are: {', '.join(blind.KINDS)}"
                raise InputError("--kinds", name, f"one of {len(blind.KINDS)} kinds", mend)
        order = np.random.default_rng((seed, PLAN, 1)).permutation(sorted(names or blind.KINDS))
        self._left: dict[bool, list[str]] = {
            outside: [str(name) for name in order if (not blind.KINDS[name].right) == outside]
            for outside in (False, True)
        }
        self._taken = {name: 0 for several in self._left.values() for name in several}

    def has(self, outside: bool) -> bool:
        """Whether any is left, inside or outside of the catalogue."""
        return bool(self._left[outside])

    def has_two(self) -> bool:
        """Whether two of the catalogue are in different groups."""
        return any(self.next(False, [name]) is not None for name in self._left[False])

    def next(self, outside: bool, beside: Sequence[str] = (), without: Collection[str] = ()) -> str | None:
        """The one that was taken least, in no group of those beside it, not of `without`; None where none is."""
        groups = {group_of(name) for kind in beside for name in blind.KINDS[kind].right}
        fitting = [
            name for name in self._left[outside] if name not in (*beside, *without)
            and not groups & {group_of(right) for right in blind.KINDS[name].right}
        ]  # fmt: skip
        return min(fitting, key=lambda name: self._taken[name], default=None)

    def took(self, name: str) -> None:
        """One more set has it."""
        self._taken[name] = self._taken.get(name, 0) + 1
