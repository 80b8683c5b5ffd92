"""Spectra and ellipsometric curves of films, asked of the thin-film worker."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from luxloop.errors import InputError
from luxloop.film import MAX_PLACES, MAX_VALUES, FilmMeasurementRequest
from luxloop.stack import Layer, Medium, Stack
from luxloop.words import parse, sha256_of
from validation.dataset.manifest import FilmLayer, FilmSample
from validation.prediction.differences import moved_models, stencil, step_of
from validation.prediction.words import Curve, PredictedCurve, Real

if TYPE_CHECKING:
    from luxloop.client import Answer
    from luxloop.model import Model

Ask = Callable[[Sequence[FilmMeasurementRequest]], "list[Answer]"]

CAUCHY = ("a", "b_um2")
THICKNESS_SHARE = 1e-5
"""Of a thickness, where that is more than its step of 0.01 nm: a thick layer is known to nothing better."""
EFFECT_SHARE = 0.0005
"""Of the range of an effect's parameter: curves have no noise, and what is small bends within a part of its range (of
a spread of 0.002, a step as long, 2 % of its range, told errors 27 % too large)."""


def stack_of(film: FilmSample) -> Stack:
    """A film as the hall has it, from the bulk behind it towards the light; a manifest begins with the light."""
    layers = tuple(
        Layer(medium=_medium(layer), thickness_nm=layer.thickness_nm, coherent=layer.coherent)
        for layer in reversed(film.layers)
    )
    return Stack(inside=_named(film.exit), layers=layers, outside=_named(film.incident))


def predict(model: Model, curves: Sequence[Curve], paths: tuple[str, ...], ask: Ask) -> list[PredictedCurve]:
    """The curves, in their order; by a path of another film than the curve's it has derivative 0.

    `paths` : of films, and of effects of the model.
    """
    known = [f"films.{curve.film.id}.layers." for curve in curves]
    for path in paths:
        if not any(path.startswith(prefix) for prefix in (*known, "effects.")):
            raise InputError(
                "path", path, f"a path below {', '.join(sorted(set(known)))}", "name a film of the curves"
            )
    moved = [list(_moved(model, curve, paths)) for curve in curves]
    wanted = [
        one for curve, some in zip(curves, moved, strict=True) for one in [(model, curve), *(m[2:] for m in some)]
    ]
    values = iter(_values(wanted, ask))
    found = []
    for curve, some in zip(curves, moved, strict=True):
        value = next(values)
        columns = {path: np.zeros(value.size) for path in paths}
        for path, weight, *_ in some:  # weights sum up to 0, so differences to the value may be taken
            columns[path] += weight * _near(next(values) - value, curve.quantity)
        found.append(PredictedCurve(value, columns))
    return found


def film_value(film: FilmSample, path: str) -> float:
    """The value at "films.ID.layers.N.NAME" of a film. Raises InputError where there is none."""
    number, name = _place(film, path)
    layer = film.layers[number]
    if name == "thickness_nm":
        return layer.thickness_nm
    if name in CAUCHY and layer.cauchy is not None:
        return layer.cauchy[CAUCHY.index(name)]
    raise InputError("path", path, "thickness_nm, or a, b_um2 of a cauchy layer", "luxloop dataset show lists them")


def with_film_value(film: FilmSample, path: str, value: float) -> FilmSample:
    """The film with another value at that path; a fit's limits are no limits here. InputError out of its range."""
    film_value(film, path)
    number, name = _place(film, path)
    layer = film.layers[number]
    changes: dict[str, Any] = {"thickness_nm": value}
    if name in CAUCHY and layer.cauchy is not None:
        changes = {"cauchy": (value, layer.cauchy[1]) if name == "a" else (layer.cauchy[0], value)}
    moved = parse(FilmLayer, layer.model_dump(exclude={"free"}) | changes, path)
    layers = (*film.layers[:number], moved.model_copy(update={"free": layer.free}), *film.layers[number + 1 :])
    return film.model_copy(update={"layers": layers})


