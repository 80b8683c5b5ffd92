"""Stored exits of one chip made to stand for those of a slightly other one: a factor on each exit's weight.

Whether a ray is reflected at the chip's bottom or top is drawn as often as it happens, so what another chip would
have done more or less often is a ratio of probabilities; absorption dims a ray along its path, a ratio of weights:

    (rho' / rho)^bottom hits  x  exp(-(a' - a) path - (b' - b) lift)  x  prod R'(u_i) / R(u_i)
                              x  T'(u) / T(u) if it left by the top

a is the mean absorption, b what is more of it at the top, lift the integral of 2 z / T - 1 along the path; the
product is over reflections at the top. Of those inside the escape cone the walk notes the number and the first four
cosines; of those beyond the critical angle, where a film that absorbs does not reflect all, how many there were in
each of eight steps of the cosine.
Nothing is lost or made on average, at any change; but the larger the change, the fewer exits carry the light.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import Bsdf, GaussianLobe, Lambertian, Mirror, Mixture, SpecularTable
from containers.bsdf.specular import Specular
from containers.ray_tracing.arrays import BEYOND, BOTTOM_HITS, DX, DY, LIFT, PATH, TOP_COSINES, TOP_HITS, TRACE, Z
from containers.ray_tracing.exits import Exits, chip_key
from containers.ray_tracing.kernel import WAVE_OF_EXIT, WEIGHT_OF_EXIT
from containers.ray_tracing.twin.direct import without_loss
from containers.scene import Scene
from luxloop.errors import InputError

Real = NDArray[np.float64]

NOTED = BEYOND - TOP_COSINES
"""Cosines at the top that are noted."""
STEPS, WITHIN = TRACE - BEYOND, 16
"""Of the cosine beyond the critical angle, and places within each that its mean is taken over."""


class OtherChipError(InputError):
    """The two chips differ in what the exits do not note."""


@dataclass(frozen=True)
class Reweighted:
    """Exits with the weights of another chip, and how good they are."""

    exits: Exits
    inexact_share: float
    """Share of the light whose weight is not exact: rays with over four reflections at a changed top."""
    effective_share: float
    """Effective number of exits over their number, (sum w)^2 / sum w^2 after over before: 1 for no change."""


def reweighted(exits: Exits, stored: Scene, wanted: Scene) -> Reweighted:
    """The exits of the chip of `stored` with the weights they have for the chip of `wanted`.

    Parameters
    ----------
    exits : made with `notes`; weights they already have are kept as factors.

    Raises
    ------
    InputError : exits without notes.
    OtherChipError : chips that differ in more than the bottom's reflectance, the absorption and the
        top face, or do so in a way that was not noted (the substrate below an air gap, light where there was none).

    Notes
    -----
    Of reflections at the top inside the escape cone beyond the fourth, each counts as the mean (of logarithms) of
    those that are noted; of those beyond the critical angle each as the mean of its step, also where fringes of the
    film are finer.
    """
    if exits.notes.shape != (len(exits.rays), TRACE):
        raise InputError("exits", "without notes", "exits with notes", "make them with notes=True")
    factor = _bottom_factor(exits, stored, wanted)
    factor *= _dimmed(exits, stored, wanted)
    several = np.zeros(len(factor), bool)
    if not _same_face(stored.chip.top.inside, wanted.chip.top.inside):
        factor *= _top_factor(exits, stored, wanted)
        several = exits.notes[:, TOP_HITS] > NOTED
    before = exits.rays[:, WEIGHT_OF_EXIT].astype(float) * (1.0 if exits.weights is None else exits.weights)
    after = before * factor
    weights = (factor if exits.weights is None else factor * exits.weights).astype(np.float32)
    return Reweighted(
        replace(exits, weights=weights),
        float(after[several].sum() / after.sum()),
        _effective(after) / _effective(before),
    )


def _bottom_factor(exits: Exits, stored: Scene, wanted: Scene) -> Real:
    _refuse_other_chip(stored, wanted)
    (_, kept), (_, now) = (without_loss(_bottom(scene)) for scene in (stored, wanted))
    return (
        np.asarray((now / kept) ** exits.notes[:, BOTTOM_HITS].astype(float))
        if now != kept
        else np.ones(len(exits.rays))
    )


def _dimmed(exits: Exits, stored: Scene, wanted: Scene) -> Real:
    """What another absorption, or another rise of it, leaves of each exit."""
    before, after = stored.chip, wanted.chip
    path_um, lift_um = (exits.notes[:, one].astype(float) for one in (PATH, LIFT))
    depth = (after.absorption_per_um - before.absorption_per_um) * path_um
    if after.absorption_rise_per_um != before.absorption_rise_per_um:
        depth += (after.absorption_rise_per_um - before.absorption_rise_per_um) * lift_um
    return np.asarray(np.exp(-depth))


def _bottom(scene: Scene) -> Bsdf:
    return scene.chip.mirror if scene.chip.mirror is not None else scene.substrate


def _refuse_other_chip(stored: Scene, wanted: Scene) -> None:
    """OtherChipError where the two differ in what the exits do not note."""
    mend = "make the exits of this chip"
    (bare, kept), (other, now) = map(without_what_is_noted, (stored, wanted))
    if kept == 0.0 and now > 0.0:
        raise OtherChipError("bottom reflectance", now, "0, as it was: no exit tells what it would send back", mend)
    if stored.chip.bottom == "air_gap" and kept != now:
        raise OtherChipError("substrate", now, f"reflectance {kept:g}: hits in the gap are not noted", mend)
    if chip_key(bare) != chip_key(other):
        raise OtherChipError("chip", "another", "alike but for bottom reflectance, absorption and top", mend)


def without_what_is_noted(scene: Scene) -> tuple[Scene, float]:
    """The scene with a bare, clear chip on a bottom without loss, and the bottom's reflectance."""
    bottom, kept = without_loss(_bottom(scene))
    own = scene.chip.mirror is not None
    clear = replace(scene.chip, absorption_per_um=0.0, absorption_rise_per_um=0.0)
    chip = replace(clear, top=scene.chip.sides, mirror=bottom if own else None)
    return replace(scene, chip=chip, substrate=Lambertian(1.0) if own else bottom), kept


