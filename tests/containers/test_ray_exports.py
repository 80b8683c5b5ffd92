"""IES and TM-25: what is written has the documented layout, is read back as it was, and keeps the flux."""

from __future__ import annotations

import datetime
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from containers.ray_tracing.exports import PhotometricWeb, RaySet, ies, photometric_web, read_ies, read_tm25, tm25
from containers.ray_tracing.far_field import FarField, far_field
from luxloop.errors import InputError

DAY = datetime.date(2026, 11, 21)
MOMENT = datetime.datetime(2026, 11, 21, 12, 0, tzinfo=datetime.UTC)


def field(lowest_cos: float = 0.0, rows: int = 40, columns: int = 32) -> FarField:
    """A smooth far field with a square's symmetry: cos theta (1 + 0.3 cos 4 phi sin^2 theta) above the horizon."""
    cosine = lowest_cos + (1.0 - lowest_cos) * (np.arange(rows) + 0.5) / rows
    phi = 2.0 * np.pi * (np.arange(columns) + 0.5) / columns
    shape = np.maximum(cosine, 0.0)[:, None] * (1.0 + 0.3 * np.outer(1.0 - cosine**2, np.cos(4.0 * phi))) / np.pi
    return far_field(np.stack([shape, shape]) * 2.0 * np.pi * (1.0 - lowest_cos) / shape.size, 1, lowest_cos)


def web(last_horizontal: float = 360.0, last_vertical: float = 90.0) -> PhotometricWeb:
    """A small web with different numbers everywhere."""
    vertical = np.linspace(0.0, last_vertical, 7)
    horizontal = np.linspace(0.0, last_horizontal, 5) if last_horizontal else np.zeros(1)
    candela = np.random.default_rng(1).random((horizontal.size, 7)) * 1e-3
    return PhotometricWeb(vertical, horizontal, candela, 28e-6, 30e-6, 35e-6, 0.125, {"LUMINAIRE": "one chip"})


# --- IES


def test_ies_text_has_the_documented_layout() -> None:
    """First line, required keywords, TILT=NONE, the ten numbers, the three, then one record for each horizontal."""
    text = ies(web(), DAY)
    lines = text.split("\r\n")
    assert lines[0] == "IES:LM-63-2019"
    assert "\n" not in text.replace("\r\n", "")
    assert [line.split("]")[0] + "]" for line in lines[1:5]] == ["[TEST]", "[TESTLAB]", "[ISSUEDATE]", "[MANUFAC]"]
    assert "[ISSUEDATE] 2026-11-21" in lines
    tilt = lines.index("TILT=NONE")
    assert lines[tilt + 1] == "1 -1 1 7 5 1 2 0.000028 0.00003 0.000035"
    assert lines[tilt + 2] == "1 1.00010 0.125"
    assert lines[tilt + 3] == "0 15 30 45 60 75 90"
    assert lines[tilt + 4] == "0 90 180 270 360"
    assert len(lines) == tilt + 5 + 5 + 1
    assert lines[-1] == ""


def test_ies_lines_stay_within_the_limit() -> None:
    """At most 132 characters, plain ASCII, no exponents, for the default angles of a whole sphere."""
    text = ies(photometric_web(field(-1.0), 1e-4), DAY)
    assert max(map(len, text.split("\r\n"))) <= 132
    assert text.isascii()
    assert "e-" not in text.split("TILT=NONE")[1]


@pytest.mark.parametrize("last_horizontal", [0.0, 90.0, 180.0, 360.0])
@pytest.mark.parametrize("last_vertical", [90.0, 180.0])
def test_ies_text_reads_back_as_the_web(last_horizontal: float, last_vertical: float) -> None:
    """Angles, candela to eight digits, dimensions, input power and keywords."""
    written = web(last_horizontal, last_vertical)
    read = read_ies(ies(written, DAY))
    assert np.allclose(read.vertical_deg, written.vertical_deg, rtol=1e-7)
    assert np.array_equal(read.horizontal_deg, written.horizontal_deg)
    assert np.allclose(read.intensity_cd, written.intensity_cd, rtol=1e-7)
    assert (read.width_m, read.length_m, read.height_m, read.input_w) == (28e-6, 30e-6, 35e-6, 0.125)
    assert read.keywords["LUMINAIRE"] == "one chip"
    assert read.keywords["MANUFAC"] == "luxloop"


