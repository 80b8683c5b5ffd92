"""What a fit gets of a data set: its images, its curves, and the films' parameters that may move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from luxloop.errors import InputError
from validation.dataset.folder import Dataset
from validation.fit import CurveData, Parameter, curves_of, film_parameters
from validation.measured import (
    MeasuredImage,
    MeasuredSpectrum,
    measured_far_fields,
    measured_images,
    measured_spectra,
    refuse_no_pixel,
)


@dataclass(frozen=True, eq=False)
class Observed:
    """The shots of a data set, ready to be compared."""

    images: tuple[MeasuredImage, ...]
    curves: tuple[CurveData, ...]
    films: tuple[Parameter, ...]
    """Parameters of films, with limits."""
    films_at: Mapping[str, float]
    """Their values in the data set."""

    @classmethod
    def of(cls, dataset: Dataset, compare_pixel_um: float | None = None, film: str | None = None) -> Observed:
        """Everything that was measured; `film`: the one that is taken for all spectra, another idea of them.

        Raises InputError for the first fault of a file, and a film that the data set does not describe.
        """
        _refuse_unused(dataset, compare_pixel_um, film)
        images = measured_images(dataset, compare_pixel_um)
        spectra = [_of_film(one, dataset, film) for one in measured_spectra(dataset)]
        films, films_at = film_parameters(spectra)
        return cls(tuple(images), tuple(curves_of(spectra, measured_far_fields(dataset))), tuple(films), films_at)

    @property
    def of_modules(self) -> bool:
        """Whether any shot is of a module: an image, or a far field, whose scale is free."""
        return bool(self.images) or any(curve.free_scale for curve in self.curves)

    @property
    def shots(self) -> tuple[str, ...]:
        """The ids of all shots, images first."""
        return (*(image.shot.id for image in self.images), *(curve.id for curve in self.curves))


def _of_film(spectrum: MeasuredSpectrum, dataset: Dataset, film: str | None) -> MeasuredSpectrum:
    return spectrum if film is None else replace(spectrum, film=dataset.manifest.film(film))


def _refuse_unused(dataset: Dataset, pixel_um: float | None, film: str | None) -> None:
    """InputError for a film or a pixel that these data cannot be compared with or at."""
    manifest = dataset.manifest
    known = [one.id for one in manifest.films]
    if film is not None and not manifest.spectra():
        raise InputError("--film", film, "data with spectra", "there are none here: leave it out")
    if film is not None and film not in known:
        raise InputError("--film", film, ", ".join(known), "describe it under [[films]]")
    refuse_no_pixel(pixel_um)
    if pixel_um is None:
        return
    if manifest.camera is None or not manifest.images():
        raise InputError("--pixel-um", pixel_um, "data with images", "there are none here: leave it out")
    least_um = manifest.camera.pixel_um
    if pixel_um < least_um * (1.0 - 1e-9):
        mend = "no smaller one was measured; leave it out for 1/16 of the pitch"
        raise InputError("--pixel-um", pixel_um, f"at least the camera's pixel, {least_um:g} um", mend)