def lender_of(wanted: Scene, stored: Scene) -> Scene:
    """The wanted chip with all that exits note as the stored one has it: its exits can be reweighted for the wanted.

    So a chip that differs in something else (where or whereto light is born, how its sides reflect) has walks that do
    not depend on absorption, top and the bottom's reflectance, and no noise of their own when those move.
    """
    noted = {name: getattr(stored.chip, name) for name in ("absorption_per_um", "absorption_rise_per_um")}
    chip = replace(wanted.chip, **noted)
    if np.array_equal(wanted.chip.index, stored.chip.index):
        chip = replace(chip, top=stored.chip.top)
    bottom, own = without_loss(_bottom(wanted))
    _, kept = without_loss(_bottom(stored))
    alike = own == kept or wanted.chip.bottom == "air_gap" or bottom is _bottom(wanted)
    lent = _bottom(wanted) if alike else _reflecting(bottom, kept)
    if chip.mirror is not None:  # no light of the chip comes to the substrate
        return replace(wanted, chip=replace(chip, mirror=lent), substrate=stored.substrate)
    return replace(wanted, chip=chip, substrate=lent)


def keeping_all(scene: Scene) -> Scene:
    """The scene with a top that takes nothing beyond the critical angle.

    Its exits can be reweighted for one that does. The other way round those that are left would be from where it
    takes least, which the step of their cosine does not tell: 8 % of what a film with k = 0.01 changes.
    """
    top = scene.chip.top
    inside = tuple(_keeping(face, n) for face, n in zip(top.inside, scene.chip.index, strict=True))
    if all(one is other for one, other in zip(inside, top.inside, strict=True)):
        return scene
    return replace(scene, chip=replace(scene.chip, top=replace(top, inside=inside)))