def test_ies_reader_reads_another_programs_file() -> None:
    """Feet, multiplier, commas, [MORE], lines broken anywhere: the example of a public explanation, shortened."""
    text = (
        "IESNA:LM-63-2002\n[TEST] 12\n[MANUFAC] Somebody\n[MORE] and Sons\nTILT=NONE\n"
        "1 1000 2.0 3 1 1 1\n -1.0 -1.0 0\n1.0 1.0 12\n0, 45\n90\n0\n100 70\n0\n"
    )
    read = read_ies(text)
    assert read.keywords["MANUFAC"] == "Somebody and Sons"
    assert read.width_m == pytest.approx(-0.3048)
    assert np.array_equal(read.intensity_cd, [[200.0, 140.0, 0.0]])


def test_web_flux_of_known_webs() -> None:
    """1 cd all round is 4 pi lm, 1 cd in the lower half 2 pi, for every symmetry; Lambert gives pi at fine steps."""
    for last in (0.0, 90.0, 180.0, 360.0):
        for bottom, expected in ((180.0, 4.0 * np.pi), (90.0, 2.0 * np.pi)):
            flat = web(last, bottom)
            assert replace(flat, intensity_cd=np.ones_like(flat.intensity_cd)).flux_lm() == pytest.approx(expected)
    vertical = np.linspace(0.0, 90.0, 181)
    lambert = PhotometricWeb(vertical, np.zeros(1), np.cos(np.radians(vertical))[None, :])
    assert lambert.flux_lm() == pytest.approx(np.pi, rel=1e-4)


@pytest.mark.parametrize("eightfold", [True, False])
@pytest.mark.parametrize("lowest_cos", [0.0, -1.0])
def test_web_keeps_the_flux_of_the_far_field(lowest_cos: float, eightfold: bool) -> None:
    """The web's own integral is the far field's total to 0.2 %; folded files have a quarter of the angles."""
    far = field(lowest_cos)
    made = photometric_web(far, 0.03, eightfold=eightfold)
    assert made.flux_lm() == pytest.approx(0.03 * far.flux()[0], rel=2e-3)
    assert made.vertical_deg[-1] == (90.0 if lowest_cos == 0.0 else 180.0)
    assert made.horizontal_deg[-1] == (90.0 if eightfold else 360.0)
    assert np.allclose(made.intensity_cd[0], made.intensity_cd[-1], atol=1e-12)


def test_web_is_turned_about_its_x_axis() -> None:
    """Light towards +y (phi 90) hangs down and lies at horizontal 270; light towards the receiver at vertical 0."""
    weights = np.zeros((2, 8, 16))
    weights[:, :, 3:5] = 1.0
    made = photometric_web(far_field(weights, 1), 1.0, horizontal_deg=[0.0, 90.0, 180.0, 270.0, 360.0])
    middle = made.vertical_deg.size // 2
    assert made.intensity_cd[3, middle] > 0.0
    assert made.intensity_cd[[0, 1, 2, 4], middle].max() == 0.0
    up = np.zeros((2, 8, 16))
    up[:, -1] = 1.0
    assert np.argmax(photometric_web(far_field(up, 1), 1.0).intensity_cd[0]) == 0


def test_another_reader_finds_the_same_numbers(tmp_path: Path) -> None:
    """photompy, where it is installed: angles, candela, and its own integral of the flux to 0.5 %."""
    photompy = pytest.importorskip("photompy")
    made = photometric_web(field(), 0.03, 28e-6, 28e-6, 35e-6, eightfold=True)
    (tmp_path / "chip.ies").write_text(ies(made, DAY), newline="")
    other = photompy.IESFile.read(tmp_path / "chip.ies")
    assert np.allclose(other.photometry.thetas, made.vertical_deg)
    assert np.allclose(other.photometry.phis, made.horizontal_deg)
    assert np.allclose(other.photometry.values, made.intensity_cd, rtol=1e-6)
    assert other.photometry.total_optical_power() == pytest.approx(made.flux_lm(), rel=5e-3)
    assert (other.header.width, other.header.height, int(other.header.units)) == (28e-6, 35e-6, 2)


