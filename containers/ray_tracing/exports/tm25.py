"""The light that leaves a chip, ray by ray: IES TM-25 binary ray files (`*.tm25ray`), the layout of 2013.

    0      "TM25", int32 2013, int32 how made (0: simulation)               4.7.1.1 - 3
    12     float32 luminous flux in lm, float32 radiant flux in W           4.7.1.4 - 5    NaN: not known
    20     uint64 count of rays, 28 characters date and time (ISO 8601)     4.7.1.6 - 7
    56     int32 where rays start (0: not said)                             4.7.1.8
    60     int32 spectrum (1: one wavelength, 2: one for each ray)          4.7.1.9
    64     float32 wavelength, least, largest, in nm                        4.7.1.10 - 12  NaN: does not apply
    76     int32 spectra, int32 further columns, int32 bytes of further text, all 0; reserved to 256
    256    8 x int32, which columns there are: position, direction, radiant flux, wavelength, luminous flux, Stokes,
           tristimulus, spectrum                                            4.7.2
    288    9 x 1000 characters UTF-32 of description                        4.7.3
    36288  the rays, float32: x, y, z (mm), direction cosines, W, and the wavelength (nm) where each has its own

Little-endian throughout. Sources: section numbers and meaning from the open TM25RaySetTools (C++, by an author of the
standard, public domain), sizes also from IESTM25RayFiles (C#, public domain) and the documentation of the crate
tm25ray; files of a maker of LEDs, of LightTools and of TM25RaySetTools agree with the offsets. The edition of 2020 is
said to leave files of 2013 valid; its own text was not read. The codes of 4.7.1.8 are not known to us, so we say 0.
TM25RaySetTools, compiled, reads files of both kinds written here with the same rays, no warning and a sane header.

Not carried: polarisation, how often a ray met what, and the luminous flux, which belongs to the line and not to one
wavelength (NaN). The rays of a file may have different fluxes.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.checked import Real, reals, within
from luxloop.errors import InputError

VERSION = 2013
SIMULATED = 0
ONE_WAVELENGTH, WAVELENGTH_EACH = 1, 2
HEADER = np.dtype(
    [
        ("file_type", "S4"),
        ("version", "<i4"),
        ("creation_method", "<i4"),
        ("luminous_flux_lm", "<f4"),
        ("radiant_flux_w", "<f4"),
        ("rays", "<u8"),
        ("created", "S28"),
        ("start_position", "<i4"),
        ("spectrum", "<i4"),
        ("wavelength_nm", "<f4"),
        ("least_nm", "<f4"),
        ("largest_nm", "<f4"),
        ("spectra", "<i4"),
        ("further_columns", "<i4"),
        ("further_text_bytes", "<i4"),
        ("reserved", "V168"),
        ("flags", "<i4", (8,)),
        ("descriptions", "<u4", (9, 1000)),
    ]
)
DESCRIPTIONS = (
    "light source",
    "manufacturer",
    "model creator",
    "ray file creator",
    "software",
    "camera",
    "operation",
    "remarks",
    "geometry",
)
"""4.7.3.1 to 9."""
MAX_RAYS = 100_000_000
UNIT_TOLERANCE = 1e-5
FLUX_TOLERANCE = 1e-4
"""A header's float32 total against the sum of float32 fluxes that another program may have added up in float32."""


@dataclass(frozen=True)
class RaySet:
    """Rays that leave a source. Raises InputError where they are not such rays."""

    position_mm: Real
    """(ray, 3)."""
    direction: Real
    """(ray, 3), unit vectors."""
    flux_w: Real
    """(ray,)."""
    wavelength_nm: Real
    """(), one for all, or (ray,)."""
    descriptions: Mapping[str, str] = field(default_factory=dict)
    """Any of `DESCRIPTIONS`, each at most 999 characters."""

    def __post_init__(self) -> None:
        count = np.shape(self.flux_w)[:1]
        if len(np.shape(self.flux_w)) != 1 or not 1 <= count[0] <= MAX_RAYS:
            raise InputError("flux_w", np.shape(self.flux_w), f"(ray,), 1 to {MAX_RAYS} rays")
        for name in ("position_mm", "direction"):
            if np.shape(getattr(self, name)) != (*count, 3):
                raise InputError(name, np.shape(getattr(self, name)), f"({count[0]}, 3), as many as fluxes")
        if np.shape(self.wavelength_nm) not in ((), count):
            raise InputError("wavelength_nm", np.shape(self.wavelength_nm), f"one, or ({count[0]},)")
        within("position_mm", self.position_mm, -1e6, 1e6, "millimetres")
        within("flux_w", self.flux_w, 0.0, 1e9, "watts, not negative")
        within("wavelength_nm", self.wavelength_nm, 1.0, 1e6, "nanometres")
        length = np.linalg.norm(reals("direction", self.direction), axis=1)
        within("length of direction", length, 1.0 - UNIT_TOLERANCE, 1.0 + UNIT_TOLERANCE, "unit vectors")


