"""Exports: what is written is read back as it was, powers are kept, and what is lost is said with its size."""

from __future__ import annotations

import functools
import xml.etree.ElementTree as Xml
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from containers.bsdf import (
    Bsdf,
    Coated,
    Fresnel,
    GaussianLobe,
    Lambertian,
    Mirror,
    Mixture,
    SpecularTable,
    Tabulated,
    direction_of,
)
from containers.film_export import FORMATS, export_table
from containers.thin_film.exports import (
    coated_surface,
    opticstudio,
    radiance_xml,
    read_opticstudio,
    read_radiance_xml,
    read_speos,
    speos,
)
from containers.thin_film.exports.radiance_xml import klems, projected_sr
from containers.thin_film.scatter import AbcSpectrum
from containers.thin_film.surface import averaging_loss, film_bsdf
from containers.thin_film.table import Side
from luxloop.errors import InputError
from tests.films import DEG, dispersive, film, line_average, tmm_powers

# --- Speos


@pytest.mark.parametrize("side", ["inside", "outside"])
def test_speos_text_reads_back_as_the_table(side: Side) -> None:
    """R and T of both polarisations come back to 1e-12, from both sides, at the table's own angles."""
    surface, again = coated_surface(film(), side), read_speos(speos(film(), side).text)
    assert np.allclose(again.wavelength_nm, surface.wavelength_nm, rtol=1e-9)
    assert np.allclose(again.aoi_deg, surface.aoi_deg, rtol=1e-9)
    assert np.abs(again.R - surface.R).max() < 1e-12
    assert np.abs(again.T - surface.T).max() < 1e-12


def test_speos_text_has_the_documented_layout() -> None:
    """Header, comment, counts, wavelengths every second column, then a P row with the angle and an S row without."""
    lines = speos(film(), "outside", [0.0, 50.0]).text.splitlines()
    assert lines[0] == "OPTIS - Coated surface file v1.0"
    assert "\t" not in "".join(lines[:3])
    assert lines[2] == "2 21"
    assert lines[3].startswith("\t400\t\t")
    assert len(lines) == 4 + 2 * 2
    assert [line.split("\t")[0] for line in lines[4:]] == ["0", "", "50", ""]
    p_row, s_row = (np.array(lines[k].split("\t")[1:-1], float) for k in (6, 7))
    assert np.all(s_row[0::2] > p_row[0::2])  # s reflects more than p at 50 deg, at every wavelength
    assert np.allclose(p_row[0::2] + p_row[1::2], 100.0)


def test_speos_reader_reads_the_makers_example() -> None:
    """The example of the maker's public article, 4 angles and 3 wavelengths: 480 nm at 50 deg reflects 11.3 %."""
    rows = {0: (31.9, 68.1, 1.5, 98.5), 50: (11.3, 88.7, 11.4, 88.6), 90: (100, 0, 100, 0)}
    text = "OPTIS - Coated surface file v1.0\nCoating File Example\n3 2\n\t480\t\t580\t\t\n"
    for angle, row in rows.items():
        line = "\t".join(map(str, row))
        text += f"{angle}\t{line}\t\n\t{line}\t\n"
    surface = read_speos(text)
    assert surface.R.shape == (2, 2, 3)
    assert surface.R[0, :, 1] == pytest.approx([0.113, 0.113])
    assert surface.T[1, :, 0] == pytest.approx([0.985, 0.985])


def test_speos_reader_believes_no_counts_that_the_text_cannot_hold() -> None:
    """Before anything is laid out for them: 30,000 angles and wavelengths are 29 GB."""
    text = "OPTIS - Coated surface file v1.0\nmine\n30000 30000\n" + "1 " * 30000 + "\n0" * 60001
    with pytest.raises(InputError, match="it was cut short") as error:
        read_speos(text)
    assert error.value.field == "coated file, line 3"


def test_speos_says_how_much_scatter_and_interpolation_cost() -> None:
    """A rough film's scatter is named with its size; own angles err by less than 1e-3, 5 deg steps by half."""
    rough, smooth = speos(film(5.5, 5.0), "inside"), speos(film(), "inside")
    assert smooth.lost["scatter_ratio"] == 0.0
    assert 0.02 < rough.lost["scatter_ratio"] < 1.0
    assert f"scatter {rough.lost['scatter_ratio']:.3g}" in rough.text.splitlines()[1]
    assert smooth.lost["interpolation_ratio"] < 1e-3
    coarse = speos(film(), "inside", np.arange(0.0, 90.1, 5.0))
    assert coarse.lost["interpolation_ratio"] > 0.5
    assert speos(film(), "outside", [0.0, 50.0]).lost["interpolation_ratio"] > 0.5  # R is 1 at 90 deg


