"""The words of the blind test's own forward model: what is looked at, in which surroundings, with what hidden."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Place = Literal["optics", "module", "camera"]

CLEARANCE_UM = 5.0
"""Chips end at least this far below the receiver."""


@dataclass(frozen=True)
class Sample:
    """A finite module of equal chips; a single chip has one row and one column."""

    id: str
    rows: int
    """Of chips, along y."""
    columns: int
    distance_um: float
    """D, from the substrate to the receiver."""
    width_um: float
    spacing_um: float
    """The pitch, from chip centre to chip centre."""
    thickness_um: float
    dbr_pairs: float
    """A multiple of one half; 0 for a bare top face."""
    module_half_um: float
    """From the module's centre to its edge, where light is lost."""

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        for name, least, most in (
            ("rows", 1, 100), ("columns", 1, 100), ("distance_um", 1.0, 1e4), ("width_um", 0.1, 1e4),
            ("spacing_um", 0.1, 1e5), ("thickness_um", 0.1, 1e4), ("dbr_pairs", 0.0, 100.0),
            ("module_half_um", 1.0, 1e5),
        ):  # fmt: skip
            within(f"sample {self.id}: {name}", getattr(self, name), least, most)
        if not (2.0 * self.dbr_pairs).is_integer():
            raise ValueError(f"sample {self.id}: dbr_pairs = {self.dbr_pairs}: a multiple of 0.5 is needed")
        within(f"sample {self.id}: distance_um", self.distance_um, self.thickness_um + CLEARANCE_UM, 1e4)
        if self.chips > 1:
            within(f"sample {self.id}: width_um", self.width_um, 0.1, 0.9 * self.spacing_um)
        within(f"sample {self.id}: module_half_um", self.module_half_um, self.reach_um + self.width_um, 1e5)

    @property
    def chips(self) -> int:
        """How many there are."""
        return self.rows * self.columns

    @property
    def reach_um(self) -> float:
        """From the module's centre to the centres of its outer chips, along the longer side."""
        return (max(self.rows, self.columns) - 1) / 2.0 * self.spacing_um

    @property
    def height_um(self) -> float:
        """From the chips' top to the receiver."""
        return self.distance_um - self.thickness_um


@dataclass(frozen=True)
class Surroundings:
    """Everything about the modules that is the same for all samples."""

    substrate_reflectance: float
    substrate_sigma_deg: float
    """Rayleigh scale of the polar angle about the mirror direction."""
    receiver_reflectance: float
    """Of a Lambertian receiver."""
    chip_absorption_per_cm: float
    active_layer_depth: float | None
    """Height of a thin emitting layer above the chip's bottom, as a share of T; None: all the volume shines."""
    chip_bottom: str
    """contact: the substrate's lobe; mirror: a mirror with the substrate's reflectance."""
    n_gan: float
    n_aln: float
    gan_nm: float
    aln_nm: float
    layer_order: str
    """gan_first or aln_first: which layer lies on the chip."""
    peak_nm: float
    fwhm_nm: float

    def __post_init__(self) -> None:
        """Refuse what is no surrounding of a module."""
        for name, least, most in (
            ("substrate_reflectance", 0.0, 1.0), ("substrate_sigma_deg", 0.0, 40.0),
            ("receiver_reflectance", 0.0, 0.95), ("chip_absorption_per_cm", 0.0, 1e4), ("n_gan", 1.42, 5.0),
            ("n_aln", 1.0, 5.0), ("gan_nm", 0.1, 1e3), ("aln_nm", 0.1, 1e3), ("peak_nm", 100.0, 2e3),
            ("fwhm_nm", 0.0, 100.0),
        ):  # fmt: skip
            within(name, getattr(self, name), least, most)
        if self.active_layer_depth is not None:
            within("active_layer_depth", self.active_layer_depth, 0.0, 1.0)
        one_of("chip_bottom", self.chip_bottom, ("contact", "mirror"))
        one_of("layer_order", self.layer_order, ("gan_first", "aln_first"))


@dataclass(frozen=True)
class Camera:
    """A camera that looks straight at the receiver; row 0 at the lowest y."""

    rows: int
    columns: int
    pixel_um: float
    """Side of a pixel as seen on the receiver."""
    bit_depth: int
    gain_dn_per_e: float
    read_noise_e: float
    full_well_e: float
    black_level_dn: float

    def __post_init__(self) -> None:
        """Refuse what is no camera."""
        for name, least, most in (
            ("rows", 4, 4096), ("columns", 4, 4096), ("pixel_um", 0.01, 1e3), ("bit_depth", 1, 16),
            ("gain_dn_per_e", 1e-9, 1e6), ("read_noise_e", 0.0, 1e6), ("full_well_e", 1.0, 1e9),
            ("black_level_dn", 0.0, 6e4),
        ):  # fmt: skip
            within(f"camera.{name}", getattr(self, name), least, most)
        if self.black_level_dn >= self.full_scale_dn:
            raise ValueError(f"camera.black_level_dn = {self.black_level_dn}: below {self.full_scale_dn} is needed")

    @property
    def full_scale_dn(self) -> float:
        """The largest raw number."""
        return float(2**self.bit_depth - 1)

    @property
    def room_dn(self) -> float:
        """The largest signal above black, ymax."""
        return self.full_scale_dn - self.black_level_dn


@dataclass(frozen=True)
class Pose:
    """Where the module's centre lies in the image, beside the image's centre, and how the module is turned there."""

    shift_row_px: float = 0.0
    shift_column_px: float = 0.0
    rotation_deg: float = 0.0
    """About the module's centre, x towards y."""

    def __post_init__(self) -> None:
        """Refuse what is no pose."""
        for field in fields(self):
            within(f"pose.{field.name}", getattr(self, field.name), -1e3, 1e3)


@dataclass(frozen=True)
class Hidden:
    """What was hidden in a truth."""

    kind: str
    amount: float
    """In the kind's unit."""
    seed: int = 0
    """Of what the kind draws: positions, powers, a corner."""


@dataclass(frozen=True)
class Kind:
    """Something that can be hidden."""

    name: str
    place: Place
    right: tuple[str, ...]
    """Effects of the catalogue that are the right answer; none: it is outside of the catalogue."""
    unit: str
    off: float
    """The amount at which it is absent."""
    most: float
    """The largest amount that is still plausible; it may lie below `off`."""
    discrete: bool
    """Whether it is there or not, at `most` or at `off`."""
    says: str
    """One sentence: what it is, with its source."""


def within(name: str, value: object, least: float, most: float) -> None:
    """ValueError with name, value and range for what is no finite number from `least` to `most`."""
    numeric = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not (numeric and least <= float(value) <= most):  # type: ignore[arg-type]
        raise ValueError(f"{name} = {value!r}: a number from {least:g} to {most:g} is needed")


def one_of(name: str, value: str, allowed: tuple[str, ...]) -> None:
    """ValueError with name, value and choices."""
    if value not in allowed:
        raise ValueError(f"{name} = {value!r}: one of {', '.join(allowed)} is needed")
