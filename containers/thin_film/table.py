"""The film table: what a stack does to light of an LED's spectrum, against u = k_parallel / k0, from both sides.

    node   0 ........ shared ........ N0 ..... segment ..... N1 ..... segment ..... N2
    u      0      low sin(theta)      low        cosine      n_AlN       cosine     high

The shared nodes, u from 0 to the lower of the two outer indices, are uniform in the angle of that side (air); they
serve both sides. Beyond it light exists on the denser side only: nodes from `low` to `high` in segments that end at
the indices of the layers, denser towards both ends, since everything there goes as the square root of the distance.
`position` gives the place of any u among the nodes, and everything is interpolated linearly in it.

With dispersion `low` and `high` are the largest over the wavelengths. At a u beyond the index of a side at some
wavelength there is no light of that wavelength; R reads 1 there, the limit at grazing incidence.

Kept are the powers that cannot be derived: T (common to both sides), and S_R, S_T, A per side where they are not all
zero. R is what remains, so R + T + S_R + S_T + A = 1 exactly. The bulk's own absorption is not the film's: a half
space enters with its real index (k up to 0.01; a metal is refused).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.stack import StackRows, resolve
from containers.thin_film import lossless
from containers.thin_film.transfer_matrix import solve
from luxloop.errors import InputError
from luxloop.film import Grid, Spectrum
from luxloop.stack import Stack
from luxloop.words import parse

Real = NDArray[np.float64]
Side = Literal["inside", "outside"]
SIDES: tuple[Side, Side] = ("inside", "outside")
LOSSES = ("S_R", "S_T", "A")
VERSION = 1
FWHM_TO_SIGMA = 1.0 / (2.0 * np.sqrt(2.0 * np.log(2.0)))
HALF_SPAN_FWHM = 2.5
"""The spectrum is cut at peak +- 2.5 FWHM; the golden averages move by less than 2e-9 for a wider and denser grid."""
MAX_HALF_SPACE_K = 0.01


class Powers(NamedTuple):
    """Shares of the incident power, each of shape (..., node): specular, scattered back and onward, absorbed."""

    R: Real
    T: Real
    S_R: Real
    S_T: Real
    A: Real


@dataclass(frozen=True)
class FilmTable:
    """The powers of one stack at every wavelength, polarisation (s, p) and node; see the head of this module."""

    stack: Stack
    spectrum: Spectrum
    grid: Grid
    breaks: tuple[float, ...]
    """u at the ends of the segments: low, (layers), high."""
    u: Real
    """(node,)"""
    wavelength_nm: Real
    """(wavelength,)"""
    weight: Real
    """(wavelength,), spectral weights of sum 1."""
    n_inside: Real
    """(wavelength,)"""
    n_outside: Real
    """(wavelength,)"""
    T: Real
    """(wavelength, polarisation, shared node)"""
    losses: Mapping[str, NDArray[np.float32]]
    """`S_R_inside` and so on, (wavelength, polarisation, node of that side); what is zero everywhere is left out."""
    excess: float
    """Largest power that the roughness model created (`StackResponse.excess`)."""

    def nodes(self, side: Side) -> int:
        """How many nodes light from a side has: all from the denser one, the shared ones from the other."""
        denser = self.n_inside.max() >= self.n_outside.max()
        return self.u.size if denser == (side == "inside") else self.grid.shared_nodes

    def powers(self, side: Side) -> Powers:
        """Powers of light from one side, each (wavelength, polarisation, node of that side)."""
        shape = (self.wavelength_nm.size, 2, self.nodes(side))
        T = np.zeros(shape)
        T[..., : self.T.shape[-1]] = self.T
        lost = [self.losses.get(f"{name}_{side}", np.zeros(shape)).astype(float) for name in LOSSES]
        return Powers(1.0 - T - lost[0] - lost[1] - lost[2], T, *lost)

    def average(self, side: Side) -> Powers:
        """Powers of unpolarised light of the whole spectrum, each (node of that side,).

        Exact for one encounter; after several, s, p and the wavelengths must be averaged as late as possible.
        """
        T = np.zeros(self.nodes(side))
        T[: self.T.shape[-1]] = self._mean(self.T)
        held = [self.losses.get(f"{name}_{side}") for name in LOSSES]
        lost = [np.zeros_like(T) if power is None else self._mean(power) for power in held]
        return Powers(1.0 - T - lost[0] - lost[1] - lost[2], T, *lost)

    def _mean(self, power: NDArray[Any]) -> Real:
        """(node,) over the spectrum and both polarisations."""
        return np.asarray(self.weight @ power.sum(axis=1, dtype=float) / 2.0)

    def position(self, u: ArrayLike) -> Real:
        """Fractional node number at u (any shape): the variable in which the table is linear; the ends continue."""
        where = np.asarray(u, float)
        low, shared = self.breaks[0], self.grid.shared_nodes - 1
        at = shared * np.arcsin(np.clip(where / low, 0.0, 1.0)) / (np.pi / 2)
        for a, b in pairwise(self.breaks):
            at += self._per_segment * np.arccos(1.0 - 2.0 * np.clip((where - a) / (b - a), 0.0, 1.0)) / np.pi
        return np.asarray(at)

    def at(self, values: ArrayLike, u: ArrayLike) -> Real:
        """`values` (..., node of a side) of this table, interpolated at u (any shape): (..., *u.shape)."""
        array = np.asarray(values, float)
        position = np.clip(self.position(u), 0.0, array.shape[-1] - 1.0)
        left = np.minimum(position.astype(int), array.shape[-1] - 2)
        right = position - left
        return np.asarray(array[..., left] * (1.0 - right) + array[..., left + 1] * right)

    @property
    def _per_segment(self) -> int:
        return (self.u.size - self.grid.shared_nodes) // max(1, len(self.breaks) - 1)

    def to_parts(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """A JSON header and named arrays: all there is to store or send."""
        header = {
            "version": VERSION,
            "stack": self.stack.model_dump(mode="json"),
            "spectrum": self.spectrum.model_dump(mode="json"),
            "grid": self.grid.model_dump(mode="json"),
            "breaks": list(self.breaks),
            "excess": self.excess,
        }
        names = ("u", "wavelength_nm", "weight", "n_inside", "n_outside", "T")
        return header, {name: getattr(self, name) for name in names} | dict(self.losses)

    @classmethod
    def from_parts(cls, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> FilmTable:
        """The table of `to_parts`; InputError where the parts are not those of a table of this version."""
        if header.get("version") != VERSION:
            raise InputError("version", header.get("version"), f"{VERSION}", "compute the table again")
        names = ("u", "wavelength_nm", "weight", "n_inside", "n_outside", "T")
        losses = {f"{name}_{side}" for name in LOSSES for side in SIDES}
        if not set(names) <= set(arrays) <= set(names) | losses:
            raise InputError("arrays", sorted(arrays), f"{', '.join(names)} and losses", "compute the table again")
        return cls(
            stack=parse(Stack, header["stack"]),
            spectrum=parse(Spectrum, header["spectrum"]),
            grid=parse(Grid, header["grid"]),
            breaks=tuple(header["breaks"]),
            **{name: arrays[name] for name in names},
            losses={name: arrays[name] for name in sorted(losses & set(arrays))},
            excess=header["excess"],
        )


def film_table(stack: Stack, spectrum: Spectrum | None = None, grid: Grid | None = None) -> FilmTable:
    """The table of a coherent stack for light of a spectrum (default: 445 nm, FWHM 18 nm) on a grid.

    Smooth, lossless stacks are computed by the real kernel, all others by the general one.

    Raises
    ------
    InputError for an incoherent layer, a half space that absorbs (k above 0.01), a wavelength outside the data of a
    material, or roughness beyond what the model can describe.
    """
    spectrum, grid = spectrum or Spectrum(), grid or Grid()
    wavelength, weight = sampled(spectrum, grid.wavelengths)
    rows = _bulk_without_k(resolve(stack, wavelength))
    breaks, u = _nodes(rows, grid, int(np.argmax(weight)))
    T, losses, excess = _lossless(rows, u[: grid.shared_nodes]) if lossless.applies(rows) else _general(rows, u, grid)
    return FilmTable(
        stack=stack,
        spectrum=spectrum,
        grid=grid,
        breaks=breaks,
        u=u,
        wavelength_nm=wavelength,
        weight=weight,
        n_inside=rows.index[:, 0].real,
        n_outside=rows.index[:, -1].real,
        T=T,
        losses=losses,
        excess=excess,
    )


def sampled(spectrum: Spectrum, wavelengths: int) -> tuple[Real, Real]:
    """Wavelengths (nm) uniform over peak +- 2.5 FWHM, and Gaussian weights of sum 1."""
    if wavelengths == 1:
        return np.array([spectrum.peak_nm]), np.ones(1)
    half = HALF_SPAN_FWHM * spectrum.fwhm_nm
    wavelength = np.linspace(spectrum.peak_nm - half, spectrum.peak_nm + half, wavelengths)
    weight = np.exp(-0.5 * ((wavelength - spectrum.peak_nm) / (spectrum.fwhm_nm * FWHM_TO_SIGMA)) ** 2)
    return wavelength, weight / weight.sum()


def _bulk_without_k(rows: StackRows) -> StackRows:
    for side, column in (("inside", 0), ("outside", -1)):
        k = float(rows.index[:, column].imag.max())
        if k > MAX_HALF_SPACE_K:
            raise InputError(side, f"k = {k:g}", f"k up to {MAX_HALF_SPACE_K:g} in a table", "make it a thick layer")
    if not rows.coherent.all():
        raise InputError("coherent", False, "coherent layers in a table", "use the incoherent film measurement")
    index = rows.index.copy()
    index[:, [0, -1]] = index[:, [0, -1]].real
    return StackRows(rows.wavelength_nm, index, rows.thickness_nm, rows.roughness_nm, rows.coherent)


def _nodes(rows: StackRows, grid: Grid, peak: int) -> tuple[tuple[float, ...], Real]:
    """Ends of the segments, and all nodes."""
    outer = rows.index[:, [0, -1]].real
    low, high = float(outer.min(axis=1).max()), float(outer.max())
    shared = low * np.sin(np.linspace(0.0, np.pi / 2, grid.shared_nodes))
    if high - low < 1e-6:
        return (low,), shared
    between = {round(float(n), 3) for n in rows.index[peak, 1:-1].real if low + 1e-2 < n < high - 1e-2}
    breaks = (low, *sorted(between)[: grid.dense_nodes // 4], high)
    per_segment = grid.dense_nodes // (len(breaks) - 1)
    rise = (1.0 - np.cos(np.pi * np.arange(1, per_segment + 1) / per_segment)) / 2.0
    segments = [a + (b - a) * rise for a, b in pairwise(breaks)]
    return breaks, np.concatenate([shared, *segments])


Computed = tuple[Real, dict[str, NDArray[np.float32]], float]


def _lossless(rows: StackRows, shared: Real) -> Computed:
    return 1.0 - lossless.stack_reflectance(rows, shared), {}, 0.0


def _general(rows: StackRows, u: Real, grid: Grid) -> Computed:
    response = solve(rows.index, rows.thickness_nm, rows.roughness_nm, rows.wavelength_nm, u)
    T = np.minimum(response.T_inside, response.T_outside)[..., : grid.shared_nodes]
    denser = "inside" if rows.index[:, 0].real.max() >= rows.index[:, -1].real.max() else "outside"
    losses = {}
    for side in SIDES:
        nodes = u.size if side == denser else grid.shared_nodes
        for name in LOSSES:
            lost = getattr(response, f"{name}_{side}")[..., :nodes]
            if lost.any():
                losses[f"{name}_{side}"] = _rounded_down(lost)
    return T, losses, response.excess


def _rounded_down(values: Real) -> NDArray[np.float32]:
    """The next float32 that is not above, so that the remainder R cannot become negative."""
    single = values.astype(np.float32)
    return np.where(single > values, np.nextafter(single, np.float32(0.0)), single)