@pytest.mark.parametrize("side", ["inside", "outside"])
def test_speos_file_of_a_dispersive_film_interpolates_to_the_independent_program(side: Side) -> None:
    """At 400, 445 and 490 nm and 60 angles, most about the critical ones: within what `lost` says, below 1e-3."""
    export = speos(dispersive(), side)
    file = read_speos(export.text)
    assert file.aoi_deg[[0, -1]].tolist() == [0.0, 90.0]
    assert file.R[:, :, -1] == pytest.approx(np.ones((21, 2)))
    about = (22.0, 25.0) if side == "inside" else (80.0, 89.9)
    rng = np.random.default_rng(4)
    worst = 0.0
    for w in (0, 10, 20):
        for theta in [*rng.uniform(0.0, 89.9, 20), *rng.uniform(*about, 40)]:
            powers = tmm_powers(dispersive(), side, float(file.wavelength_nm[w]), theta)
            for p in (0, 1):
                read = [float(np.interp(theta, file.aoi_deg, power[w, p])) for power in (file.R, file.T)]
                worst = max(worst, float(np.abs(np.subtract(read, powers[p])).max()))
    assert worst < export.lost["interpolation_ratio"] + 1e-6
    assert export.lost["interpolation_ratio"] < 1e-3


def test_speos_file_holds_the_reflectance_itself_at_its_own_angles() -> None:
    """At 23.23 deg from GaN, 400 nm, where the table's nodes are off by 3e-3, the file is that of the program."""
    surface = coated_surface(dispersive(), "inside", [23.0, 23.23])
    exact = tmm_powers(dispersive(), "inside", float(surface.wavelength_nm[3]), 23.23)
    assert surface.R[3, :, 1] == pytest.approx([powers[0] for powers in exact], abs=1e-10)


def test_speos_of_the_golden_anchor() -> None:
    """445 nm, 5.5 pairs, 20 deg from GaN: R_s 0.75467131, R_p 0.29040285 (golden film table)."""
    again = read_speos(speos(film(), "inside", [0.0, 20.0]).text)
    at = int(np.argmin(np.abs(again.wavelength_nm - 445.0)))
    assert again.R[at, :, 1] == pytest.approx([0.75467131, 0.29040285], abs=2e-4)


# --- OpticStudio


@pytest.mark.parametrize("scatter_type", ["BRDF", "BTDF"])
def test_opticstudio_text_reads_back(scatter_type: str) -> None:
    """Axes, TIS and values come back as written; TIS is the power on that side."""
    surface = Mixture((GaussianLobe(0.8, 15 * DEG), Lambertian(0.2, 0.6), Mirror(0.5)), (0.5, 0.4, 0.1))
    angles = np.arange(0.0, 81.0, 10.0)
    export = opticstudio(surface, scatter_type, angles)  # type: ignore[arg-type]  # one of the two words
    file = read_opticstudio(export.text)
    assert file.scatter_type == scatter_type
    assert file.values.shape == (file.specular_deg.size, file.azimuth_deg.size, file.radial_deg.size)
    power = 0.5 * 0.8 + 0.4 * 0.2 + 0.1 * 0.5 if scatter_type == "BRDF" else 0.4 * 0.6
    assert file.tis == pytest.approx(np.full(file.tis.size, power), abs=2e-3)
    assert np.abs(file.integrals() - file.tis).max() < 1e-3
    assert export.lost["grid_ratio"] < 0.03


def test_opticstudio_is_about_the_specular_ray_with_azimuth_zero_to_the_normal() -> None:
    """At specular 40 deg, azimuth 0 and radial 40 the value is the bsdf along the normal, at azimuth 180 below it."""
    lobe = GaussianLobe(0.9, 20 * DEG)
    file = read_opticstudio(opticstudio(lobe, "BRDF", [0.0, 40.0]).text)
    at_40, at_45 = (int(np.flatnonzero(file.radial_deg == radial)[0]) for radial in (40, 45))
    for azimuth, radial, theta in ((0, at_40, 0.0), (-1, at_45, 85.0), (0, 0, 40.0), (9, 0, 40.0)):
        exact = float(lobe.evaluate(40 * DEG, direction_of(theta * DEG, 0.0)))
        assert file.values[1, azimuth, radial] == pytest.approx(exact, rel=1e-2)  # scaled to hold the exact power


