"""The layers of a chip's mirror, with what is hidden in them.

chip  GaN AlN GaN AlN ... air      each half pair a layer; the first is the layer order's
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import ndtr

from validation.blind.film import Complex, Film, Layer, film
from validation.blind.words import Hidden, Real, Surroundings

FWHM_PER_SD = 2.354820045
LINES = 11
"""Of Gauss and Hermite, over the chip's line."""
OSCILLATORS = {"gan": (6.235, 26.02), "aln": (10.47, 36.54)}
"""Wemple and DiDomenico's single-oscillator and dispersion energies in eV: n^2 = 1 + Eo Ed / (Eo^2 - E^2). Fitted
to the ordinary indices of Barker and Ilegems and of Pastrnak and Roskovcova at 425 to 465 nm, to 4e-4."""
HC_EV_NM = 1239.841984
SLICE_NM = 2.5
WEDGE_UM = 1500.0


def film_of(surroundings: Surroundings, pairs: float, there: Mapping[str, Hidden], x_um: float = 0.0) -> Film:
    """The film of a chip whose centre is at x, with what is hidden in it."""
    wavelength_nm, weight = _line(surroundings)
    layers = _layers(surroundings, pairs, there, wavelength_nm, x_um)
    if "interdiffused_layers" in there:
        layers = _mixed(layers, surroundings.n_gan, there["interdiffused_layers"].amount)
    return film(layers, surroundings.n_gan, wavelength_nm, weight)


def _line(surroundings: Surroundings) -> tuple[Real, Real]:
    """Wavelengths and weights of a Gaussian line."""
    if surroundings.fwhm_nm == 0.0:
        return np.array([surroundings.peak_nm]), np.ones(1)
    node, weight = np.polynomial.hermite_e.hermegauss(LINES)
    return surroundings.peak_nm + surroundings.fwhm_nm / FWHM_PER_SD * node, weight / weight.sum()


def _layers(
    surroundings: Surroundings, pairs: float, there: Mapping[str, Hidden], wavelength_nm: Real, x_um: float
) -> list[Layer]:
    """From the chip outwards."""
    order = ["gan", "aln"] if surroundings.layer_order == "gan_first" else ["aln", "gan"]
    if "swapped_layers" in there:
        order.reverse()
    count = round(2.0 * pairs)
    found: list[Layer] = []
    for number in range(count):
        material = order[number % 2]
        thickness = surroundings.gan_nm if material == "gan" else surroundings.aln_nm
        late = number / max(count - 1, 1)  # 0 at the first layer, 1 at the last
        if "growth_drift" in there:
            thickness *= 1.0 + 2.0 * late * there["growth_drift"].amount
        if "growth_wedge" in there:
            thickness *= 1.0 + there["growth_wedge"].amount * 1e-3 * WEDGE_UM * np.tanh(x_um / WEDGE_UM)
        found.append((_index(material, late, surroundings, there, wavelength_nm), float(thickness)))
    return found


def _index(
    material: str, late: float, surroundings: Surroundings, there: Mapping[str, Hidden], wavelength_nm: Real
) -> Complex:
    """n - i k of a layer at each wavelength."""
    n = np.full(wavelength_nm.size, surroundings.n_gan if material == "gan" else surroundings.n_aln)
    if "oscillator_dispersion" in there:
        oscillator, strength = OSCILLATORS[material]
        n = np.sqrt(1.0 + oscillator * strength / (oscillator**2 - (HC_EV_NM / wavelength_nm) ** 2))
    k = 0.0
    if material == "aln":
        if "porous_aln" in there:
            n = _thinned(n, there["porous_aln"].amount)
        if "lossy_layers" in there:
            k = 2.0 * late * there["lossy_layers"].amount
    return n - 1j * k


def _thinned(n: Real, change: float) -> Real:
    """Lorentz and Lorenz: (n^2 - 1)/(n^2 + 2) goes with the density, here such that the mean index changes so."""
    mean = float(n.mean())
    share = _polarised(n) * (_polarised(mean + change) / _polarised(mean))
    return np.asarray(np.sqrt((1.0 + 2.0 * share) / (1.0 - share)))


def _polarised(n: Any) -> Any:
    return (n**2 - 1.0) / (n**2 + 2.0)


def _mixed(layers: list[Layer], index: float, sd_nm: float) -> list[Layer]:
    """Thin slices of a permittivity whose steps are error functions; the face to the air stays sharp."""
    if not layers:
        return layers
    faces = np.concatenate([[0.0], np.cumsum([thickness for _, thickness in layers])])
    edges = _cut(np.concatenate([[-4.0 * sd_nm], faces]))
    before = np.full_like(layers[0][0], index) ** 2
    permittivity = np.repeat(before[None], edges.size - 1, axis=0)
    for face, (n, _) in zip(faces[:-1], layers, strict=True):
        at = (edges - face) / sd_nm
        area = sd_nm * (at * ndtr(at) + np.exp(-(at**2) / 2.0) / np.sqrt(2.0 * np.pi))
        permittivity = permittivity + np.outer(np.diff(area) / np.diff(edges), n**2 - before)
        before = n**2
    return [(np.sqrt(one), float(thin)) for one, thin in zip(permittivity, np.diff(edges), strict=True)]


def _cut(faces: Real) -> Real:
    """Edges of slices between faces, each no thicker than `SLICE_NM`."""
    pieces = [
        np.linspace(low, high, max(1, int(np.ceil((high - low) / SLICE_NM))), endpoint=False)
        for low, high in itertools.pairwise(faces)
    ]
    return np.concatenate([*pieces, faces[-1:]])
