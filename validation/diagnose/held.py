"""Numbers of films that the data set holds: whether another value would do what an effect is named for.

An effect on a film often looks like a thickness or an index that is a little off: an oxide of 1.5 nm below a polymer
of nearly its index is 1.5 nm more of the polymer. Where those are fitted, they are taken out of every effect; where
the data set holds them, that they are known is all that speaks for the effect, and this has to be said.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.units import unit_of
from validation.dataset.manifest import FilmSample
from validation.fit import Fit
from validation.fit.curves import curve_of
from validation.measured import MeasuredSpectrum
from validation.prediction import Predictor
from validation.prediction.spectra import CAUCHY, film_value

Real = NDArray[np.float64]

AS_MUCH = 0.8
"""Of the best effect's drop of chi2: what another value must bring to be told."""
LEAST_DROP = 25.0
"""Where no effect brings anything: five standard deviations."""
MOST = 3
"""Of a film with many layers each thickness may do."""
IMITATED = 0.01
"""Of a column, that what is fitted leaves of it: below, that number is as good as fitted."""


@dataclass(frozen=True)
class Held:
    """A number of a film that stays where the data set has it, and what it would come to if it were free."""

    path: str
    unit: str
    value: float
    would_be: float
    error: float
    chi2_drop: float
    """By its derivative where it is held."""

    @property
    def words(self) -> str:
        """As a sentence."""
        would = f"{self.would_be:.6g} +- {self.error:.2g} {self.unit}".rstrip()
        return (
            f"But {self.path} is held at {self.value:.6g}: {would} would lower chi2 by {self.chi2_drop:.0f} as well."
            " Free it in the data set, unless it is known from elsewhere."
        )

    def document(self) -> dict[str, Any]:
        """As plain values."""
        return asdict(self) | {"words": self.words}


def held_alike(fit: Fit, predictor: Predictor, best_drop: float) -> list[Held]:
    """The few numbers of films that would lower chi2 about as much as the best effect, the most first."""
    least = max(AS_MUCH * best_drop, LEAST_DROP)
    alike = [one for one in _held(fit, predictor) if one.chi2_drop > least]
    return sorted(alike, key=lambda one: -one.chi2_drop)[:MOST]


def _held(fit: Fit, predictor: Predictor) -> Iterator[Held]:
    values = fit.problem.unknowns.named(fit.values)
    for path, (value, column) in _columns(fit, predictor, values).items():
        (left,) = fit.basis.left(column[None])
        square = float(left @ left)
        if square > IMITATED**2 * float(column @ column):
            along = float(left @ fit.residual_with_priors)
            yield Held(path, unit_of(path), value, value + along / square, square**-0.5, along**2 / square)


def _columns(fit: Fit, predictor: Predictor, values: Mapping[str, float]) -> dict[str, tuple[float, Real]]:
    """Value and whitened derivative (row,) by path, of what the fit does not move."""
    sigmas = fit.whitening.curve_sigma
    ends = fit.whitening.count + np.cumsum([len(one.value) for one in fit.problem.curves])
    seen = [
        (curve_of(one.source, values), sigma, end)
        for one, sigma, end in zip(fit.problem.curves, sigmas, ends, strict=True)
        if isinstance(one.source, MeasuredSpectrum)
    ]
    films = {curve.film.id: curve.film for curve, *_ in seen}
    at = {path: film_value(film, path) for film in films.values() for path in _paths(film) if path not in values}
    columns = {path: np.zeros(len(fit.residual)) for path in at}
    if not at:
        return {}
    found = predictor.spectra(fit.model, [curve for curve, *_ in seen], list(at))
    for (_, sigma, end), predicted in zip(seen, found, strict=True):
        for path, derivative in predicted.jacobian.items():
            columns[path][end - len(sigma) : end] = derivative / sigma
    return {path: (at[path], column) for path, column in columns.items()}


def _paths(film: FilmSample) -> Iterator[str]:
    for number, layer in enumerate(film.layers):
        names = ("thickness_nm", *(CAUCHY if layer.cauchy is not None else ())) if layer.coherent else ()
        yield from (f"films.{film.id}.layers.{number}.{name}" for name in names)