def test_opticstudio_angle_of_incidence_is_the_transmitted_angle() -> None:
    """From GaN to air the file's 60 deg holds the power of light that meets the face at 20.4 deg."""
    face = Fresnel(2.4869, 1.0)
    export = opticstudio(face, "BTDF", [0.0, 60.0])
    expected = [float(face.deltas(np.arcsin(np.sin(a * DEG) / 2.4869)).refracted) for a in (0.0, 60.0)]
    assert read_opticstudio(export.text).tis == pytest.approx(expected, abs=1e-8)
    assert export.lost["delta_spread_deg"] == 1.0
    assert export.lost["delta_power_ratio"] == pytest.approx(max(expected))
    with pytest.raises(InputError, match=r"up to 23\.71 deg"):
        opticstudio(Fresnel(1.0, 2.4869), "BTDF", [0.0, 60.0])


def test_opticstudio_of_a_rough_film_names_what_is_lost() -> None:
    """Scatter of the film is carried, its specular part spread; polarisation and wavelength are named with sizes."""
    table = film(5.5, 5.0)
    faces = AbcSpectrum(correlation_length_nm=300.0)
    surface, averaged = film_bsdf(table, "outside", faces), averaging_loss(table, "outside", faces)
    export = opticstudio(surface, "BRDF", [0.0, 30.0, 60.0], also_lost=averaged)
    file, powers = read_opticstudio(export.text), table.average("outside")
    for k, angle in enumerate((0.0, 30.0, 60.0)):
        u = np.sin(angle * DEG)
        assert file.tis[k] == pytest.approx(float(table.at(powers.R + powers.S_R, u)), abs=5e-4)
    of_file = {"delta_spread_deg", "delta_power_ratio", "grid_ratio", "between_angles_ratio"}
    assert set(export.lost) == {"polarisation_ratio", "wavelength_ratio", *of_file}
    words = export.text.splitlines()[0]
    assert all(f"{name.rpartition('_')[0]} {size:.3g}" in words for name, size in export.lost.items())
    assert "delta_spread 1 deg" in words


def test_opticstudio_file_follows_the_film_through_its_critical_angle() -> None:
    """Read linearly between its angles, the file's power from inside is the film's to 0.01, as `lost` says.

    With an angle every 5 deg it misses the rise to total reflection by 0.3, and says so.
    """
    surface = film_bsdf(film(), "inside")
    export = opticstudio(surface, "BRDF")
    file = read_opticstudio(export.text)
    theta = np.concatenate([np.linspace(0.0, 88.9, 300), np.linspace(22.5, 24.5, 300)])
    step = 1.0 * DEG
    cone = np.pi / 2 * np.cos(theta * DEG) * (1.0 - np.sin(2 * step) / (2 * step))  # whole below 89 deg
    read = np.interp(theta, file.specular_deg, file.values[:, 0, 0]) * cone
    worst = np.abs(read - surface.deltas(theta * DEG).mirror).max()
    assert worst < 1.1 * export.lost["between_angles_ratio"]  # found at other angles
    assert export.lost["between_angles_ratio"] + export.lost["grid_ratio"] < 0.01
    assert file.specular_deg[[0, -1]].tolist() == [0.0, 90.0]
    assert opticstudio(surface, "BRDF", range(0, 86, 5)).lost["between_angles_ratio"] > 0.3


def test_opticstudio_says_what_happens_between_angles_to_spread_light() -> None:
    """A lobe at 0 and 80 deg only: half way, the mean of both is not what the lobe sends out at 40 deg."""
    export = opticstudio(GaussianLobe(0.9, 10 * DEG), "BRDF", [0.0, 80.0])
    assert export.lost["between_angles_ratio"] > 0.5
    assert opticstudio(Lambertian(0.5), "BRDF", [0.0, 45.0, 90.0]).lost["between_angles_ratio"] < 0.05


# --- Radiance


def test_klems_patches_tile_the_hemisphere() -> None:
    """145 patches, together pi, the first a cap of 5 deg: pi sin^2(5 deg)."""
    assert projected_sr().shape == (145,)
    assert projected_sr().sum() == pytest.approx(np.pi, abs=1e-12)
    assert projected_sr()[0] == pytest.approx(np.pi * np.sin(5 * DEG) ** 2, rel=1e-12)
    assert projected_sr()[1] == pytest.approx(np.pi * (np.sin(15 * DEG) ** 2 - np.sin(5 * DEG) ** 2) / 8, rel=1e-12)