def tm25(rays: RaySet, created: datetime.datetime) -> bytes:
    """The file of a set of rays, single precision; `created` says when, with its time zone.

    The header's radiant flux is the sum of the fluxes as they stand in the file.
    """
    each = np.ndim(rays.wavelength_nm) == 1
    columns = [rays.position_mm, rays.direction, np.asarray(rays.flux_w)[:, None]]
    if each:
        columns.append(np.asarray(rays.wavelength_nm)[:, None])
    table = np.hstack(columns).astype("<f4")
    header = np.zeros((), HEADER)
    header["file_type"], header["version"], header["creation_method"] = b"TM25", VERSION, SIMULATED
    header["luminous_flux_lm"], header["radiant_flux_w"] = np.nan, table[:, 6].sum(dtype=float)
    header["rays"], header["created"] = len(table), created.isoformat(timespec="seconds").encode()
    header["spectrum"] = WAVELENGTH_EACH if each else ONE_WAVELENGTH
    header["wavelength_nm"] = np.nan if each else rays.wavelength_nm
    header["least_nm"] = table[:, 7].min() if each else np.nan
    header["largest_nm"] = table[:, 7].max() if each else np.nan
    header["flags"] = (1, 1, 1, int(each), 0, 0, 0, 0)
    header["descriptions"] = _codes(rays.descriptions)
    return header.tobytes() + table.tobytes()


def read_tm25(raw: bytes) -> RaySet:
    """The rays of a file with a radiant flux for each and one wavelength, or one for each.

    Raises InputError for another kind of file, for sizes that do not fit together, and for a total flux in the header
    that is known and not the sum of the rays. Nothing is allocated before the sizes are known to be the file's.
    """
    if len(raw) < HEADER.itemsize or raw[:4] != b"TM25":
        raise InputError("ray file", raw[:4], f"TM25 and a header of {HEADER.itemsize} bytes")
    header = np.frombuffer(raw, HEADER, 1)[0]
    _check_kind(header)
    each = bool(header["flags"][3])
    width, count = 7 + each, int(header["rays"])
    if not 1 <= count <= MAX_RAYS or len(raw) != HEADER.itemsize + 4 * width * count:
        allowed = f"{HEADER.itemsize} + {4 * width} for each of 1 to {MAX_RAYS} rays"
        raise InputError("ray file", f"{len(raw)} bytes, {count} rays", allowed, "the file was cut or edited")
    table = np.frombuffer(raw, "<f4", offset=HEADER.itemsize).reshape(count, width).astype(float)
    wavelength_nm = table[:, 7] if each else np.array(float(header["wavelength_nm"]))
    texts = (_text(codes) for codes in header["descriptions"])
    descriptions = {name: text for name, text in zip(DESCRIPTIONS, texts, strict=True) if text}
    rays = RaySet(table[:, :3], table[:, 3:6], table[:, 6], wavelength_nm, descriptions)
    total, declared = float(rays.flux_w.sum()), float(header["radiant_flux_w"])
    if declared > 0.0 and abs(declared - total) > FLUX_TOLERANCE * total:
        raise InputError("ray file", f"{declared:g} W in its header", f"the sum of its rays, {total:g} W")
    return rays


def _check_kind(header: Any) -> None:
    """InputError for a file of a kind that is not read here."""
    if header["version"] != VERSION:
        raise InputError("ray file", int(header["version"]), f"version {VERSION}")
    spectrum, flags = int(header["spectrum"]), header["flags"].tolist()
    if spectrum not in (ONE_WAVELENGTH, WAVELENGTH_EACH):
        raise InputError("ray file", f"spectrum {spectrum}", "1 (one wavelength) or 2 (one for each ray)")
    if flags != [1, 1, 1, int(spectrum == WAVELENGTH_EACH), 0, 0, 0, 0]:
        raise InputError("ray file", f"columns {flags}", "position, direction, radiant flux, wavelength if for each")
    for name in ("spectra", "further_columns", "further_text_bytes"):
        if header[name] != 0:
            raise InputError("ray file", f"{int(header[name])} {name}", "none")


def _codes(descriptions: Mapping[str, str]) -> NDArray[np.uint32]:
    """(9, 1000) characters, each text followed by zeros."""
    codes = np.zeros((len(DESCRIPTIONS), 1000), "<u4")
    for name, text in descriptions.items():
        if name not in DESCRIPTIONS or len(text) >= codes.shape[1]:
            raise InputError("descriptions", f"{name}: {text}", f"{', '.join(DESCRIPTIONS)}; at most 999 characters")
        codes[DESCRIPTIONS.index(name), : len(text)] = [ord(character) for character in text]
    return codes


def _text(codes: NDArray[np.uint32]) -> str:
    """The characters before the first zero; what is no character becomes a question mark."""
    end = int(np.argmin(codes != 0)) if (codes == 0).any() else codes.size
    return "".join(chr(code) if code < 0xD800 or 0xDFFF < code < 0x110000 else "?" for code in codes[:end].tolist())
