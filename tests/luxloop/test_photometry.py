"""V(lambda) and lux against what is defined and against an independent program."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from luxloop.errors import InputError
from luxloop.photometry import (
    illuminance_lx,
    irradiance_w_per_m2,
    luminous_efficacy_lm_per_w,
    photopic_v,
)

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "photometry.json").read_text())


def test_v_is_one_at_its_peak_and_below_one_elsewhere() -> None:
    """The CIE sets V(555 nm) = 1."""
    wavelength_nm = np.linspace(380.0, 780.0, 4001)
    v = photopic_v(wavelength_nm)
    assert photopic_v(555.0) == 1.0
    assert np.all((v > 0.0) & (v < 1.0 + 1e-4))
    assert abs(wavelength_nm[np.argmax(v)] - 555.0) < 1.0


def test_v_has_one_hump_without_ripple_of_the_interpolation() -> None:
    """V rises to its peak and falls after it, between the nodes too, and keeps its argument's shape."""
    rising = photopic_v(np.linspace(380.0, 554.0, 3000).reshape(3, 1000))
    falling = photopic_v(np.linspace(557.0, 780.0, 3000))
    assert rising.shape == (3, 1000)
    assert np.all(np.diff(rising.ravel()) > 0.0)
    assert np.all(np.diff(falling) < 0.0)


def test_what_cannot_be_seen_counts_nothing() -> None:
    """Outside 380 to 780 nm V is taken as 0."""
    assert photopic_v([300.0, 379.9, 780.1, 1000.0]).tolist() == [0.0] * 4


@pytest.mark.parametrize(("wavelength_nm", "v"), [*GOLDEN["v_by_wavelength_nm"].items()])
def test_v_between_the_nodes_is_the_one_nanometre_tables(wavelength_nm: str, v: float) -> None:
    """The interpolation errs by less than the 3e-4 that its module states."""
    assert float(photopic_v(float(wavelength_nm))) == pytest.approx(v, abs=3e-4)


@pytest.mark.parametrize("line", GOLDEN["efficacy"], ids=lambda line: f"{line['peak_nm']:g}")
def test_the_efficacy_is_that_of_an_independent_program(line: dict[str, float]) -> None:
    """colour-science's luminous efficacy of the same Gaussian line, to 4e-4."""
    efficacy = luminous_efficacy_lm_per_w(line["peak_nm"], line["fwhm_nm"])
    assert efficacy == pytest.approx(line["luminous_efficacy_lm_per_w"], rel=4e-4)


def test_the_papers_line_is_met_to_one_in_ten_thousand() -> None:
    """The figure that the module's docstring states for 445 nm, FWHM 18 nm."""
    paper = next(line for line in GOLDEN["efficacy"] if (line["peak_nm"], line["fwhm_nm"]) == (445.0, 18.0))
    efficacy = luminous_efficacy_lm_per_w(445.0, 18.0)
    assert abs(efficacy / paper["luminous_efficacy_lm_per_w"] - 1.0) < 1e-4


def test_a_thin_line_at_555_nm_has_683_lumen_per_watt() -> None:
    """The definition of the candela."""
    assert luminous_efficacy_lm_per_w(555.0, 0.01) == pytest.approx(683.0, rel=1e-6)


def test_lux_and_watt_are_each_others_inverse() -> None:
    """There and back, for a map of any shape."""
    irradiance = np.array([[0.0, 1.0], [5577.0, 1e-9]])
    lux = illuminance_lx(irradiance, 445.0, 18.0)
    assert np.allclose(irradiance_w_per_m2(lux, 445.0, 18.0), irradiance, rtol=1e-15, atol=0.0)


@pytest.mark.parametrize(
    ("peak_nm", "fwhm_nm", "field"),
    [(300.0, 18.0, "peak_nm"), (float("nan"), 18.0, "peak_nm"), (445.0, 0.0, "fwhm_nm"), (445.0, -1.0, "fwhm_nm")],
)
def test_a_line_nobody_sees_is_refused(peak_nm: float, fwhm_nm: float, field: str) -> None:
    """The error names the field and the range."""
    with pytest.raises(InputError) as caught:
        luminous_efficacy_lm_per_w(peak_nm, fwhm_nm)
    assert caught.value.field == field
