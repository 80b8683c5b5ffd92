"""The scattered lobe: it holds its budget, it is shift-invariant in direction cosines, it has the right shape."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from containers.thin_film.scatter import AbcSpectrum, lobe
from luxloop.errors import InputError


def integral(spectrum: AbcSpectrum, u: float, n: float, thetas: int = 400, phis: int = 800) -> float:
    """Integral over the half space by Gauss-Legendre in theta and the trapezoid rule in phi, for a budget of 1."""
    x, weight = np.polynomial.legendre.leggauss(thetas)
    theta, phi = (x[:, None] + 1.0) * np.pi / 4, np.arange(phis) * 2 * np.pi / phis
    density = lobe(spectrum, 1.0, u, n, 445.0, theta, phi)
    return float(np.sum(density * np.sin(theta) * weight[:, None]) * np.pi / 4 * 2 * np.pi / phis)


@pytest.mark.parametrize("exponent", [0.7, 1.0, 1.5, 3.0])
@pytest.mark.parametrize("length_nm", [20.0, 200.0, 1500.0])
@pytest.mark.parametrize(("u", "n"), [(0.0, 1.0), (0.3, 1.0), (0.98, 1.0), (1.4, 1.0), (0.5, 2.4869), (2.3, 2.4869)])
def test_the_lobe_integrates_to_its_budget(exponent: float, length_nm: float, u: float, n: float) -> None:
    """Over the half space to 1e-6, about normal, oblique, nearly grazing and evanescent specular directions."""
    spectrum = AbcSpectrum(correlation_length_nm=length_nm, exponent=exponent)
    assert integral(spectrum, u, n) == pytest.approx(1.0, abs=1e-6)


def test_a_narrow_lobe_still_holds_its_budget() -> None:
    """A correlation length of 8 um, a lobe of half a degree, on a grid fine enough to see it."""
    spectrum = AbcSpectrum(correlation_length_nm=8000.0, exponent=3.0)
    assert integral(spectrum, 0.2, 1.0, 1500, 6000) == pytest.approx(1.0, abs=1e-6)


def test_radiance_is_shift_invariant() -> None:
    """Density over cos(theta) depends on the distance of direction cosines alone, up to the normalisation."""
    spectrum = AbcSpectrum(correlation_length_nm=400.0, exponent=2.0)
    offset = np.array([-0.3, -0.1, 0.0, 0.1, 0.3])
    shapes = []
    for u in (0.0, 0.25, 0.6):
        theta = np.arcsin(np.abs(u + offset))
        density = lobe(spectrum, 1.0, u, 1.0, 445.0, theta, np.where(u + offset < 0, np.pi, 0.0)) / np.cos(theta)
        shapes.append(density / density[2])
    np.testing.assert_allclose(shapes[1], shapes[0], rtol=1e-12)
    np.testing.assert_allclose(shapes[2], shapes[0], rtol=1e-12)


def test_the_lobe_points_where_the_specular_light_goes() -> None:
    """At phi = 0 and the specular angle the radiance is largest; it falls on all sides."""
    spectrum = AbcSpectrum(correlation_length_nm=1000.0, exponent=2.0)
    theta = np.radians(np.arange(0.0, 90.0, 0.5))[:, None]
    phi = np.radians(np.arange(-180.0, 180.0, 2.0))
    radiance = lobe(spectrum, 0.02, np.sin(np.radians(35.0)), 1.0, 445.0, theta, phi) / np.cos(theta)
    row, column = np.unravel_index(radiance.argmax(), radiance.shape)
    assert np.degrees(theta[row, 0]) == pytest.approx(35.0, abs=0.26)
    assert phi[column] == pytest.approx(0.0)


def test_the_tail_falls_with_the_stated_power() -> None:
    """PSD(2 q) / PSD(q) = 2^-(C + 1) far above 1 / xi, and half of it is lost at q xi = 1 for C = 1."""
    spectrum = AbcSpectrum(correlation_length_nm=100.0, exponent=2.5)
    ratio = spectrum.relative(200.0) / spectrum.relative(100.0)
    assert ratio == pytest.approx(2.0**-3.5, rel=1e-6)
    assert AbcSpectrum(correlation_length_nm=100.0, exponent=1.0).relative(0.01) == pytest.approx(0.5)


def test_mirror_symmetry() -> None:
    """The lobe is the same on both sides of the plane of incidence."""
    spectrum = AbcSpectrum(correlation_length_nm=300.0)
    theta, phi = np.linspace(0.0, 1.5, 7)[:, None], np.linspace(0.1, 3.0, 5)
    left, right = (lobe(spectrum, 1.0, 0.7, 1.0, 445.0, theta, sign * phi) for sign in (1, -1))
    np.testing.assert_allclose(left, right, rtol=1e-13)


def test_bad_input_is_refused() -> None:
    """A correlation length of zero, and a wavelength of zero."""
    with pytest.raises(ValidationError):
        AbcSpectrum(correlation_length_nm=0.0)
    with pytest.raises(InputError, match="wavelength_nm"):
        lobe(AbcSpectrum(correlation_length_nm=100.0), 1.0, 0.0, 1.0, 0.0, 0.0, 0.0)