SURFACES: dict[str, Bsdf] = {
    "Lambertian": Lambertian(0.35, 0.5),
    "lobe 5 deg": GaussianLobe(0.97, 5 * DEG),
    "face from air": Fresnel(1.0, 2.4869),
    "face from GaN": Fresnel(2.4869, 1.0),
    "coated lobe": Coated(Fresnel(1.0, 1.5), GaussianLobe(0.97, 20 * DEG)),
}


@pytest.mark.parametrize("name", SURFACES)
def test_klems_columns_hold_the_albedo(name: str) -> None:
    """Sum of value x projected solid angle over a column is the mean albedo of its ring, by another quadrature."""
    reflection, transmission = klems(SURFACES[name])
    power = projected_sr() @ (reflection + transmission)
    bounds, counts = np.array([0, 5, 15, 25, 35, 45, 55, 65, 75, 90]) * DEG, [1, 8, 16, 20, 24, 24, 24, 16, 12]
    means = []
    for low, high in pairwise(bounds):
        theta = low + (high - low) * (np.arange(4000) + 0.5) / 4000
        means.append(np.average(SURFACES[name].albedo(theta), weights=np.sin(theta) * np.cos(theta)))
    assert power == pytest.approx(np.repeat(means, counts), abs=2e-5)


def test_klems_of_lambert_is_flat_and_of_a_mirror_diagonal() -> None:
    """Lambert: reflectance / pi everywhere. Mirror: reflectance / projected solid angle on the diagonal only."""
    assert klems(Lambertian(0.4))[0] == pytest.approx(np.full((145, 145), 0.4 / np.pi), rel=2e-4)
    assert klems(Mirror(0.9))[0] == pytest.approx(np.diag(0.9 / projected_sr()), abs=1e-9)
    assert not klems(Mirror(0.9))[1].any()


def test_klems_matrix_of_a_reciprocal_surface_is_symmetric() -> None:
    """Exchanging incident and outgoing patch changes nothing for Lambert and mirror, but for the lobe."""
    both = klems(Mixture((Lambertian(0.5), Mirror(0.9)), (0.5, 0.5)))[0]
    assert np.abs(both - both.T).max() < 1e-3 * both.max()
    lobe = klems(GaussianLobe(0.9, 30 * DEG))[0]
    assert np.abs(lobe - lobe.T).max() > 0.1 * lobe.max()


def test_klems_of_a_clear_sheet_is_diagonal() -> None:
    """What goes straight on stays in the patch that names the incident direction."""
    sheet = SpecularTable(np.array([0.0, np.pi / 2]), np.full(2, 0.1), np.full(2, 0.8))
    reflection, transmission = klems(sheet)
    assert transmission == pytest.approx(np.diag(0.8 / projected_sr()), abs=1e-9)
    assert reflection == pytest.approx(np.diag(0.1 / projected_sr()), abs=1e-9)


@functools.cache
def one_sided() -> Tabulated:
    """Light of any incidence into two beams: up at 25 to 35, down at 45 to 55 deg, azimuth within 20 deg."""
    theta = np.array([0.0, 25.0, 35.0, 90.0, 125.0, 135.0, 180.0]) * DEG
    values = np.zeros((1, 1, 1, 6, 2))
    values[0, 0, 0, 1, 0] = values[0, 0, 0, 4, 0] = 1.0
    table = Tabulated(values, np.zeros(1), theta, np.array([0.0, 20.0, 180.0]) * DEG)
    return replace(table, values=values * 0.5 / (values * table.projected_sr).max())


@functools.cache
def one_sided_klems() -> tuple[Any, Any]:
    """Its two matrices."""
    return klems(one_sided())


