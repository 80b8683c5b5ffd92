"""Numbers handed to the physics from Python: as arrays of floats, or an `InputError` that names what is wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxloop.errors import InputError

Real = NDArray[np.float64]
NANOMETRES = (1e-3, 1e9)
"""Vacuum wavelengths from hard X-rays to a metre: what is outside was meant in another unit."""


def reals(field: str, value: ArrayLike, mend: str = "") -> Real:
    """`value` as floats in its own shape; InputError for words, and for complex numbers that are not real."""
    try:
        array = np.asarray(value)
        if np.iscomplexobj(array) and not array.imag.any():
            array = array.real
        if array.dtype.kind not in "biuf":
            raise TypeError
        return np.asarray(array, float)
    except (TypeError, ValueError) as error:  # ValueError: rows of different lengths
        raise InputError(field, value, "real numbers", mend or "give one number or an array of numbers") from error


def within(
    field: str, value: ArrayLike, least: float, most: float, mend: str, *, below: bool = False, above: bool = False
) -> Real:
    """The same, all from `least` to `most`; with `below` the end itself is excluded, with `above` the beginning.

    Raises InputError with the first number that is not, nan included.
    """
    array = reals(field, value, mend)
    good = (array > least if above else array >= least) & (array < most if below else array <= most)
    if not good.all():
        allowed = f"{'above ' if above else ''}{least:g} to {'below ' if below else ''}{most:g}"
        raise InputError(field, float(array[~good].flat[0]), allowed, mend)
    return array


def wavelengths_nm(value: ArrayLike) -> Real:
    """Vacuum wavelengths as (wavelength,); InputError for none, for more dimensions, and outside `NANOMETRES`."""
    array = np.atleast_1d(within("wavelength_nm", value, *NANOMETRES, "the vacuum wavelength in nm"))
    if array.ndim != 1 or not array.size:
        raise InputError("wavelength_nm", array.shape, "one number or a list of numbers", "the wavelengths in nm")
    return array
