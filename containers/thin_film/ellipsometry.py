"""What an ellipsometer reports: psi, delta, and the elements N, C, S that it measures.

    rho = r_p / r_s = tan(psi) exp(i delta)        psi in [0, 90] deg, delta in [0, 360) deg

Signs. r_p and r_s are those of Azzam and Bashara (opposite at normal incidence), so bare silicon starts at delta =
180 deg at small angles and falls towards 0 beyond Brewster's angle. Instruments (Accurion, Woollam) count delta with
the time factor exp(+i omega t), n - ik; this project computes with exp(-i omega t), n + ik; therefore

    delta = -arg(r_p / r_s)    of our amplitudes: a thin transparent film on silicon lowers delta below 180 deg.

Intensities. A real detector adds light of several wavelengths and of several passes through a thick substrate. What
adds is ss = |r_s|^2, pp = |r_p|^2 and ps = r_p conj(r_s); psi and delta follow from the sums:

    N = (ss - pp) / (ss + pp) = cos 2 psi,    C + iS = 2 conj(ps) / (ss + pp) = sin 2 psi exp(i delta)

for pure light. Of a sum N^2 + C^2 + S^2 < 1 (depolarised), and then psi = atan2(sqrt(C^2 + S^2), N) / 2 and delta =
atan2(S, C) describe its polarised part. Source: Azzam and Bashara, Ellipsometry and Polarized Light (1977); Jellison,
Thin Solid Films 313, 33 (1998).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.thin_film.incoherent import Light

Real = NDArray[np.float64]


def ncs_of_light(light: Light) -> Real:
    """N, C, S as (3, wavelength, u) of reflected light; nan where nothing is reflected."""
    ss, pp = light.R[:, 0], light.R[:, 1]
    total = np.where(ss + pp > 0.0, ss + pp, np.nan)
    turned = np.conj(light.ps)
    ncs: Real = np.stack([ss - pp, 2.0 * turned.real, 2.0 * turned.imag]) / total
    return ncs


def psi_delta_deg(ncs: ArrayLike) -> tuple[Real, Real]:
    """psi in [0, 90] and delta in [0, 360), in degrees, of N, C, S along the first axis."""
    N, C, S = np.asarray(ncs, float)
    psi = np.degrees(np.arctan2(np.hypot(C, S), N)) / 2.0
    delta = np.degrees(np.arctan2(S, C)) % 360.0
    return psi, np.where(delta == 360.0, 0.0, delta)  # -1e-17 % 360 rounds to 360


def ncs_of_psi_delta(psi_deg: ArrayLike, delta_deg: ArrayLike) -> Real:
    """N, C, S as (3, ...) of pure light with these psi and delta."""
    psi, delta = np.radians(np.asarray(psi_deg, float)), np.radians(np.asarray(delta_deg, float))
    return np.array([np.cos(2 * psi), np.sin(2 * psi) * np.cos(delta), np.sin(2 * psi) * np.sin(delta)])


def depolarisation(ncs: ArrayLike) -> Real:
    """1 - sqrt(N^2 + C^2 + S^2): 0 for pure light, 1 where no polarisation is left; N, C, S along the first axis."""
    degree: Real = np.sqrt(np.sum(np.asarray(ncs, float) ** 2, axis=0))
    return 1.0 - degree


def delta_residual_deg(measured_deg: ArrayLike, predicted_deg: ArrayLike) -> Real:
    """Measured minus predicted delta, wrapped to [-180, 180) degrees: 359 and 1 differ by -2."""
    difference = np.asarray(measured_deg, float) - np.asarray(predicted_deg, float)
    wrapped: Real = (difference + 180.0) % 360.0 - 180.0
    return wrapped
