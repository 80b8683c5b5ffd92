"""What effects are shown on and compared with each other by: an example module, an example film, six images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np

from luxloop.model import Model
from validation.dataset.manifest import CameraFacts, FilmLayer, FilmSample, ImageShot, Sample, SpectrumShot
from validation.dataset.spectra import SpectrumTable
from validation.effects.signatures import Projection
from validation.measured import MeasuredImage, MeasuredSpectrum
from validation.prediction import Curve, Predicted, Predictor, View

CAMERA = CameraFacts(
    pixel_um=8.0, bit_depth=12, gain_dn_per_e=0.38, read_noise_e=6.0, full_well_e=10_000.0, black_level_dn=64.0
)
BINNING, BINNED_PX = 3, 42
"""Of its 128 x 128 pixels: 24 um, 1/16 of the pitch."""
PEAK_SHARE = 0.7
"""Of full scale, that the brightest pixel of each image has."""

MODULE = Sample(
    id="example", layout="array", rows=5, columns=5,
    distance_um=180.0, width_um=40.0, spacing_um=500.0, thickness_um=20.0, dbr_pairs=2.5,
)  # fmt: skip
"""The module that signatures are drawn on."""
MODULE_VIEW = View(MODULE, rows=121, columns=121, pixel_um=20.0, centre_px=(60.0, 60.0))

FILM_FREE = {"thickness_nm": (250.0, 350.0), "a": (1.4, 1.6), "b_um2": (-0.02, 0.03)}
FILM = FilmSample(
    id="example",
    exit="Si",
    layers=(FilmLayer(cauchy=(1.5, 0.004), thickness_nm=300.0, free=FILM_FREE),),
)
"""A polymer on silicon, its thickness and index to be fitted."""
FILM_ERRORS = {"R": 0.002, "T": 0.002, "psi": 0.05, "delta": 0.2}
"""Of a reading: shares and degrees, as of a good spectrometer and ellipsometer."""


def film_curves() -> list[Curve]:
    """Curves of the example film: R, psi and delta over the visible, at angles where a film shows."""
    wavelength = np.linspace(400.0, 800.0, 81)
    asked: tuple[tuple[Literal["R", "T", "psi", "delta"], float, str], ...] = (
        ("R", 0.0, "u"), ("T", 0.0, "u"), ("psi", 70.0, ""), ("delta", 70.0, ""),
    )  # fmt: skip
    return [
        Curve(FILM, quantity, wavelength, np.full(81, aoi_deg), [polarisation] * 81)
        for quantity, aoi_deg, polarisation in asked
    ]


def samples() -> Iterator[Sample]:
    """Those of the six images: single chips and 5 x 5 arrays with 0, 2.5 and 5.5 pairs, as in the paper."""
    for layout, rows in (("single", 1), ("array", 5)):
        for pairs in (0.0, 2.5, 5.5):
            chips = {"rows": rows, "columns": rows} if layout == "array" else {}
            yield Sample.model_validate(
                {
                    "id": f"{layout}-{pairs:g}", "layout": layout, "distance_um": 180.0, "width_um": 40.0,
                    "spacing_um": 400.0, "thickness_um": 20.0, "dbr_pairs": pairs, **chips,
                }
            )  # fmt: skip


def example_images(model: Model, predictor: Predictor) -> list[MeasuredImage]:
    """Six images as the twin sees the model, without noise: what a data set of the paper's kind can tell."""
    return seen(predictor.images(model, example_views()))


def example_views() -> list[View]:
    """How the example camera sees the samples."""
    middle, pixel_um = (BINNED_PX - 1) / 2.0, BINNING * CAMERA.pixel_um
    return [View(one, BINNED_PX, BINNED_PX, pixel_um, (middle, middle)) for one in samples()]


def seen(light: Sequence[Predicted]) -> list[MeasuredImage]:
    """What the example camera makes of the light of its views, but for its noise."""
    peak_dn = PEAK_SHARE * (CAMERA.saturation_dn - CAMERA.black_level_dn)
    return [
        _image(sample, peak_dn * one.irradiance_per_mm2 / one.irradiance_per_mm2.max())
        for sample, one in zip(samples(), light, strict=True)
    ]


def _image(sample: Sample, signal_dn: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> MeasuredImage:
    bin_pixels = BINNING**2
    middle = (BINNED_PX - 1) / 2.0
    return MeasuredImage(
        shot=ImageShot(id=sample.id, kind="image", sample=sample.id, file="example", exposure_ms=1.0),
        sample=sample,
        camera=CAMERA,
        signal_dn=signal_dn,
        used=np.ones(signal_dn.shape, np.bool_),
        constant_dn2=np.full(signal_dn.shape, CAMERA.dark_variance_dn2 / bin_pixels),
        slope_dn=np.full(signal_dn.shape, CAMERA.gain_dn_per_e / bin_pixels),
        dark_dn2=np.zeros(signal_dn.shape),
        prnu=0.0,
        binning=BINNING,
        pixel_um=pixel_um_of(),
        centre_px=(middle, middle),
        saturated=0,
        masked=0,
        raw_pixels=signal_dn.size * bin_pixels,
    )


def pixel_um_of() -> float:
    """Side of a binned pixel of the example camera on the receiver."""
    return BINNING * CAMERA.pixel_um


def film_projection(model: Model, predictor: Predictor) -> Projection:
    """The example film's curves with an instrument's errors; its thickness and index may move."""
    curves = film_curves()
    paths = [f"films.{FILM.id}.layers.0.{name}" for name in FILM_FREE]
    sigma = [np.full(81, FILM_ERRORS[curve.quantity]) for curve in curves]
    return Projection.of_curves(model, curves, sigma, paths, predictor)


def example_spectra(model: Model, predictor: Predictor) -> list[MeasuredSpectrum]:
    """The curves of the example film as the model itself would give them, without noise."""
    curves = film_curves()
    return [
        _spectrum(curve, found.value) for curve, found in zip(curves, predictor.spectra(model, curves), strict=True)
    ]


def _spectrum(curve: Curve, value: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> MeasuredSpectrum:
    wavelength_nm, aoi_deg = (np.asarray(one, float) for one in (curve.wavelength_nm, curve.aoi_deg))
    sigma = np.full(value.shape, FILM_ERRORS[curve.quantity])
    name = curve.quantity
    shot = SpectrumShot(id=name, kind="spectrum", film=FILM.id, quantity=name, file="example")
    return MeasuredSpectrum(
        shot, FILM, SpectrumTable(wavelength_nm, aoi_deg, tuple(curve.polarisation), value, sigma)
    )
