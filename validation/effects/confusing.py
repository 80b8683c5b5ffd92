"""Which effects the data can tell apart: cosines between all of them, in groups, on images and on curves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectSpec
from luxloop.errors import InputError, RemoteError
from luxloop.model import Model
from validation.effects.confounding import ALIKE, confounding
from validation.effects.example_set import example_images, film_curves, film_projection
from validation.effects.known import Known, acting, applied, far_end, typical, with_effect
from validation.effects.signatures import (
    HISTORIES,
    Column,
    Projection,
    Sight,
    projected,
    signature,
)
from validation.fit.curves import curve_of
from validation.fit.problem import view_of
from validation.measured import MeasuredImage, MeasuredSpectrum
from validation.observed import Observed
from validation.prediction import Pose, Predictor, Sensor

Real = NDArray[np.float64]
Said = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Ground:
    """What effects are seen on, and what may imitate them there."""

    name: str
    sight: Sight
    projection: Projection

    def columns(self, model: Model, spec: EffectSpec) -> list[Column]:
        """The signature of an effect on it; none where it changes nothing here."""
        chips = max((one.sample.rows * one.sample.columns for one in self.sight.views), default=0)
        if any(one.per_chip for one in spec.parameters) and not chips:
            return []
        moved = with_effect(model, applied(spec, typical(spec, chips)))
        unchanged = all(
            np.array_equal(base, there)
            for some in self._looked_at
            for base, there in zip(
                *(self.sight.parts(one, not spec.twin, some, model) for one in (model, moved)), strict=True
            )
        )
        return [] if unchanged else signature(self.sight, model, spec)

    @property
    def _looked_at(self) -> list[list[int] | None]:
        """Views one by one, those of many chips and many pairs first, where most effects show; curves at once."""
        samples = [one.sample for one in self.sight.views]
        shown = [(one.rows * one.columns, one.dbr_pairs) for one in samples]
        return [[number] for number in sorted(range(len(samples)), key=lambda n: shown[n], reverse=True)] or [None]


def image_ground(
    model: Model,
    predictor: Predictor,
    known: Known,
    images: Sequence[MeasuredImage] | None = None,
    histories: int = HISTORIES,
) -> Ground:
    """Images: those measured, or six examples. Each is seen by the sensor that it was, or would be, taken with."""
    seen = list(images) if images is not None else example_images(model, predictor)
    projection = Projection.at(model, seen, predictor)
    views = [
        replace(view_of(one, Pose()), sensor=Sensor(gain, 0.0, one.camera.full_scale_dn - one.camera.black_level_dn))
        for one, gain in zip(seen, projection.gains, strict=True)
    ]
    name = "six example images" if images is None else f"{len(seen)} images"
    return Ground(name, Sight(predictor, views, (), known.beyond_twin, histories), projection)


def curve_ground(model: Model, predictor: Predictor) -> Ground:
    """Curves of the example film, its thickness and index free."""
    return Ground("the example film", Sight(predictor, (), film_curves()), film_projection(model, predictor))


def spectra_ground(model: Model, predictor: Predictor, observed: Observed) -> Ground:
    """The spectra that were measured, their films as the data set describes them; what it frees of them may move."""
    measured = [one.source for one in observed.curves if isinstance(one.source, MeasuredSpectrum)]
    curves = [curve_of(one, observed.films_at) for one in measured]
    errors = [one.table.sigma for one in measured]
    projection = Projection.of_curves(model, curves, errors, list(observed.films_at), predictor)
    return Ground(f"{len(curves)} spectra", Sight(predictor, (), curves), projection)


def grounds(model: Model, predictor: Predictor, known: Known, observed: Observed | None = None) -> Iterator[Ground]:
    """What effects are told apart by: the images and the spectra of a data set, else six examples and a film.

    Raises InputError for a data set that has neither.
    """
    if observed is None:
        yield image_ground(model, predictor, known)
        yield curve_ground(model, predictor)
        return
    spectra = [one for one in observed.curves if not one.free_scale]
    if not observed.images and not spectra:
        raise InputError(
            "DATASET", ", ".join(observed.shots) or None, "images or spectra", "far fields are scored by diagnose"
        )
    if observed.images:
        yield image_ground(model, predictor, known, observed.images)
    if spectra:
        yield spectra_ground(model, predictor, observed)


@dataclass(frozen=True, eq=False)
class Confusion:
    """The cosines of effects on one ground."""

    ground: str
    names: tuple[str, ...]
    """In the order of their groups."""
    cosine: Real
    sigma: Mapping[str, float]
    """How far each stands out of the noise at a third of its range, after projection."""
    imitated: tuple[str, ...]
    """Effects of which calibration and nuisances imitate everything."""
    groups: tuple[tuple[str, ...], ...]
    failed: Mapping[str, str]
    """Effects that a worker refuses on this ground, and why."""

    def document(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "ground": self.ground, "names": list(self.names), "cosines": np.round(self.cosine, 4).tolist(),
            "sigma": dict(self.sigma), "imitated": list(self.imitated), "alike": ALIKE,
            "groups": [list(group) for group in self.groups], "failed": dict(self.failed),
        }  # fmt: skip


def confusion(ground: Ground, model: Model, specs: Sequence[EffectSpec], say: Said = lambda _: None) -> Confusion:
    """All effects that change something on a ground, against each other. `say` hears which one is looked at."""
    rows: dict[str, Real] = {}
    sigma: dict[str, float] = {}
    failed: dict[str, str] = {}
    for number, spec in enumerate(specs):
        say(f"{spec.name}, {number + 1} of {len(specs)}")
        try:
            columns = ground.columns(model, spec)
        except RemoteError as error:
            failed[spec.name] = str(error)
            continue
        if columns:
            rows[spec.name] = projected(columns, ground.projection)
            sigma[spec.name] = sigma_of(spec, columns, rows[spec.name])
    imitated = tuple(name for name, one in rows.items() if not one.any())
    left = {name: one for name, one in rows.items() if name not in imitated}
    found = confounding(left)
    order = found.order
    return Confusion(
        ground.name, tuple(found.names[n] for n in order), np.abs(found.cosines[np.ix_(order, order)]), sigma,
        imitated, found.groups, failed,
    )  # fmt: skip


def sigma_of(spec: EffectSpec, columns: Sequence[Column], rows: Real) -> float:
    """The length of the longest projected column at a third of its parameter's range, in standard deviations."""
    sizes = {one.name: abs(far_end(one) - float(one.off or 0.0)) / 3.0 for one in acting(spec)}
    squares = {one.name for one in acting(spec) if one.score_variable == "square"}
    moves = [sizes[one.parameter] ** (2 if one.parameter in squares else 1) for one in columns]
    return float(np.max(np.linalg.norm(rows, axis=1) * moves))