def _place(film: FilmSample, path: str) -> tuple[int, str]:
    """Number of the layer and name of the value that a path of a film leads to."""
    found = re.fullmatch(r"layers\.(\d+)\.(\w+)", path.removeprefix(f"films.{film.id}."))
    if found is None or int(found[1]) >= len(film.layers):
        allowed = f"films.{film.id}.layers.N.NAME, N from 0 to {len(film.layers) - 1}, the incident side first"
        raise InputError("path", path, allowed, "NAME is thickness_nm, a or b_um2")
    return int(found[1]), found[2]


def _moved(model: Model, curve: Curve, paths: Sequence[str]) -> Iterator[tuple[str, float, Model, Curve]]:
    """Model and curve moved along each path of an effect, and of the curve's film, with the path and the weight."""
    for path in paths:
        if path.startswith("effects."):
            for weight, other in moved_models(model, path, EFFECT_SHARE):
                yield path, weight, other, curve
        elif path.startswith(f"films.{curve.film.id}.layers."):
            value, film = film_value(curve.film, path), curve.film
            step = step_of(path, 0.0)
            step = max(step, THICKNESS_SHARE * value) if path.endswith("thickness_nm") else step
            for weight, moved in stencil(partial(_along, film, path, value), step, path):
                yield path, weight, model, replace(curve, film=moved)


def _along(film: FilmSample, path: str, value: float, by: float) -> FilmSample:
    return with_film_value(film, path, value + by)


def _values(wanted: Sequence[tuple[Model, Curve]], ask: Ask) -> list[Real]:
    """The values of the rows of each curve; curves that differ in their angles alone are asked for together."""
    parts = []
    together: dict[str, FilmMeasurementRequest] = {}
    for number, (model, curve) in enumerate(wanted):
        for rows, same, request in _parts(curve, model):
            key, held = same, together.get(same, request)
            angles = tuple(sorted({*held.aoi_deg, *request.aoi_deg}))
            if len(angles) > MAX_PLACES or len(angles) * len(held.wavelength_nm) > MAX_VALUES:
                key, held, angles = f"{same} {number}", request, request.aoi_deg  # more than one request takes
            together[key] = held if angles == held.aoi_deg else held.model_copy(update={"aoi_deg": angles})
            parts.append((number, rows, key))
    answers = dict(zip(together, ask(list(together.values())), strict=True))
    values = [np.zeros(len(curve.wavelength_nm)) for _, curve in wanted]
    for number, rows, key in parts:
        curve, grid = wanted[number][1], np.asarray(answers[key].arrays["value"], np.float64)
        wave = np.searchsorted(together[key].wavelength_nm, curve.wavelength_nm[rows])
        values[number][rows] = grid[wave, np.searchsorted(together[key].aoi_deg, curve.aoi_deg[rows])]
    return values


def _parts(curve: Curve, model: Model) -> Iterator[tuple[NDArray[np.intp], str, FilmMeasurementRequest]]:
    """For each polarisation of a curve its rows' numbers, the hash of all but their angles, and the request."""
    polarisation = np.array([one or "u" for one in curve.polarisation])
    for one in np.unique(polarisation):
        rows = np.flatnonzero(polarisation == one)
        words = {
            "stack": stack_of(curve.film),
            "effects": model.effects,
            "quantity": curve.quantity,
            "wavelength_nm": tuple(np.unique(curve.wavelength_nm[rows]).tolist()),
            "aoi_deg": tuple(np.unique(curve.aoi_deg[rows]).tolist()),
            "polarisation": str(one),
            "bandwidth_nm": curve.bandwidth_nm,
        }
        request = parse(FilmMeasurementRequest, words, curve.film.id)
        yield rows, sha256_of(request.model_dump(mode="json", exclude={"aoi_deg"})), request


def _near(difference: Real, quantity: str) -> Real:
    """A difference of values; of delta the one within 180 deg."""
    return (difference + 180.0) % 360.0 - 180.0 if quantity == "delta" else difference


def _medium(layer: FilmLayer) -> Medium:
    if layer.cauchy is not None:
        return Medium(cauchy=layer.cauchy)
    if layer.fixed is not None:
        return Medium(n=layer.fixed[0], k=layer.fixed[1])
    return _named(layer.material or "air")


def _named(material: str) -> Medium:
    """A material of the workers' tables; air is n = 1, as around chips."""
    return Medium(n=1.0) if material == "air" else Medium(material=material)
