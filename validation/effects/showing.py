"""What an effect does to an image, or to the curve of a film: a result document that a view draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectSpec, Value, check, did_you_mean
from luxloop.errors import InputError
from luxloop.model import Model
from validation.effects.example_set import CAMERA, MODULE, MODULE_VIEW, PEAK_SHARE, film_curves
from validation.effects.known import Known, applied, nearly_off, typical, with_effect
from validation.effects.signatures import Sight
from validation.prediction import Predictor, Sensor, View

Real = NDArray[np.float64]

CHIPS = MODULE.rows * MODULE.columns


def values_of(spec: EffectSpec, given: list[str]) -> dict[str, Value]:
    """The typical values of an effect on the example module, with those given as PARAM=VALUE.

    Raises InputError for a parameter that there is not, or a value out of its range.
    """
    values = typical(spec, CHIPS)
    for text in given:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(
                "--value", text, "PARAM=VALUE, such as psf_um=12", "luxloop effects show tells the names"
            )
        if name not in values:
            raise InputError("--value", name, f"one of {', '.join(values)}", did_you_mean(name, values))
        values[name] = _number(value) if not isinstance(values.get(name), tuple) else (_number(value),) * CHIPS  # type: ignore[assignment]
    check(applied(spec, values), spec)
    return values


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def shown(
    predictor: Predictor, known: Known, model: Model, spec: EffectSpec, values: Mapping[str, Value]
) -> tuple[dict[str, Any], dict[str, Real]]:
    """A document and its arrays: the example module with and without the effect; of film effects curves of a film.

    Raises RemoteError for what a worker refuses.
    """
    film = {"dbr_pairs": MODULE.dbr_pairs, **MODULE.design.model_dump()}
    document: dict[str, Any] = {
        "effect": spec.name, "stage": spec.stage, "formula": spec.formula, "values": dict(values),
        "design": film, "array": [MODULE.rows, MODULE.columns], "model": model.name, "kind": "nothing",
    }  # fmt: skip
    effected = with_effect(model, applied(spec, values))
    without = with_effect(model, applied(spec, nearly_off(spec, values))) if spec.walks else model
    sight = Sight(predictor, [sensible(predictor, model)], film_curves(), known.beyond_twin)
    (before, *curves), (after, *bent) = (sight.parts(one, not spec.twin, None, model) for one in (without, effected))
    if not np.array_equal(before, after):
        return document | _image_facts(before, after), {"base": before, "with": after} | _axes(before.shape)
    pairs = dict(zip(("R", "T", "psi", "delta"), zip(curves, bent, strict=True), strict=True))
    if all(np.array_equal(*pair) for pair in pairs.values()):
        return document, {}
    arrays = {f"{name}/{which}": pair[n] for name, pair in pairs.items() for n, which in enumerate(("base", "with"))}
    return document | {"kind": "curve"}, arrays | {"wavelength_nm": np.asarray(film_curves()[0].wavelength_nm)}


def sensible(predictor: Predictor, model: Model) -> View:
    """The view of the example module, with a sensor whose brightest pixel is at a stated share of full scale."""
    (image,) = predictor.images(model, [MODULE_VIEW])
    full_dn = CAMERA.full_scale_dn - CAMERA.black_level_dn
    gain_dn = PEAK_SHARE * full_dn / float(image.irradiance_per_mm2.max())
    return replace(MODULE_VIEW, sensor=Sensor(gain_dn, 0.0, full_dn))


def _image_facts(before: Real, after: Real) -> dict[str, Any]:
    """How large a difference is, in percent of the base image's mean."""
    difference = 100.0 * (after - before) / before.mean()
    return {
        "kind": "image",
        "rms_percent": float(np.sqrt(np.mean(difference**2))),
        "largest_percent": float(np.abs(difference).max()),
        "mean_percent": float(difference.mean()),
    }


def _axes(shape: tuple[int, ...]) -> dict[str, Real]:
    pixel_um = MODULE_VIEW.pixel_um
    y_um, x_um = (
        np.asarray((np.arange(count) - middle) * pixel_um, np.float64)
        for count, middle in zip(shape, MODULE_VIEW.centre_px, strict=True)
    )
    return {"x_um": x_um, "y_um": y_um}
