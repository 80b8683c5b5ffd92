"""The words for work of the thin-film worker (PC2): which stack, and what is asked about it."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, TypeAdapter, model_validator

from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.model import Environment
from luxloop.stack import Stack
from luxloop.words import Words

KIND = "film"

GRAZING_DEG = 90.0
"""Angles of incidence are below this: light only grazes the film there."""
Wavelength = Annotated[float, Field(gt=0.0, le=1e6)]
Angle = Annotated[float, Field(ge=0.0, lt=GRAZING_DEG)]
Pairs = Annotated[float, Field(ge=0.0, le=100.0, multiple_of=0.5)]

HALF_SPAN_FWHM = 2.5
"""A line is cut at peak +- 2.5 FWHM; the golden averages move by less than 2e-9 for a wider and denser sampling."""
MAX_FWHM_PER_PEAK = 0.3
"""A wider line would begin below a quarter of its peak, where a Gaussian in wavelength describes no light source."""
MIN_WAVELENGTHS = 11
"""The fewest to begin with; a table takes more where its stack asks for it (21 or 41 for the paper's: 1e-6 of R)."""
MAX_PLACES, MAX_VALUES = 10_000, 1_000_000
"""Different wavelengths, or angles, of a measurement; its wavelengths x angles, or those x nodes of a table."""


class Spectrum(Words):
    """A Gaussian emission line."""

    peak_nm: float = Field(445.0, gt=0.0, le=10_000.0, description="Wavelength of its maximum.")
    fwhm_nm: float = Field(18.0, gt=0.0, le=1_000.0, description="Full width at half maximum.")

    @model_validator(mode="after")
    def _begins_above_zero(self) -> Spectrum:
        if self.fwhm_nm > MAX_FWHM_PER_PEAK * self.peak_nm:
            begins = self.peak_nm - HALF_SPAN_FWHM * self.fwhm_nm
            allowed = f"above 0 to {MAX_FWHM_PER_PEAK:g} x peak_nm, here {MAX_FWHM_PER_PEAK * self.peak_nm:g} nm"
            mend = f"it is cut at peak - 2.5 FWHM, here {begins:g} nm: give a narrower line"
            raise InputError("fwhm_nm", self.fwhm_nm, allowed, mend)
        return self


class Grid(Words):
    """How finely a table is sampled at the start, and how far it may err; it refines itself up to that."""

    wavelengths: int = Field(31, ge=1, le=1001, description="Uniform over peak +- 2.5 FWHM; 1: the peak alone.")
    shared_nodes: int = Field(181, ge=3, le=10_001, description="Uniform in the angle of the less dense side.")
    dense_nodes: int = Field(120, ge=2, le=10_001, description="Beyond it, on the denser side.")
    tolerance_ratio: float = Field(
        1e-3,
        ge=1e-6,
        le=1.0,
        description="Error of T and R, line average of one polarisation; above it, refine.",
    )

    @model_validator(mode="after")
    def _fits_in_memory(self) -> Grid:
        if 1 < self.wavelengths < MIN_WAVELENGTHS:
            allowed = f"1 (the peak alone) or {MIN_WAVELENGTHS} to 1001"
            raise InputError("wavelengths", self.wavelengths, allowed, "fewer do not average a line")
        values = self.wavelengths * (self.shared_nodes + self.dense_nodes)
        if values > MAX_VALUES:
            allowed = f"wavelengths x nodes up to {MAX_VALUES:,}"
            raise InputError("wavelengths", values, allowed, "ask for a coarser grid")
        return self


class _FilmRequest(Words):
    """What all film requests have: a stack as it stands, or the DBR of an environment; effects on it."""

    KIND: ClassVar[str] = KIND

    stack: Stack | None = None
    environment: Environment | None = None
    dbr_pairs: Pairs | None = None
    effects: tuple[AppliedEffect, ...] = Field((), max_length=64)

    @model_validator(mode="after")
    def _one_film(self) -> _FilmRequest:
        dbr = self.environment is not None and self.dbr_pairs is not None
        if (self.stack is not None) == dbr or (self.stack is not None and self.environment is not None):
            raise InputError("stack", self.stack, "a stack, or an environment with dbr_pairs", "give one of the two")
        return self


class FilmTableRequest(_FilmRequest):
    """The table of powers against u and wavelength that a tracer needs; answered by its hash and its averages."""

    what: Literal["table"] = "table"
    spectrum: Spectrum = Spectrum()
    grid: Grid = Grid()


class FilmMeasurementRequest(_FilmRequest):
    """What an instrument would read: answered by an array `value` (wavelength, aoi)."""

    what: Literal["measurement"] = "measurement"
    quantity: Literal["R", "T", "psi", "delta"]
    wavelength_nm: tuple[Wavelength, ...] = Field(min_length=1, max_length=MAX_PLACES)
    aoi_deg: tuple[Angle, ...] = Field(min_length=1, max_length=MAX_PLACES)
    polarisation: Literal["s", "p", "u"] = "u"
    bandwidth_nm: float = Field(0.0, ge=0.0, le=1_000.0)
    from_side: Literal["outside", "inside"] = "outside"

    @model_validator(mode="after")
    def _fits_in_memory(self) -> FilmMeasurementRequest:
        values = len(self.wavelength_nm) * len(self.aoi_deg)
        if values > MAX_VALUES:
            raise InputError("wavelength_nm", values, f"wavelengths x angles up to {MAX_VALUES:,}", "ask in parts")
        return self


FilmRequest = Annotated[FilmTableRequest | FilmMeasurementRequest, Field(discriminator="what")]
FILM_REQUEST: TypeAdapter[Any] = TypeAdapter(FilmRequest)