@pytest.mark.parametrize("patch", [0, 4, 11, 60])
def test_klems_column_is_where_rays_of_that_patch_go(patch: int) -> None:
    """Rays drawn uniformly over an incident patch, scattered and sorted into patches, give the column (4.5 sigma)."""
    starts = np.cumsum([0, 1, 8, 16, 20, 24, 24, 24, 16, 12])
    bounds = np.array([0, 5, 15, 25, 35, 45, 55, 65, 75, 90]) * DEG
    ring, count = _ring(patch, starts)
    rng, rays = np.random.default_rng(patch), 60_000
    low, high = np.sin(bounds[ring : ring + 2]) ** 2
    theta_in = np.arcsin(np.sqrt(rng.uniform(low, high, rays)))
    azimuth = (patch - starts[ring] + rng.uniform(-0.5, 0.5, rays)) * 2 * np.pi / count
    sample = one_sided().sample(rng.random((rays, 3)), theta_in)
    x, y, z = sample.direction.T
    out = np.searchsorted(bounds, np.arccos(np.abs(z)), "right") - 1
    counts = np.diff(starts)[out]
    number = starts[out] + np.rint((np.arctan2(y, x) + azimuth) / (2 * np.pi) * counts).astype(int) % counts
    for side, matrix in zip((z > 0.0, z < 0.0), one_sided_klems(), strict=True):
        expected = matrix[:, patch] * projected_sr()
        found = np.bincount(number[side], sample.weight[side], 145) / rays
        error = np.sqrt(np.maximum(expected, 1e-4) / rays)
        assert np.all(np.abs(found - expected) < 4.5 * error + 2e-3)


def test_klems_refraction_moves_light_to_the_ring_of_snells_law() -> None:
    """From GaN, light of the ring 15 to 25 deg (below 23.7) leaves into 40 to 90 deg, straight on in azimuth."""
    transmission = klems(Fresnel(2.4869, 1.0))[1] * projected_sr()[:, None]
    column = transmission[:, 9]  # first patch of the third ring, azimuth 0
    outgoing = np.flatnonzero(column > 1e-9)
    ring_starts = np.cumsum([0, 1, 8, 16, 20, 24, 24, 24, 16, 12])
    assert np.all(outgoing >= ring_starts[4])
    azimuths = [(k - ring_starts[r]) * 360 / n for k in outgoing for r, n in [_ring(k, ring_starts)]]
    assert np.all(np.abs((np.array(azimuths) + 180) % 360 - 180) <= 22.5)


def _ring(patch: int, starts: np.ndarray) -> tuple[int, int]:
    ring = int(np.searchsorted(starts, patch, "right")) - 1
    return ring, int(starts[ring + 1] - starts[ring])


def test_radiance_xml_reads_back_and_says_what_is_lost() -> None:
    """Four blocks come back to 1e-6; file and return value name delta, ring, polarisation and wavelength losses."""
    table = film()
    front, back = film_bsdf(table, "outside"), film_bsdf(table, "inside")
    export = radiance_xml(front, back, "5.5 pairs", also_lost=averaging_loss(table, "outside"))
    blocks = read_radiance_xml(export.text)
    assert set(blocks) == {"Transmission Front", "Reflection Front", "Transmission Back", "Reflection Back"}
    reflection, transmission = klems(front)
    assert np.allclose(blocks["Reflection Front"], reflection, rtol=1e-6)
    assert np.allclose(blocks["Transmission Front"], transmission, rtol=1e-6)
    R, powers = projected_sr() @ blocks["Reflection Front"], table.average("outside")
    assert R[0] == pytest.approx(float(table.at(powers.R, np.sin(2.5 * DEG))), abs=1e-3)
    of_file = {"ring_ratio", "delta_power_ratio", "delta_spread_sr"}
    assert set(export.lost) == {"polarisation_ratio", "wavelength_ratio", *of_file}
    comment = export.text.split("<!--")[1].split("-->")[0]
    assert all(f"{name.rpartition('_')[0]} {size:.3g}" in comment for name, size in export.lost.items())


def test_radiance_xml_defines_its_basis_as_the_schema_wants() -> None:
    """Nine rings that join, 145 patches, columns incident, one Visible block for each direction."""
    space = {"w": "http://windows.lbl.gov"}
    root = Xml.fromstring(radiance_xml(Lambertian(0.3)).text)  # noqa: S314  # just written here
    rings = root.findall(".//w:AngleBasisBlock", space)
    bounds = [
        (float(r.findtext(".//w:LowerTheta", "", space)), float(r.findtext(".//w:UpperTheta", "", space)))
        for r in rings
    ]
    assert bounds[0][0] == 0.0
    assert bounds[-1][1] == 90.0
    assert all(a[1] == b[0] for a, b in pairwise(bounds))
    assert sum(int(r.findtext("w:nPhis", "", space)) for r in rings) == 145
    assert root.findtext(".//w:IncidentDataStructure", "", space) == "Columns"
    assert len(root.findall(".//w:WavelengthDataBlock", space)) == 2


