"""Derivatives by what no worker differentiates: which moved models are asked for, and with which weights."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from luxloop.errors import InputError
from validation.sample_values import LEAD, limits_of, numbers, with_number

if TYPE_CHECKING:
    from luxloop.model import Model

T = TypeVar("T")

STEPS = {
    "active_layer_depth": 0.2, "n_gan": 0.03, "n_aln": 0.03, "gan_layer_nm": 2.0, "aln_layer_nm": 2.0,
    "peak_nm": 3.0, "fwhm_nm": 3.0, "thickness_nm": 0.01, "a": 1e-4, "b_um2": 1e-5,
    "effects.film_missing_layer.thickness_nm": 0.01, "effects.film_interlayer.thickness_nm": 0.01,
}  # fmt: skip
"""By the last part of a path, of an effect's by the whole of it, in its own unit. Those of chips are large: what
emits elsewhere in the chip is walked anew, and shorter steps leave more noise than longer ones bend (of the
derivative by a layer at 0.99 T, 1.3 to 1.8 at 0.02, 0.6 to 0.8 here, both from 65,536 histories)."""
SHARE = 0.02
"""Of a value, or of the range of its fit, where no step is stated."""


class Moved(NamedTuple, Generic[T]):
    """Something moved along a parameter, and its weight in the derivative by it."""

    weight: float
    what: T


def moved_models(model: Model, path: str, share: float = SHARE) -> list[Moved[Model]]:
    """Models whose images, times their weights, sum up to the derivative by the parameter at a path.

    `share` : of its fit's range, or of its value, that a step is long.

    Raises
    ------
    InputError : a path that is not in the model, or no number that can move.
    """
    value = numbers(model).get(path)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError("path", path, "the path of a number in the model", "luxloop model show lists them")
    fit = limits_of(model, path)
    step = share * (fit.upper - fit.lower) if fit is not None else share * abs(value)
    return stencil(lambda by: with_number(model, path, value + by), step_of(path, step), path)


def step_of(path: str, otherwise: float) -> float:
    """The stated step of a parameter, or another one; what an effect's number is called says nothing of it."""
    return STEPS.get(path if path.startswith(("effects.", LEAD)) else path.rpartition(".")[2], otherwise)


def stencil(moved: Callable[[float], T], step: float, name: str) -> list[Moved[T]]:
    """Central differences; at an end of the range one-sided ones of the same order.

    Parameters
    ----------
    moved : raises InputError where an amount leads out of the range.

    Raises
    ------
    InputError : there is no room for two steps on either side.
    """
    if not step > 0.0:
        raise InputError(name, step, "a step above 0", "its step is a share of it: start from a small value, not 0")
    for places in ((1.0, -1.0), (0.0, 1.0, 2.0), (0.0, -1.0, -2.0)):
        try:
            found = [moved(place * step) for place in places]
        except InputError:
            continue
        weights = (0.5, -0.5) if len(places) == 2 else (-1.5, 2.0, -0.5)
        sign = -1.0 if places[-1] == -2.0 else 1.0
        return [Moved(sign * weight / step, what) for weight, what in zip(weights, found, strict=True)]
    raise InputError(name, step, "room for two steps on one side", "widen the limits of its fit")
