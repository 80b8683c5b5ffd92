"""Spectra and far fields for a data set made from a model: expected values of the workers, noise of a stated size.

    films, quantities  --thin-film worker--> R, T, psi, delta against wavelength and angle --normal noise, seed--> CSV
    samples            --Monte Carlo-->      intensity against theta and phi, peak 1       --normal noise, seed--> CSV

The truth's far field has histories of its own, other ones than a comparison with the same seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from luxloop.errors import InputError
from luxloop.film import MAX_PLACES
from validation.dataset.images import Real
from validation.dataset.manifest import FarFieldShot, FilmSample, Sample, SpectrumShot
from validation.dataset.spectra import FAR_FIELD_COLUMNS, SPECTRUM_COLUMNS, Quantity

if TYPE_CHECKING:
    from luxloop.model import Model
    from validation.prediction.words import Asks

CURVES, FAR_FIELDS = 3, 4
"""What a seed is drawn for, beside those of `validation.noise` and of poses."""
QUANTITIES: tuple[Quantity, ...] = ("R", "T", "psi", "delta")
ANGLES = ("psi", "delta")
THETA_DEG, PHI_DEG = tuple(range(0, 90, 5)), (0, 45, 90)
"""Where a goniometer stops."""


@dataclass(frozen=True)
class Instruments:
    """How curves are taken: where, and with which standard deviations."""

    quantities: tuple[Quantity, ...] = ()
    wavelength_nm: tuple[float, ...] = ()
    aoi_deg: tuple[float, ...] = (0.0,)
    sigma: float = 0.002
    """Of R and T."""
    sigma_deg: float = 0.05
    """Of psi and delta."""
    far_field: bool = False
    far_sigma: float = 0.02
    """Of a far field, as a share of its largest value."""

    def __post_init__(self) -> None:
        for name, value in (("sigma", self.sigma), ("sigma-deg", self.sigma_deg), ("far-sigma", self.far_sigma)):
            if not 0.0 < value < np.inf:
                raise InputError(f"--{name}", value, "above 0", "no instrument is without noise")
        if set(ANGLES) & set(self.quantities) and min(self.aoi_deg) <= 0.0:
            raise InputError("--angle", min(self.aoi_deg), "above 0 deg with psi or delta", "for example 60,70")


@dataclass(frozen=True, eq=False)
class ExpectedCurve:
    """A curve before its noise."""

    shot: SpectrumShot | FarFieldShot
    places: tuple[tuple[str, ...], ...]
    """(row, column): the cells before value and sigma."""
    value: Real
    sigma: float
    model_error: float = 0.0
    """Rms standard error that Monte Carlo left in the values, in units of sigma."""

    def write(self, folder: Path, seed: int, number: int) -> None:
        """The CSV of one noise draw; a seed gives every number its own."""
        noise = np.random.default_rng((seed, CURVES, number)).standard_normal(len(self.value))
        measured = self._in_range(self.value + self.sigma * noise)
        columns = SPECTRUM_COLUMNS if self.shot.kind == "spectrum" else FAR_FIELD_COLUMNS
        lines = [",".join(columns)]
        for place, value in zip(self.places, measured, strict=True):
            lines.append(",".join((*place, f"{value:.8g}", f"{self.sigma:.8g}")))
        path = folder / self.shot.file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")

    def _in_range(self, value: Real) -> Real:
        """Ellipsometric angles as instruments give them."""
        quantity = getattr(self.shot, "quantity", "")
        if quantity == "psi":
            return 90.0 - np.abs(90.0 - np.abs(value))
        return np.mod(value, 360.0) if quantity == "delta" else value


def expected_spectra(
    client: Asks, model: Model, films: Sequence[FilmSample], wanted: Instruments
) -> list[ExpectedCurve]:
    """All quantities of all films; RemoteError where the worker refuses one."""
    from validation.prediction import Curve, Predictor

    wave_nm, aoi_deg = (one.ravel() for one in np.meshgrid(wanted.wavelength_nm, wanted.aoi_deg))
    asked = [(film, quantity) for film in films for quantity in wanted.quantities]
    if not asked:
        return []
    curves = [
        Curve(film, quantity, wave_nm, aoi_deg, ["" if quantity in ANGLES else "u"] * len(wave_nm))
        for film, quantity in asked
    ]
    found = []
    for curve, seen in zip(curves, Predictor(client).spectra(model, curves), strict=True):
        name = f"{curve.film.id}-{curve.quantity}"
        sigma = wanted.sigma_deg if curve.quantity in ANGLES else wanted.sigma
        shot = SpectrumShot(
            id=name, kind="spectrum", film=curve.film.id, quantity=curve.quantity, file=f"spectra/{name}.csv"
        )
        cells = zip(wave_nm, aoi_deg, curve.polarisation, strict=True)
        places = tuple((f"{wave:.10g}", f"{aoi:.10g}", one) for wave, aoi, one in cells)
        found.append(ExpectedCurve(shot, places, seen.value, sigma))
    return found


def expected_far_fields(
    client: Asks, model: Model, samples: Sequence[Sample], wanted: Instruments, *, histories: int, seed: int
) -> list[ExpectedCurve]:
    """A curve of each sample, its peak 1; by Monte Carlo of so many histories. RemoteError with the first failure."""
    from validation.prediction import FarView, Predictor

    if not wanted.far_field:
        return []
    theta_deg, phi_deg = (one.ravel().astype(float) for one in np.meshgrid(THETA_DEG, PHI_DEG))
    places = tuple((f"{theta:g}", f"{phi:g}") for theta, phi in zip(theta_deg, phi_deg, strict=True))
    drawn = int(np.random.SeedSequence((seed, FAR_FIELDS)).generate_state(1, np.uint64)[0]) % 10**15
    views = [FarView(sample, theta_deg, phi_deg) for sample in samples]
    found = []
    curves = Predictor(client).far_fields(model, views, histories=histories, seed=drawn)
    for sample, seen in zip(samples, curves, strict=True):
        name, peak = f"{sample.id}-far", float(seen.value.max())
        shot = FarFieldShot(id=name, kind="far_field", sample=sample.id, file=f"far/{name}.csv")
        error = 0.0 if seen.error is None else float(np.sqrt(np.mean(seen.error**2))) / peak / wanted.far_sigma
        found.append(ExpectedCurve(shot, places, seen.value / peak, wanted.far_sigma, error))
    return found


def quantities_of(text: str) -> tuple[Quantity, ...]:
    """The quantities in an option, as "R,T"; InputError for others."""
    found = [one.strip() for one in text.split(",") if one.strip()]
    for one in found:
        if one not in QUANTITIES:
            raise InputError("--spectra", one, ", ".join(QUANTITIES), "commas between several")
    return tuple(one for one in QUANTITIES if one in found)


def numbers_of(field: str, text: str, low: float, high: float) -> tuple[float, ...]:
    """The numbers in an option, as "0,45,60" or "400:700:2" (from, to, step); InputError for others."""
    try:
        if ":" in text:
            first, last, step = (float(one) for one in text.split(":"))
            count = int(np.floor((last - first) / step + 1e-9)) + 1
            found = [first + step * number for number in range(min(count, MAX_PLACES + 1))]
        else:
            found = [float(one) for one in text.split(",")]
    except (ValueError, ZeroDivisionError, OverflowError):
        found = []
    if not found or len(found) > MAX_PLACES or not all(low <= one <= high for one in found):
        allowed = f"1 to {MAX_PLACES:,} numbers from {low:g} to {high:g}"
        raise InputError(field, text, allowed, "for example 400:700:2 (from, to, step), or 0,45,60")
    return tuple(dict.fromkeys(found))