def _keeping(face: Bsdf, n: float) -> Bsdf:
    if not isinstance(face, SpecularTable):
        return face
    beyond = np.sin(face.theta_in_rad) * n >= 1.0
    return face if np.all(face.R[beyond] == 1.0) else replace(face, R=np.where(beyond, 1.0, face.R))


def _reflecting(bottom: Bsdf, reflectance: float) -> Bsdf:
    """A surface without loss (`without_loss`) that reflects so much."""
    if isinstance(bottom, Mixture):
        return replace(bottom, parts=tuple(_reflecting(part, reflectance) for part in bottom.parts))
    return (
        replace(bottom, reflectance=reflectance) if isinstance(bottom, Lambertian | GaussianLobe | Mirror) else bottom
    )


def _same_face(one: tuple[Bsdf, ...], other: tuple[Bsdf, ...]) -> bool:
    theta = np.linspace(0.0, np.pi / 2, 257)
    return one is other or all(
        isinstance(a, Specular)
        and isinstance(b, Specular)
        and np.array_equal(np.stack(a.deltas(theta)), np.stack(b.deltas(theta)))
        for a, b in zip(one, other, strict=True)
    )


def _top_factor(exits: Exits, stored: Scene, wanted: Scene) -> Real:
    """Ratios of the reflections and transmissions at the two tops, multiplied."""
    factor = np.ones(len(exits.rays))
    waves = exits.rays[:, WAVE_OF_EXIT].astype(int)
    for wave, n in enumerate(stored.chip.index):
        own = np.flatnonzero(waves == wave)
        before, after = stored.chip.top.inside[wave], wanted.chip.top.inside[wave]
        if not (isinstance(before, Specular) and isinstance(after, Specular)):
            raise OtherChipError("top", "another, which scatters", "one that does not", "make the exits of this chip")
        factor[own] *= np.exp(exits.notes[own, BEYOND:TRACE].astype(float) @ _beyond(before, after, n))
        hits = exits.notes[own, TOP_HITS]
        noted = np.arange(NOTED) < hits[:, None]
        rays, places = np.nonzero(noted)
        ratio = _ratio(before, after, exits.notes[own][rays, TOP_COSINES + places].astype(float), "mirror")
        log = np.bincount(rays, np.log(np.maximum(ratio, 1e-300)), minlength=own.size)
        factor[own] *= np.exp(log * np.maximum(1.0, hits / NOTED))
        through = own[exits.rays[own, Z] >= np.float32(stored.chip.thickness_um)]
        u2 = exits.rays[through, DX].astype(float) ** 2 + exits.rays[through, DY].astype(float) ** 2
        factor[through] *= _ratio(before, after, np.sqrt(1.0 - u2 / n**2), "refracted")
    return factor


def _beyond(before: Bsdf, after: Bsdf, n: float) -> Real:
    """(step,), logarithms of the ratio of reflectances beyond the critical angle, in steps of the cosine."""
    cosine = (np.arange(STEPS * WITHIN) + 0.5) / (STEPS * WITHIN) * np.sqrt(1.0 - 1.0 / n**2)
    kept, now = (
        face.deltas(np.arccos(cosine)).mirror.reshape(STEPS, WITHIN).mean(axis=1) for face in (before, after)
    )
    return np.asarray(np.log(np.maximum(now, 1e-300) / np.maximum(kept, 1e-300)))


def _ratio(before: Bsdf, after: Bsdf, cosine: Real, part: str) -> Real:
    theta = np.arccos(np.minimum(cosine, 1.0))
    power, now = (getattr(face.deltas(theta), part) for face in (before, after))
    return np.asarray(np.divide(now, power, out=np.ones_like(power), where=power > 0.0))


def _effective(weight: Real) -> float:
    total = float(np.sum(weight * weight))
    return float(np.sum(weight)) ** 2 / total if total > 0.0 else 0.0
