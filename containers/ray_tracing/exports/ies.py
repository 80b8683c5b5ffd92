"""Luminous intensity against direction as an ANSI/IES LM-63-2019 text (`*.ies`): type C, absolute candela, metres.

    IES:LM-63-2019                                  first line, marks the version
    [TEST] [TESTLAB] [ISSUEDATE] [MANUFAC]          required keywords, then optional ones, [OTHER] for remarks
    TILT=NONE
    1 -1 1 verticals horizontals 1 2 width length height
    1 1.00010 watt                                  ballast factor, how the file came to be, input power
    vertical angles; horizontal angles; the candela of all verticals at the first horizontal, the second, ...

The ten numbers: lamps, lumens per lamp (-1: absolute photometry), multiplier, counts of the angles, photometric type
(1: C), unit (2: metres), luminous width, length, height along y, x, z. 1.00010 is "computer simulation". Horizontal
angles end at 0 (the same all round), 90 (mirrored in both planes), 180 (in one) or 360. Lines end with CR LF and are
at most 132 characters long, the shortest limit of all versions of the standard.

Sources: the blog of ANSI on LM-63-19 (first line), the format pages of AGi32 (order of the numbers, meaning of width,
length, height), the text of LM-63-2002 (angles, line length), the open readers eulumdat-rs and photompy (required
keywords, file generation types). Not verified against the paid text of 2019; on the digits of the generation type the
two readers disagree: 1.00010 is a simulation to eulumdat-rs, which quotes the standard's table, while photompy takes
it as "interpolated" and looks for 1.01000.

Axes: photometric zero (vertical 0) is the direction of the receiver, our +z. The luminaire of such a file shines
down, so the module is turned about its x axis; the file's horizontal angle h is our phi = -h.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from containers.checked import Real, within
from containers.ray_tracing.far_field import FarField
from luxloop.errors import InputError

FIRST_LINE = "IES:LM-63-2019"
READ_FIRST_LINES = (FIRST_LINE, "IESNA:LM-63-2002", "IESNA:LM-63-1995")
REQUIRED = ("TEST", "TESTLAB", "ISSUEDATE", "MANUFAC")
SIMULATED = "1.00010"
LAST_HORIZONTAL_DEG = (0.0, 90.0, 180.0, 360.0)
LINE_CHARACTERS = 132
DIGITS = 8
NOTHING = 1e-30
MAX_CHARACTERS = 16 << 20
MAX_ANGLES = 10_000
METRES = {1: 0.3048, 2: 1.0}
VERTICAL_STEP_DEG, HORIZONTAL_STEP_DEG = 1.0, 7.5
REMARK = "no laboratory: computed by luxloop"


@dataclass(frozen=True)
class PhotometricWeb:
    """What such a file holds."""

    vertical_deg: Real
    """(vertical,), ascending, from 0 to 90 or 180."""
    horizontal_deg: Real
    """(horizontal,), ascending, from 0 to 0, 90, 180 or 360."""
    intensity_cd: Real
    """(horizontal, vertical)."""
    width_m: float = 0.0
    length_m: float = 0.0
    height_m: float = 0.0
    """Luminous dimensions along y, x and z; all 0 for a point."""
    input_w: float = 0.0
    keywords: Mapping[str, str] = field(default_factory=dict)

    def flux_lm(self) -> float:
        """Luminous flux, the intensity being linear in both angles between its nodes.

        The integral of I sin(vertical) is exact for that; of horizontal angles the symmetry supplies the rest.
        """
        around = np.radians(self.horizontal_deg)
        if around.size == 1:
            mean = self.intensity_cd[0]
        else:
            pairs = 0.5 * (self.intensity_cd[1:] + self.intensity_cd[:-1])
            mean = np.diff(around) @ pairs / around[-1]
        return float(2.0 * np.pi * mean @ _sine_weights(np.radians(self.vertical_deg)))


def photometric_web(
    far: FarField,
    flux_lm: float,
    width_m: float = 0.0,
    length_m: float = 0.0,
    height_m: float = 0.0,
    *,
    eightfold: bool = False,
    vertical_deg: ArrayLike | None = None,
    horizontal_deg: ArrayLike | None = None,
) -> PhotometricWeb:
    """The web of a far field.

    Parameters
    ----------
    far : per chip flux.
    flux_lm : luminous flux of one chip, from `far_field.luminous_flux_lm`.
    width_m, length_m, height_m : luminous dimensions along y, x, z: of the chip, or of the module.
    eightfold : fold by the symmetry of a square, and write only horizontal angles 0 to 90.
    vertical_deg, horizontal_deg : by default every degree to 90 (upper half) or 180, and every 7.5 degrees.

    Notes
    -----
    Between its angles a reader interpolates the intensity, so its total differs from the far field's: compare
    `flux_lm()` of the result with `flux_lm` x `far.flux()`. A far field of the upper half ends at 90 degrees.
    """
    last = 90.0 if far.lowest_cos == 0.0 else 180.0
    around = 90.0 if eightfold else 360.0
    down = np.linspace(0.0, last, round(last / VERTICAL_STEP_DEG) + 1) if vertical_deg is None else vertical_deg
    if horizontal_deg is None:
        horizontal_deg = np.linspace(0.0, around, round(around / HORIZONTAL_STEP_DEG) + 1)
    vertical = within("vertical_deg", down, 0.0, last, "angles from the direction of the receiver")
    horizontal = within("horizontal_deg", horizontal_deg, 0.0, around, "0 to 90 where eightfold, else 0 to 360")
    source = far.folded() if eightfold else far
    relative = source.at(np.radians(vertical)[None, :], -np.radians(horizontal)[:, None])
    web = PhotometricWeb(vertical, horizontal, flux_lm * relative, width_m, length_m, height_m)
    _check(web)
    return web


def ies(web: PhotometricWeb, issued: datetime.date) -> str:
    """The text of a web. Its `keywords` go before ours; the required ones that it lacks are filled in.

    Raises InputError for angles or values that such a file cannot hold, and keywords that do not fit into a line.
    """
    _check(web)
    keywords = dict.fromkeys(REQUIRED, REMARK) | {"ISSUEDATE": issued.isoformat(), "MANUFAC": "luxloop"}
    lines = [FIRST_LINE, *(_keyword_line(*item) for item in (keywords | dict(web.keywords)).items()), "TILT=NONE"]
    counts = (web.vertical_deg.size, web.horizontal_deg.size)
    size_m = (web.width_m, web.length_m, web.height_m)
    lines += _wrapped(["1", "-1", "1", *map(str, counts), "1", "2", *map(_decimal, size_m)])
    lines += _wrapped(["1", SIMULATED, _decimal(web.input_w)])
    for row in (web.vertical_deg, web.horizontal_deg, *web.intensity_cd):
        lines += _wrapped([_decimal(value) for value in row])
    return "\r\n".join(lines) + "\r\n"


def read_ies(text: str) -> PhotometricWeb:
    """The web of a text, of ours or another's: type C without tilt, any unit, multiplier and ballast factor applied.

    Raises InputError that names what cannot be read.
    """
    if len(text) > MAX_CHARACTERS:
        raise InputError("ies file", f"{len(text)} characters", f"at most {MAX_CHARACTERS}")
    lines = text.splitlines()
    if not lines or lines[0].strip() not in READ_FIRST_LINES:
        raise InputError("ies file", lines[:1], " or ".join(READ_FIRST_LINES) + " in its first line")
    tilts = [k for k, line in enumerate(lines) if line.replace(" ", "").startswith("TILT=")]
    if not tilts or lines[tilts[0]].replace(" ", "") != "TILT=NONE":
        raise InputError("ies file", [lines[k] for k in tilts], "TILT=NONE", "a source that is tilted is not read")
    web = _numbers(" ".join(lines[tilts[0] + 1 :]).replace(",", " ").split(), _keywords(lines[1 : tilts[0]]))
    _check(web)
    return web


def _numbers(words: list[str], keywords: Mapping[str, str]) -> PhotometricWeb:
    """What follows the TILT line."""
    try:
        values = np.array(words, float)
    except ValueError as error:
        raise InputError("ies file", words[:4], "numbers after the TILT line", str(error)) from error
    if values.size < 13 or not np.isfinite(values).all():
        raise InputError("ies file", f"{values.size} numbers", "13 or more, finite", "the file was cut or edited")
    multiplier, kind, unit, ballast = values[2], values[5], values[6], values[10]
    if kind != 1 or unit not in METRES:
        raise InputError("ies file", f"type {kind:g}, unit {unit:g}", "type 1 (C), unit 1 (feet) or 2 (metres)")
    verticals, horizontals = (int(count) if 1 <= count <= MAX_ANGLES else 0 for count in values[3:5])
    wanted = 13 + verticals + horizontals + verticals * horizontals
    if not verticals or not horizontals or values.size != wanted:
        what = f"{values.size} numbers for {values[3]:g} x {values[4]:g} angles"
        raise InputError("ies file", what, f"{wanted}", "the file was cut or edited")
    vertical, horizontal, candela = np.split(values[13:], [verticals, verticals + horizontals])
    intensity_cd = candela.reshape(horizontals, verticals) * multiplier * ballast
    width_m, length_m, height_m = values[7:10] * METRES[int(unit)]
    return PhotometricWeb(vertical, horizontal, intensity_cd, width_m, length_m, height_m, values[12], keywords)


def _keywords(lines: list[str]) -> dict[str, str]:
    """Keywords with their text; [MORE] continues the one before, of one given twice the last counts."""
    found: dict[str, str] = {}
    last = ""
    for line in lines:
        name, closed, value = line.strip().removeprefix("[").partition("]")
        if not closed:
            continue
        if name == "MORE" and last:
            found[last] += " " + value.strip()
        else:
            last = name
            found[name] = value.strip()
    return found


def _keyword_line(name: str, value: str) -> str:
    line = f"[{name}] {value}"
    if (
        len(line) > LINE_CHARACTERS
        or not line.isascii()
        or not line.isprintable()
        or not name
        or set("[]") & set(name)
    ):
        raise InputError("keywords", line, f"one line of at most {LINE_CHARACTERS} printable ASCII characters")
    return line


def _decimal(value: float) -> str:
    """A number without an exponent, which some readers do not know; what is below 1e-30 is 0."""
    value = value if abs(value) > NOTHING else 0.0
    return str(np.format_float_positional(value, precision=DIGITS, unique=False, fractional=False, trim="-"))


def _wrapped(words: list[str]) -> list[str]:
    """Lines of words that stay within the limit; a record begins on a line of its own and may run over several."""
    lines = [words[0]]
    for word in words[1:]:
        if len(lines[-1]) + 1 + len(word) > LINE_CHARACTERS:
            lines.append(word)
        else:
            lines[-1] += " " + word
    return lines


def _sine_weights(angle: Real) -> Real:
    """Weights w with w @ I the integral of I sin(angle), I being linear between the angles."""
    low, high = angle[:-1], angle[1:]
    falling = np.cos(low) - (np.sin(high) - np.sin(low)) / (high - low)
    rising = (np.sin(high) - np.sin(low)) / (high - low) - np.cos(high)
    return np.asarray(np.append(falling, 0.0) + np.append(0.0, rising))


def _check(web: PhotometricWeb) -> None:
    """InputError for a web that such a file cannot hold."""
    vertical, horizontal = web.vertical_deg, web.horizontal_deg
    for name, angles, ends in (
        ("vertical_deg", vertical, (90.0, 180.0)),
        ("horizontal_deg", horizontal, LAST_HORIZONTAL_DEG),
    ):
        if angles.ndim != 1 or not 1 <= angles.size <= MAX_ANGLES or np.any(np.diff(angles) <= 0.0):
            raise InputError(name, angles.shape, f"1 to {MAX_ANGLES} ascending angles")
        if angles[0] != 0.0 or angles[-1] not in ends:
            raise InputError(
                name, (angles[0], angles[-1]), f"from 0 to one of {', '.join(f'{end:g}' for end in ends)}"
            )
    if web.intensity_cd.shape != (horizontal.size, vertical.size):
        raise InputError("intensity_cd", web.intensity_cd.shape, f"({horizontal.size}, {vertical.size})")
    within("intensity_cd", web.intensity_cd, 0.0, 1e12, "intensities are finite and not negative")
    within("luminous dimensions", [web.width_m, web.length_m, web.height_m], -1e6, 1e6, "metres")
    within("input_w", web.input_w, 0.0, 1e12, "watts")
