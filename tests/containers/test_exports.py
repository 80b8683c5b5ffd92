"""Exports: what is written is read back as it was, powers are kept, and what is lost is said with its size."""

from __future__ import annotations

import functools
import xml.etree.ElementTree as Xml
from itertools import pairwise

import numpy as np
import pytest

from containers.bsdf import Bsdf, Coated, Fresnel, GaussianLobe, Lambertian, Mirror, Mixture, direction_of
from containers.stack import dbr_layers
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
from containers.thin_film.table import FilmTable, Grid, Side, film_table
from luxloop.errors import InputError
from luxloop.stack import Layer, Medium, Stack

DEG = np.pi / 180.0
GAN, ALN = (2.4869, 45.2), (2.1793, 51.6)


@functools.cache
def film(pairs: float = 5.5, roughness_nm: float = 0.0) -> FilmTable:
    """The paper's DBR, gan_first; each face as rough as the next."""
    rows = [(GAN, ALN)[kind] for kind in dbr_layers(pairs)]
    layers = tuple(Layer(medium=Medium(n=n), thickness_nm=t, roughness_nm=roughness_nm) for n, t in rows)
    stack = Stack(
        inside=Medium(n=GAN[0]), layers=layers, outside=Medium(n=1.0), inside_roughness_nm=roughness_nm
    )  # fmt: skip
    return film_table(stack, grid=Grid(wavelengths=21))


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


def test_speos_says_how_much_scatter_and_interpolation_cost() -> None:
    """A rough film's scatter is named with its size; the table's own angles interpolate better than 5 deg steps."""
    rough, smooth = speos(film(5.5, 5.0), "inside"), speos(film(), "inside")
    assert smooth.lost["scatter"] == 0.0
    assert 0.02 < rough.lost["scatter"] < 1.0
    assert f"scatter {rough.lost['scatter']:.3g}" in rough.text.splitlines()[1]
    coarse = speos(film(), "inside", np.arange(0.0, 90.1, 5.0))
    assert coarse.lost["interpolation"] > 5 * smooth.lost["interpolation"]


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
    export = opticstudio(surface, scatter_type)  # type: ignore[arg-type]  # one of the two words
    file = read_opticstudio(export.text)
    assert file.scatter_type == scatter_type
    assert file.values.shape == (file.specular_deg.size, file.azimuth_deg.size, file.radial_deg.size)
    power = 0.5 * 0.8 + 0.4 * 0.2 + 0.1 * 0.5 if scatter_type == "BRDF" else 0.4 * 0.6
    assert file.tis == pytest.approx(np.full(file.tis.size, power), abs=2e-3)
    assert np.abs(file.integrals() - file.tis).max() == pytest.approx(export.lost["grid"], abs=1e-6)
    assert export.lost["grid"] < 0.03


def test_opticstudio_is_about_the_specular_ray_with_azimuth_zero_to_the_normal() -> None:
    """At specular 40 deg, azimuth 0 and radial 40 the value is the bsdf along the normal, at azimuth 180 below it."""
    lobe = GaussianLobe(0.9, 20 * DEG)
    file = read_opticstudio(opticstudio(lobe, "BRDF", [0.0, 40.0], [0.0, 90.0, 180.0], [0.0, 40.0, 45.0]).text)
    assert file.values[1, 0, 1] == pytest.approx(float(lobe.evaluate(40 * DEG, direction_of(0.0, 0.0))), rel=1e-7)
    assert file.values[1, 2, 2] == pytest.approx(
        float(lobe.evaluate(40 * DEG, direction_of(85 * DEG, 0.0))), rel=1e-7
    )
    assert file.values[1, :, 0] == pytest.approx(np.full(3, lobe.evaluate(40 * DEG, direction_of(40 * DEG, 0.0))))


def test_opticstudio_angle_of_incidence_is_the_transmitted_angle() -> None:
    """From GaN to air the file's 60 deg holds the power of light that meets the face at 20.4 deg."""
    face = Fresnel(2.4869, 1.0)
    export = opticstudio(face, "BTDF", [0.0, 60.0])
    expected = [float(face.deltas(np.arcsin(np.sin(a * DEG) / 2.4869)).refracted) for a in (0.0, 60.0)]
    assert read_opticstudio(export.text).tis == pytest.approx(expected, abs=1e-8)
    assert export.lost["delta_spread_deg"] == 1.0
    assert export.lost["delta_power"] == pytest.approx(max(expected))
    with pytest.raises(InputError, match=r"up to 23\.71 deg"):
        opticstudio(Fresnel(1.0, 2.4869), "BTDF", [0.0, 60.0])


def test_opticstudio_of_a_rough_film_names_what_is_lost() -> None:
    """Scatter of the film is carried, its specular part spread; polarisation and wavelength are named with sizes."""
    table = film(5.5, 5.0)
    surface = film_bsdf(table, "outside", AbcSpectrum(correlation_length_nm=300.0))
    export = opticstudio(surface, "BRDF", [0.0, 30.0, 60.0], also_lost=averaging_loss(table, "outside"))
    file, powers = read_opticstudio(export.text), table.average("outside")
    for k, angle in enumerate((0.0, 30.0, 60.0)):
        u = np.sin(angle * DEG)
        assert file.tis[k] == pytest.approx(float(table.at(powers.R + powers.S_R, u)), abs=3e-4)
    assert set(export.lost) == {"polarisation", "wavelength", "delta_spread_deg", "delta_power", "grid"}
    assert all(f"{name} {size:.3g}" in export.text.splitlines()[0] for name, size in export.lost.items())


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
    assert set(export.lost) == {"polarisation", "wavelength", "ring", "delta_power", "delta_spread_sr"}
    comment = export.text.split("<!--")[1].split("-->")[0]
    assert all(f"{name} {size:.3g}" in comment for name, size in export.lost.items())


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


# --- the film as a surface


@pytest.mark.parametrize("side", ["inside", "outside"])
def test_film_surface_keeps_the_golden_reflectance(side: Side) -> None:
    """Averaged R of the 5.5-pair film at 0 and 20 (GaN) or 60 deg (air), to the golden table's 2e-4."""
    surface = film_bsdf(film(), side)
    angles, golden = (
        ([0.0, 20.0, 30.0], [0.638402, 0.516240, 1.0]) if side == "inside" else ([0.0, 60.0], [0.638402, 0.506273])
    )
    assert surface.deltas(np.array(angles) * DEG).mirror == pytest.approx(golden, abs=2e-4)
    assert surface.albedo(np.linspace(0, np.pi / 2, 50)) == pytest.approx(np.ones(50), abs=1e-9)


def test_rough_film_surface_books_all_scatter() -> None:
    """With the faces' spectrum the surface keeps R + T + S_R + S_T = 1 and samples it; without, scatter is lost."""
    table = film(5.5, 5.0)
    surface = film_bsdf(table, "inside", AbcSpectrum(correlation_length_nm=200.0))
    angles = np.array([0.0, 10.0, 40.0, 80.0]) * DEG
    assert surface.albedo(angles) == pytest.approx(np.ones(4), abs=1e-6)
    assert np.all(film_bsdf(table, "inside").albedo(angles) < 0.995)
    sample = surface.sample(np.random.default_rng(1).random((2000, 3)), 0.0)
    assert sample.weight == pytest.approx(np.ones(2000), abs=1e-6)
    assert np.any(np.abs(sample.direction[:, 0]) > 0.1)


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
        opticstudio(Lambertian(0.3), "BRDF", specular_deg=[0.0, 89.5])