GOOD = ies(web(), DAY)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "first line"),
        (GOOD.replace("IES:LM-63-2019", "hello"), "first line"),
        (GOOD.replace("TILT=NONE", "TILT=INCLUDE"), "TILT"),
        (GOOD.replace("TILT=NONE", "TELT"), "TILT"),
        (GOOD.replace("1 -1 1 7 5 1 2", "1 -1 1 7 5 2 2"), "type 2"),
        (GOOD.replace("1 -1 1 7 5 1 2", "1 -1 1 7 5 1 3"), "unit 3"),
        (GOOD.replace("1 -1 1 7 5 1 2", "1 -1 1 7 500000000000 1 2"), "cut or edited"),
        (GOOD.replace("1 -1 1 7 5 1 2", "1 -1 1 -7 5 1 2"), "cut or edited"),
        (GOOD.replace("0 15 30", "0 30 15"), "ascending"),
        (GOOD.replace("0 15 30", "0 x 30"), "numbers"),
        (GOOD.replace("0 15 30", "0 nan 30"), "finite"),
        (GOOD[: len(GOOD) - 30], "cut or edited"),
    ],
)
def test_ies_reader_refuses_what_it_cannot_read(text: str, what: str) -> None:
    """Each names what is wrong."""
    with pytest.raises(InputError, match=what):
        read_ies(text)


def test_ies_writer_refuses_what_a_file_cannot_hold() -> None:
    """Angles that end elsewhere, negative or missing candela, keywords of two lines or too long."""
    with pytest.raises(InputError, match="vertical_deg"):
        ies(replace(web(), vertical_deg=np.linspace(0.0, 80.0, 7)), DAY)
    with pytest.raises(InputError, match="intensity_cd"):
        ies(replace(web(), intensity_cd=-web().intensity_cd), DAY)
    with pytest.raises(InputError, match="intensity_cd"):
        ies(replace(web(), intensity_cd=web().intensity_cd[:3]), DAY)
    for value in ("a\nTILT=NONE", "x" * 200, "µ"):
        with pytest.raises(InputError, match="keywords"):
            ies(replace(web(), keywords={"OTHER": value}), DAY)


# --- TM-25


def rays(count: int = 100, each: bool = False) -> RaySet:
    """Rays from a small box in all directions."""
    rng = np.random.default_rng(2)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    wavelength = rng.normal(445.0, 7.6, count) if each else np.array(445.0)
    texts = {"light source": "chip W 28 um, T 35 um", "software": "luxloop", "geometry": "z = 0: substrate µ"}
    return RaySet(rng.random((count, 3)) * 0.035, direction, rng.random(count) * 1e-9, wavelength, texts)


@pytest.mark.parametrize("each", [False, True])
def test_tm25_reads_back_as_the_rays(each: bool) -> None:
    """Positions, directions, fluxes and wavelengths to single precision, descriptions as they were."""
    written, read = rays(each=each), read_tm25(tm25(rays(each=each), MOMENT))
    for name in ("position_mm", "direction", "flux_w", "wavelength_nm"):
        assert np.array_equal(getattr(read, name), np.asarray(getattr(written, name), np.float32).astype(float))
    assert read.descriptions == written.descriptions


@pytest.mark.parametrize("each", [False, True])
def test_tm25_has_the_documented_offsets(each: bool) -> None:
    """Every field where the table of the format says, read here by its offset alone."""
    written = rays(100, each)
    raw = tm25(written, MOMENT)
    width = 8 if each else 7
    assert raw[:4] == b"TM25"
    assert struct.unpack_from("<ii", raw, 4) == (2013, 0)
    luminous, radiant, count = struct.unpack_from("<ffQ", raw, 12)
    assert np.isnan(luminous)
    assert count == 100
    assert raw[28:56].rstrip(b"\0") == b"2026-11-21T12:00:00+00:00"
    assert struct.unpack_from("<ii", raw, 56) == (0, 2 if each else 1)
    one, least, largest = struct.unpack_from("<fff", raw, 64)
    assert np.isnan([one, least, largest]).tolist() == ([True, False, False] if each else [False, True, True])
    assert struct.unpack_from("<iii", raw, 76) == (0, 0, 0)
    assert raw[88:256] == bytes(168)
    assert struct.unpack_from("<8i", raw, 256) == (1, 1, 1, int(each), 0, 0, 0, 0)
    assert raw[288 : 288 + 4 * 5].decode("utf-32-le") == "chip "
    assert len(raw) == 36288 + 4 * width * 100
    table = np.frombuffer(raw, "<f4", offset=36288).reshape(100, width)
    assert np.float32(table[:, 6].sum(dtype=float)) == np.float32(radiant)
    assert np.array_equal(table[:, :3], written.position_mm.astype(np.float32))


