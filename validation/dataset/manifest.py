"""The words of `dataset.toml`, schema luxloop-dataset/1: a camera, samples, films, and the shots taken of them.

Images are row-major, row 0 at the lowest y; coordinates in um are relative to the module's centre. Units are in the
names. What stands here is checked word by word; `validation.dataset.checks` holds it against the files.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from luxloop.design import Design, SpacingIs, nearest_half
from luxloop.errors import InputError
from luxloop.model import Strict
from luxloop.words import Name, Text

SCHEMA = "luxloop-dataset/1"
MAX_SHOTS = 1000
FREE = ("thickness_nm", "a", "b_um2")

FilePath = Annotated[str, Field(min_length=1, max_length=400, description="Relative to the folder, with /.")]
Pair = Annotated[tuple[float, float], Field(strict=False)]
"""Two numbers. TOML has lists only, so a list is taken for it."""


class CameraFacts(Strict):
    """What the data sheet or an EMVA 1288 report says of the camera, and the scale of its images."""

    pixel_um: float = Field(gt=0.0, le=1000.0, description="Side of a pixel as seen on the receiver plane.")
    bit_depth: int = Field(ge=9, le=16, description="Full scale is 2^bit_depth - 1 DN; 8 bits are too coarse.")
    gain_dn_per_e: float = Field(gt=0.0, le=1000.0, description="K of EMVA 1288.")
    read_noise_e: float = Field(ge=0.0, le=1e4, description="Rms, temporal dark noise.")
    full_well_e: float = Field(gt=0.0, le=1e9, description="Where the pixel is full.")
    black_level_dn: float = Field(ge=0.0, le=65_535.0, description="Digital number without light.")
    prnu_percent: float = Field(
        0.0, ge=0.0, le=20.0, description="Rms of the fixed pattern left after the flat, the same in all images."
    )
    temperature_c: float | None = Field(None, ge=-273.0, le=200.0, description="Not used by the model.")
    gain_mode: Literal["free", "exposure"] = Field(
        "free", description="Whether the gain of each image is free, or tied to its exposure within 1 %."
    )

    @model_validator(mode="after")
    def _black_is_below_full_scale(self) -> CameraFacts:
        if self.black_level_dn >= self.full_scale_dn:
            allowed = f"below full scale, {self.full_scale_dn:g} DN"
            raise InputError("black_level_dn", self.black_level_dn, allowed, "give the level of a dark image")
        return self

    @property
    def full_scale_dn(self) -> float:
        """The largest digital number of a raw file."""
        return float(2**self.bit_depth - 1)

    @property
    def saturation_dn(self) -> float:
        """The raw digital number from which a pixel is taken for saturated."""
        return min(0.98 * self.full_scale_dn, self.black_level_dn + 0.97 * self.gain_dn_per_e * self.full_well_e)

    @property
    def dark_variance_dn2(self) -> float:
        """Variance of a raw pixel of one frame without light: read noise and rounding."""
        return (self.gain_dn_per_e * self.read_noise_e) ** 2 + 1.0 / 12.0


class Sample(Strict):
    """A chip or an array of chips in front of the camera or the goniometer."""

    id: Name
    layout: Literal["single", "array"]
    rows: int = Field(1, ge=1, le=100, description="Chips along y, of an array.")
    columns: int = Field(1, ge=1, le=100, description="Chips along x, of an array.")
    distance_um: float = Field(gt=0.0, le=10_000.0, description="Distance D to the receiver.")
    width_um: float = Field(gt=0.0, le=2_000.0, description="Side W of the square chip.")
    spacing_um: float = Field(gt=0.0, le=20_000.0, description="Spacing S of the chips; unused for a single.")
    thickness_um: float = Field(gt=0.0, le=1_000.0, description="Height T of the chip.")
    dbr_pairs: float = Field(ge=0.0, le=100.0, description="Pairs of DBR layers, a multiple of 0.5.")
    edge: Literal["open"] = Field("open", description="Light that crosses the module's edge is lost.")
    module_half_um: float | None = Field(None, gt=0.0, le=1e6, description="Half side of the square module.")

    @property
    def design(self) -> Design:
        """The design of its chips."""
        return Design(**{name: getattr(self, name) for name in Design.FIELDS})

    def pitch_um(self, spacing_is: SpacingIs = "pitch") -> float:
        """From chip centre to chip centre, by what a model takes `spacing_um` for."""
        return self.spacing_um + (self.width_um if spacing_is == "gap" else 0.0)

    def half_um(self, spacing_is: SpacingIs = "pitch") -> float:
        """Half side of the square module: as given, or half a pitch past the outer chips, or 2000 for a single."""
        if self.module_half_um is not None:
            return self.module_half_um
        return 2000.0 if self.layout == "single" else max(self.rows, self.columns) * self.pitch_um(spacing_is) / 2.0

    @model_validator(mode="after")
    def _can_be_built(self) -> Sample:
        if not (2.0 * self.dbr_pairs).is_integer():
            mend = f"nearest: {nearest_half(self.dbr_pairs):g}"
            raise InputError("dbr_pairs", self.dbr_pairs, "a multiple of 0.5 from 0 to 100", mend)
        if self.layout == "single" and (self.rows, self.columns) != (1, 1):
            raise InputError("rows, columns", (self.rows, self.columns), "1, 1 for a single", 'or layout = "array"')
        if self.layout == "array" and self.rows * self.columns == 1:
            raise InputError("rows, columns", (1, 1), "at least two chips for an array", 'or layout = "single"')
        if reason := self.design.feasibility(spacing_is="gap"):
            raise InputError("distance_um", self.distance_um, "a module that can be built, D >= T + 5", reason)
        return self


class FilmLayer(Strict):
    """A layer of a film: a named material, or an index n = a + b / lambda_um^2, or a fixed n + ik."""

    material: Name | None = None
    cauchy: Pair | None = Field(None, description="[a, b_um2].")
    fixed: Pair | None = Field(None, description="[n, k].")
    thickness_nm: float = Field(ge=0.0, le=1e9)
    coherent: bool = Field(True, description="false: a thick layer, whose powers add, not its amplitudes.")
    free: dict[str, Pair] = Field(
        default_factory=dict, description="What a fit may move, between which limits: thickness_nm, a, b_um2."
    )

    @model_validator(mode="after")
    def _says_one_index(self) -> FilmLayer:
        given = [name for name in ("material", "cauchy", "fixed") if getattr(self, name) is not None]
        if len(given) != 1:
            mend = 'e.g. material = "SiO2"'
            raise InputError("material", ", ".join(given) or None, "exactly one of material, cauchy, fixed", mend)
        if self.fixed is not None and not (0.0 < self.fixed[0] <= 20.0 and 0.0 <= self.fixed[1] <= 50.0):
            raise InputError("fixed", self.fixed, "[n, k] with 0 < n <= 20 and 0 <= k <= 50")
        if self.cauchy is not None and not (0.0 < self.cauchy[0] <= 20.0 and abs(self.cauchy[1]) <= 10.0):
            raise InputError("cauchy", self.cauchy, "[a, b_um2] with 0 < a <= 20 and |b| <= 10")
        return self

    @model_validator(mode="after")
    def _limits_hold_the_values(self) -> FilmLayer:
        values = {"thickness_nm": self.thickness_nm}
        values |= dict(zip(("a", "b_um2"), self.cauchy, strict=True)) if self.cauchy else {}
        for name, (low, high) in self.free.items():
            if name not in values:
                raise InputError(f"free.{name}", (low, high), " or ".join(values), "a and b_um2 belong to cauchy")
            if not low < high or not low <= values[name] <= high:
                allowed = f"[low, high] around {name} = {values[name]:g}"
                raise InputError(f"free.{name}", (low, high), allowed, "widen the limits")
        return self


class FilmSample(Strict):
    """A film as a spectrometer or an ellipsometer sees it."""

    id: Name
    incident: Name = Field("air", description="Material that the light comes from; air is taken as n = 1.")
    exit: Name = Field("air", description="Material behind the film: air (n = 1), Si, ...")
    layers: Annotated[tuple[FilmLayer, ...], Field(strict=False)] = Field(
        (), max_length=400, description="The incident side first."
    )


class ImageShot(Strict):
    """An image of a sample, with what corrects it."""

    id: Name
    kind: Literal["image"]
    sample: Name
    file: FilePath
    dark: FilePath | None = Field(None, description="Subtracted, instead of black_level_dn.")
    dark_frames_averaged: int | None = Field(
        None, ge=1, le=1_000_000, description="Frames in the dark; none: as many as in the image."
    )
    flat: FilePath | None = Field(None, description="Divides; its own dark must be gone already.")
    mask: FilePath | None = Field(None, description="0: ignore the pixel.")
    exposure_ms: float = Field(gt=0.0, le=1e7)
    frames_averaged: int = Field(1, ge=1, le=1_000_000, description="The noise variance is divided by it.")
    centre_px: Pair | None = Field(None, description="First guess (row, column) of the module's centre.")

    @property
    def dark_frames(self) -> int:
        """Frames in its dark, as said or as many as it has itself."""
        return self.dark_frames_averaged or self.frames_averaged

    def files(self) -> dict[str, str]:
        """The files it names, by field."""
        named = {name: getattr(self, name) for name in ("file", "dark", "flat", "mask")}
        return {name: path for name, path in named.items() if path is not None}


class SpectrumShot(Strict):
    """A spectrum or an ellipsometric curve of a film."""

    id: Name
    kind: Literal["spectrum"]
    film: Name
    quantity: Literal["R", "T", "psi", "delta"]
    file: FilePath
    bandwidth_nm: float = Field(0.0, ge=0.0, le=1000.0, description="FWHM of the instrument.")

    def files(self) -> dict[str, str]:
        """The files it names, by field."""
        return {"file": self.file}


class FarFieldShot(Strict):
    """The goniometer curve of a chip or a module; its scale is free."""

    id: Name
    kind: Literal["far_field"]
    sample: Name
    file: FilePath

    def files(self) -> dict[str, str]:
        """The files it names, by field."""
        return {"file": self.file}


Shot = Annotated[ImageShot | SpectrumShot | FarFieldShot, Field(discriminator="kind")]


class Manifest(Strict):
    """A `dataset.toml`. `contradictions` says what is wrong between its parts."""

    name: Text
    licence: Text = ""
    notes: Text = ""
    camera: CameraFacts | None = Field(None, description="Needed where there are images.")
    samples: Annotated[tuple[Sample, ...], Field(strict=False)] = Field((), max_length=MAX_SHOTS)
    films: Annotated[tuple[FilmSample, ...], Field(strict=False)] = Field((), max_length=MAX_SHOTS)
    shots: Annotated[tuple[Shot, ...], Field(strict=False)] = Field(min_length=1, max_length=MAX_SHOTS)

    @field_validator("name")
    @classmethod
    def _has_a_name(cls, name: str) -> str:
        if not name.strip():
            raise InputError("name", name, "a few words")
        return name

    def images(self) -> list[ImageShot]:
        """Its images."""
        return [shot for shot in self.shots if isinstance(shot, ImageShot)]

    def spectra(self) -> list[SpectrumShot]:
        """Its spectra and ellipsometric curves."""
        return [shot for shot in self.shots if isinstance(shot, SpectrumShot)]

    def far_fields(self) -> list[FarFieldShot]:
        """Its goniometer curves."""
        return [shot for shot in self.shots if isinstance(shot, FarFieldShot)]

    def sample(self, name: str) -> Sample:
        """The sample of that id."""
        return next(sample for sample in self.samples if sample.id == name)

    def film(self, name: str) -> FilmSample:
        """The film of that id."""
        return next(film for film in self.films if film.id == name)


def contradictions(manifest: Manifest) -> Iterator[InputError]:
    """What is wrong between its parts: ids twice, shots of nothing, no camera, a dark with two counts of frames."""
    samples, films = ([one.id for one in group] for group in (manifest.samples, manifest.films))
    yield from _twice("samples", samples)
    yield from _twice("films", films)
    yield from _twice("shots", (shot.id for shot in manifest.shots))
    for shot in manifest.shots:
        field, known = ("film", films) if isinstance(shot, SpectrumShot) else ("sample", samples)
        named = getattr(shot, field)
        if named not in known:
            mend = f"add it under [[{field}s]], or name one that is there"
            yield InputError(f'shots["{shot.id}"].{field}', named, ", ".join(known) or "(there is none)", mend)
    if manifest.images() and manifest.camera is None:
        yield InputError("camera", None, "a [camera] section, since there are images", "luxloop dataset import asks")
    yield from _miscounted_darks(manifest.images())


def _miscounted_darks(shots: Iterable[ImageShot]) -> Iterator[InputError]:
    """Darks of which two shots do not say the same number of frames, or leave it to their own."""
    first: dict[str, ImageShot] = {}
    for shot in shots:
        if shot.dark is None or shot.dark_frames == first.setdefault(shot.dark, shot).dark_frames:
            continue
        known = first[shot.dark]
        allowed = f"{known.dark_frames}, the frames of {shot.dark} by {known.id}"
        mend = "say it in all shots that name it; left out, a dark has as many frames as the image"
        yield InputError(f'shots["{shot.id}"].dark_frames_averaged', shot.dark_frames_averaged, allowed, mend)


def _twice(field: str, ids: Iterable[str]) -> Iterator[InputError]:
    seen: set[str] = set()
    for name in ids:
        if name in seen:
            yield InputError(f'{field}["{name}"].id', name, "each id once", "rename one of the two")
        seen.add(name)
