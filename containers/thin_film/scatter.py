"""The lobe of light scattered by rough faces: a K-correlation (ABC) power spectrum about the specular direction.

How much is scattered into each half space is the budget S_R, S_T of `transfer_matrix`; here is where it goes. The
surface's power spectral density against the lateral wave number q,

    PSD(q) ~ (1 + (q xi)^2)^(-(C + 1) / 2),        q = k0 |kappa - kappa_specular|,

flat below 1 / xi and falling as q^-(C+1) above, scatters from the specular into other lateral wave vectors kappa (in
units of k0; |kappa| = n sin theta in the half space of exit). The scattered radiance, power per d^2 kappa, is taken
proportional to it, so it is shift-invariant in direction cosines (Harvey). Per solid angle that is

    dP/dOmega = S n^2 cos(theta) PSD / integral of PSD over |kappa| < n.

With B = 2 pi xi and f = q / 2 pi this is the ABC form A / (1 + (B f)^2)^((C+1)/2) of Church and Takacs. The specular
direction may be evanescent on the side of exit (|kappa_specular| > n): the lobe is then the tail that propagates.
Neglected: the dependence of the scattered amplitude on polarisation and on the stack (Elson), so also what a face
scatters out of total reflection, whose budget S_T the scalar model calls zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from containers.checked import NANOMETRES, reals, within
from luxloop.words import Words

Real = NDArray[np.float64]
_RULE = np.polynomial.legendre.leggauss(200)


class AbcSpectrum(Words):
    """The power spectral density of a rough face: correlation length and exponent."""

    correlation_length_nm: float = Field(gt=0.0, le=1e6, description="xi: flat below lateral wave number 1 / xi.")
    exponent: float = Field(2.0, gt=0.0, le=20.0, description="C: the density falls as q^-(C + 1); 2 is common.")

    def relative(self, q_per_nm: ArrayLike) -> Real:
        """PSD(q) / PSD(0) at lateral wave numbers q (1/nm)."""
        q = np.asarray(q_per_nm, float) * self.correlation_length_nm
        return np.asarray((1.0 + q * q) ** (-(self.exponent + 1.0) / 2.0))


def lobe(
    spectrum: AbcSpectrum,
    scattered: float,
    u_specular: float,
    n_exit: float,
    wavelength_nm: float,
    theta_rad: ArrayLike,
    phi_rad: ArrayLike,
) -> Real:
    """Scattered power per solid angle (1/sr) on a grid of directions in one half space.

    Parameters
    ----------
    spectrum : the faces' power spectral density, the same for all of them.
    scattered : power scattered into this half space, share of the incident power (S_R or S_T).
    u_specular : k_parallel / k0 of the incident, and so of the specular light.
    n_exit : real index of the half space that the light is scattered into.
    wavelength_nm : in vacuum.
    theta_rad, phi_rad : directions in that half space, broadcast against each other: theta from the outward normal,
        0 to pi/2; phi = 0 is where the specular light goes (reflected or transmitted, its k_parallel is the same).

    Notes
    -----
    Integrates to `scattered` over the half space; InputError for numbers out of range. Equation, source, what is
    neglected: head of this module.
    """
    within("n_exit", n_exit, 0.0, 20.0, "the real index of the half space", above=True)
    within("wavelength_nm", wavelength_nm, *NANOMETRES, "the vacuum wavelength in nm")
    within("u_specular", u_specular, 0.0, 20.0, "n sin(theta) of the specular light")
    within("scattered", scattered, 0.0, 1.0, "a share of the incident power")
    theta, phi = reals("theta_rad", theta_rad), reals("phi_rad", phi_rad)
    k0 = 2.0 * np.pi / wavelength_nm
    along, across = n_exit * np.sin(theta) * np.cos(phi), n_exit * np.sin(theta) * np.sin(phi)
    density = spectrum.relative(k0 * np.hypot(along - u_specular, across))
    return np.asarray(scattered * n_exit**2 * np.cos(theta) * density / _disc(spectrum, u_specular, n_exit, k0))


def _disc(spectrum: AbcSpectrum, centre: float, radius: float, k0: float) -> float:
    """Integral of PSD / PSD(0) over the disc |kappa| < radius, about a point at distance `centre` from its middle.

    In circles about that point: whole ones as far as they lie in the disc, then arcs of half angle alpha. asinh(q xi)
    as variable smooths the spectrum, a sine map the ends of the arcs.
    """
    b = k0 * spectrum.correlation_length_nm
    nearest, farthest = abs(radius - centre), radius + centre
    whole = _circles(spectrum, b, radius - centre) if centre < radius else 0.0
    if centre == 0.0:
        return whole
    x, weight = _RULE
    low, high = np.arcsinh(b * nearest), np.arcsinh(b * farthest)
    v = (low + high) / 2 + (high - low) / 2 * np.sin(np.pi / 2 * x)
    dv = (high - low) / 2 * np.pi / 2 * np.cos(np.pi / 2 * x) * weight
    rho = np.sinh(v) / b
    alpha = np.arccos(np.clip((rho**2 + centre**2 - radius**2) / (2 * rho * centre), -1.0, 1.0))
    arcs = 2 * alpha * rho * np.cosh(v) / b * np.cosh(v) ** (-(spectrum.exponent + 1.0))
    return whole + float(np.sum(arcs * dv))


def _circles(spectrum: AbcSpectrum, b: float, radius: float) -> float:
    """Integral of PSD / PSD(0) over a disc about its own middle, in closed form."""
    c, log = spectrum.exponent, np.log1p((b * radius) ** 2)
    if c == 1.0:
        return float(np.pi / b**2 * log)
    return float(2 * np.pi / b**2 * -np.expm1(-(c - 1.0) / 2.0 * log) / (c - 1.0))