def test_tm25_flux_in_the_header_is_the_sum_of_the_rays() -> None:
    """For rays whose fluxes span ten decades too."""
    source = rays(1000)
    raw = tm25(replace(source, flux_w=10.0 ** np.linspace(-10.0, 0.0, 1000)), MOMENT)
    assert struct.unpack_from("<f", raw, 16)[0] == pytest.approx(read_tm25(raw).flux_w.sum(), rel=1e-7)


def edited(offset: int, form: str, *values: float) -> bytes:
    """A good file with some header field replaced."""
    raw = bytearray(tm25(rays(), MOMENT))
    struct.pack_into(form, raw, offset, *values)
    return bytes(raw)


@pytest.mark.parametrize(
    ("raw", "what"),
    [
        (b"", "TM25"),
        (b"TM25" + bytes(100), "TM25"),
        (b"PK" + bytes(40_000), "TM25"),
        (edited(4, "<i", 2020), "version"),
        (edited(16, "<f", 1.0), "sum of its rays"),
        (edited(20, "<Q", 99), "cut or edited"),
        (edited(20, "<Q", 1 << 60), "cut or edited"),
        (edited(20, "<Q", 0), "cut or edited"),
        (edited(60, "<i", 3), "spectrum 3"),
        (edited(60, "<i", 2), "columns"),
        (edited(64, "<f", -445.0), "wavelength_nm"),
        (edited(76, "<i", 1), "1 spectra"),
        (edited(80, "<i", 1), "1 further_columns"),
        (edited(84, "<i", 32), "32 further_text_bytes"),
        (edited(264, "<iii", 0, 0, 1), "columns"),
        (edited(36288, "<f", float("nan")), "position_mm"),
        (edited(36288 + 12, "<f", 5.0), "length of direction"),
        (edited(36288 + 24, "<f", -1.0), "flux_w"),
        (tm25(rays(), MOMENT)[:-1], "cut or edited"),
    ],
)
def test_tm25_reader_refuses_what_it_cannot_read(raw: bytes, what: str) -> None:
    """Each names what is wrong; a count of 2^60 rays allocates nothing."""
    with pytest.raises(InputError, match=what):
        read_tm25(raw)


@settings(derandomize=True, max_examples=60)
@given(st.integers(0, 300), st.binary(min_size=1, max_size=8))
def test_tm25_reader_never_breaks_on_a_damaged_header(offset: int, patch: bytes) -> None:
    """Any bytes anywhere in the header: rays or an InputError, nothing else."""
    raw = bytearray(tm25(rays(10), MOMENT))
    raw[offset : offset + len(patch)] = patch
    try:
        assert len(read_tm25(bytes(raw)).flux_w) == 10
    except InputError as error:
        assert error.field  # noqa: PT017  # either outcome is right; what matters is that there is no third


def test_tm25_unknown_total_of_another_program_is_read() -> None:
    """nan in the header means not known: the rays say."""
    assert read_tm25(edited(16, "<f", float("nan"))).flux_w.sum() == pytest.approx(rays().flux_w.sum(), rel=1e-6)


def test_rays_that_cannot_be() -> None:
    """Wrong shapes, directions that are no unit vectors, negative fluxes, texts that do not fit."""
    good = rays()
    for name, value in {
        "position_mm": good.position_mm[:5],
        "direction": 2.0 * good.direction,
        "flux_w": -good.flux_w,
        "wavelength_nm": np.array([445.0, 446.0]),
    }.items():
        with pytest.raises(InputError, match=name):
            replace(good, **{name: value})
    for texts in ({"colour": "blue"}, {"remarks": "x" * 1000}):
        with pytest.raises(InputError, match="descriptions"):
            tm25(replace(good, descriptions=texts), MOMENT)
