"""Spectra, ellipsometric curves and far fields in the words of a fit, and who predicts them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from luxloop.model import Model
from validation.fit.least_squares import Parameter
from validation.fit.parameters import CurveData
from validation.measured import MeasuredFarField, MeasuredSpectrum
from validation.prediction import Curve, FarView, PredictedCurve
from validation.prediction.spectra import film_value, with_film_value


class Predictor(Protocol):
    """Asks the workers (`validation.prediction.Predictor`)."""

    def spectra(self, model: Model, curves: Sequence[Curve], paths: Sequence[str] = ()) -> list[PredictedCurve]:
        """The spectra of films, with derivatives by paths of films and of effects."""

    def far_fields(self, model: Model, views: Sequence[FarView], paths: Sequence[str] = ()) -> list[PredictedCurve]:
        """The far fields of samples, with derivatives by paths of the model."""


class CurvesOf:
    """Predicts the curves of a data set, films as their parameters stand; one question for each kind of curve."""

    def __init__(self, predictor: Predictor) -> None:
        self._predictor = predictor

    def __call__(
        self, model: Model, curves: Sequence[CurveData], paths: Sequence[str], others: Mapping[str, float]
    ) -> list[PredictedCurve]:
        """The curves in their order; `others` are values of films by path."""
        found: dict[int, PredictedCurve] = {}
        spectra = {n: one.source for n, one in enumerate(curves) if isinstance(one.source, MeasuredSpectrum)}
        if spectra:
            asked = [curve_of(one, others) for one in spectra.values()]
            of_films = (*others, *(path for path in paths if path.startswith("effects.")))
            found |= dict(zip(spectra, self._predictor.spectra(model, asked, of_films), strict=True))
        far = {n: one.source for n, one in enumerate(curves) if isinstance(one.source, MeasuredFarField)}
        if far:
            views = [FarView(one.sample, one.table.theta_deg, one.table.phi_deg) for one in far.values()]
            found |= dict(zip(far, self._predictor.far_fields(model, views, tuple(paths)), strict=True))
        return [found[number] for number in range(len(curves))]


def curves_of(spectra: Sequence[MeasuredSpectrum], far_fields: Sequence[MeasuredFarField]) -> list[CurveData]:
    """Measured curves as a fit takes them."""
    return [_of_spectrum(one) for one in spectra] + [_of_far_field(one) for one in far_fields]


def film_parameters(spectra: Sequence[MeasuredSpectrum]) -> tuple[list[Parameter], dict[str, float]]:
    """The parameters of films that their manifest frees, with their limits; and the values to start from."""
    parameters, start = [], {}
    for film in {one.film.id: one.film for one in spectra}.values():
        for number, layer in enumerate(film.layers):
            for name, (lower, upper) in layer.free.items():
                path = f"films.{film.id}.layers.{number}.{name}"
                parameters.append(Parameter(path, lower, upper))
                start[path] = film_value(film, path)
    return parameters, start


def _of_spectrum(one: MeasuredSpectrum) -> CurveData:
    table, angle = one.table, one.shot.quantity in ("psi", "delta")
    return CurveData(one.shot.id, table.value, table.sigma, angle, False, table.wavelength_nm, "nm", one)


def _of_far_field(one: MeasuredFarField) -> CurveData:
    table = one.table
    return CurveData(one.shot.id, table.value, table.sigma, False, True, table.theta_deg, "deg", one)


def curve_of(one: MeasuredSpectrum, values: Mapping[str, float]) -> Curve:
    """The question about a spectrum with its film's parameters at these values, by path."""
    film, table = one.film, one.table
    for path, value in values.items():
        if path.startswith(f"films.{film.id}.layers."):
            film = with_film_value(film, path, value)
    return Curve(
        film, one.shot.quantity, table.wavelength_nm, table.aoi_deg, table.polarisation, one.shot.bandwidth_nm
    )