# --- files by their ending


@pytest.mark.parametrize("side", ["inside", "outside"])
def test_an_exported_file_is_of_the_side_that_was_asked_for(side: Side, tmp_path: Path) -> None:
    """R at 30 deg is 1 from GaN (total reflection) and 0.62 from air, in all three formats."""
    paths = {ending: tmp_path / f"film{ending}" for ending in FORMATS}
    lost = {ending: export_table(film(), side, path) for ending, path in paths.items()}
    want = 1.0 if side == "inside" else line_average(film(), "outside", 30.0)[0]
    surface = read_speos(paths[".coated"].read_text())
    R = [np.interp(30.0, surface.aoi_deg, row) for row in film().weight @ surface.R.swapaxes(0, 1)]
    assert np.mean(R) == pytest.approx(want, abs=1e-3)
    scatter = read_opticstudio(paths[".bsdf"].read_text())
    assert np.interp(30.0, scatter.specular_deg, scatter.tis) == pytest.approx(want, abs=3e-3)
    matrix = read_radiance_xml(paths[".xml"].read_text())["Reflection Front"]
    assert (projected_sr() @ matrix)[26] == pytest.approx(want, abs=0.02)  # ring of 25 to 35 deg
    assert all(name.endswith(("_ratio", "_deg", "_sr")) for names in lost.values() for name in names)


def test_scatter_that_a_file_leaves_out_is_named_and_with_the_faces_spectrum_it_is_in(tmp_path: Path) -> None:
    """A rough film: 7 % of the light from air is missing without `faces`, none with them."""
    table, path = film(5.5, 5.0), tmp_path / "film.xml"
    without = export_table(table, "outside", path)
    missing = 1.0 - projected_sr() @ sum(klems(film_bsdf(table, "outside")))
    assert without["scatter_ratio"] >= missing.max() - 1e-6
    assert without["scatter_ratio"] > 0.05
    held = export_table(table, "outside", path, AbcSpectrum(correlation_length_nm=300.0))
    assert "scatter_ratio" not in held
    blocks = read_radiance_xml(path.read_text())
    total = projected_sr() @ (blocks["Reflection Front"] + blocks["Transmission Front"])
    assert total == pytest.approx(np.ones(145), abs=1e-4)


# --- bad files


def test_cut_and_edited_files_are_refused_with_their_line() -> None:
    """Each reader refuses shortened, strange and non-numeric texts with an InputError, never another exception."""
    coated = speos(film(), "outside", [0.0, 50.0]).text
    table = opticstudio(Lambertian(0.3), "BRDF", [0.0, 30.0]).text
    xml = radiance_xml(Lambertian(0.3)).text
    for text in (coated[:-60], coated.replace("OPTIS", "OTHER"), coated.replace("\t400", "\tx"), "", "1\n2\n3\n4"):
        with pytest.raises(InputError, match="coated file"):
            read_speos(text)
    for text in (table[:-30], table.replace("ScatterAzimuth", "Azimuth"), table.replace("DataEnd", ""), "", "Source"):
        with pytest.raises(InputError):
            read_opticstudio(text)
    for text in (xml[:-30], xml.replace("Columns", "TensorTree3"), xml.replace("Klems Full", "Klems Half"), ""):
        with pytest.raises(InputError):
            read_radiance_xml(text)
    with pytest.raises(InputError, match="document type"):
        read_radiance_xml('<!DOCTYPE a [<!ENTITY b "c">]>' + xml)


def test_bad_angles_are_refused() -> None:
    """Angles out of order or beyond 90 deg, radial steps that do not begin at the specular ray."""
    for aoi in ([10.0, 5.0], [0.0, 91.0], []):
        with pytest.raises(InputError, match="aoi_deg"):
            speos(film(), "outside", aoi)
    with pytest.raises(InputError, match="radial_deg"):
        opticstudio(Lambertian(0.3), "BRDF", radial_deg=[1.0, 2.0])
    with pytest.raises(InputError, match="azimuth_deg"):
        opticstudio(Lambertian(0.3), "BRDF", azimuth_deg=[0.0, 90.0])
    with pytest.raises(InputError, match="specular_deg"):
        opticstudio(Lambertian(0.3), "BRDF", specular_deg=[0.0, 90.5])
