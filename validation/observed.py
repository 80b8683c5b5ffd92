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
    if film is None:
        return spectrum
    known = [one.id for one in dataset.manifest.films]
    if film not in known:
        raise InputError("--film", film, ", ".join(known) or "(the data set has none)", "describe it under [[films]]")
    return replace(spectrum, film=dataset.manifest.film(film))
