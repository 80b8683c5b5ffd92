"""The film table: what a stack does to light of an LED's spectrum, against u = k_parallel / k0, from both sides.

Where its nodes lie, and how a u is found among them, is said in `nodes`; how many nodes and wavelengths it has, and
how far it is wrong, in `refinement`. Between nodes everything is interpolated linearly in `position`.

At a u beyond the index of a side at some wavelength there is no light of that wavelength; R reads 1 there, the limit
at grazing incidence.

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

from containers.reporting import Report, nothing
from containers.thin_film.nodes import Axis
from containers.thin_film.refinement import LOSS_NAMES, LOSSES, Samples, refined
from luxloop.errors import InputError
from luxloop.film import Grid, Spectrum
from luxloop.stack import Stack
from luxloop.words import parse

Real = NDArray[np.float64]
Side = Literal["inside", "outside"]
SIDES: tuple[Side, Side] = ("inside", "outside")
VERSION = 2
ARRAYS = ("u", "first", "wavelength_nm", "weight", "n_inside", "n_outside", "T")
NUMBERS = ("excess", "error_average_ratio", "error_single_ratio")
MOST = 1e300
"""Of a number in a header: below it all are finite."""


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
    axis: Axis
    """Where the nodes lie."""
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
    error_average_ratio: float
    """How far T and R, line average of one polarisation, are wrong (`refinement`); above `grid.tolerance_ratio` the
    table was full before it was resolved, and the value may be far too small."""
    error_single_ratio: float
    """The same between the nodes for one wavelength; above 0.05 dips are missed, and it is a lower bound."""

    @property
    def breaks(self) -> tuple[float, ...]:
        """u at the ends of the segments: low, (layers), high."""
        return self.axis.breaks

    @property
    def resolved(self) -> bool:
        """Whether the error that was found is within the tolerance that was asked for."""
        return self.error_average_ratio <= self.grid.tolerance_ratio

    def nodes(self, side: Side) -> int:
        """How many nodes light from a side has: all from the denser one, the shared ones from the other."""
        denser = self.n_inside.max() >= self.n_outside.max()
        return self.u.size if denser == (side == "inside") else self.axis.shared_nodes

    def powers(self, side: Side) -> Powers:
        """Powers of light from one side, each (wavelength, polarisation, node of that side)."""
        shape = (self.wavelength_nm.size, 2, self.nodes(side))
        T = np.zeros(shape)
        T[..., : self.T.shape[-1]] = self.T
        lost = [self.losses.get(f"{name}_{side}", np.zeros(shape)).astype(float) for name in LOSSES]
        return Powers(1.0 - T - lost[0] - lost[1] - lost[2], T, *lost)

    def average(self, side: Side) -> Powers:
        """Powers of unpolarised light of the whole spectrum, each (node of that side,).

        What one encounter sends on of unpolarised light, at the nodes and within `error_average_ratio` between them
        (spectrum fixed, indices of the half spaces that do not change over the line). It is not enough for several
        encounters: R of s, p and each wavelength must be multiplied before they are averaged, for the light that
        comes back is no longer that of the line.
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
        return self.axis.position(u)

    def at(self, values: ArrayLike, u: ArrayLike) -> Real:
        """`values` (..., node of a side) of this table, interpolated at u (any shape): (..., *u.shape)."""
        array = np.asarray(values, float)
        position = np.clip(self.position(u), 0.0, array.shape[-1] - 1.0)
        left = np.minimum(position.astype(int), array.shape[-1] - 2)
        right = position - left
        return np.asarray(array[..., left] * (1.0 - right) + array[..., left + 1] * right)

    def to_parts(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """A JSON header and named arrays: all there is to store or send."""
        header = {
            "version": VERSION,
            "stack": self.stack.model_dump(mode="json"),
            "spectrum": self.spectrum.model_dump(mode="json"),
            "grid": self.grid.model_dump(mode="json"),
            "breaks": list(self.breaks),
            "excess": self.excess,
            "error_average_ratio": self.error_average_ratio,
            "error_single_ratio": self.error_single_ratio,
        }
        own = {name: getattr(self, name) for name in ARRAYS if name != "first"} | {"first": self.axis.first}
        return header, own | dict(self.losses)

    @classmethod
    def from_parts(cls, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> FilmTable:
        """The table of `to_parts`; InputError where the parts are not those of a table of this version."""
        if header.get("version") != VERSION:
            raise InputError("version", header.get("version"), f"{VERSION}", "compute the table again")
        if not set(ARRAYS) <= set(arrays) <= {*ARRAYS, *LOSS_NAMES}:
            raise InputError("arrays", sorted(arrays), f"{', '.join(ARRAYS)} and losses", "compute the table again")
        _refuse_other_kinds(header, arrays)
        grid, breaks, first = parse(Grid, header["grid"]), tuple(map(float, header["breaks"])), arrays["first"]
        segment_cells = (first.size - grid.shared_nodes) // max(1, len(breaks) - 1)
        cells = grid.shared_nodes - 1 + segment_cells * (len(breaks) - 1)
        counted = first.size == cells + 1 and (segment_cells > 0 or len(breaks) == 1)
        if not counted or first[0] != 0 or not (np.diff(first) > 0).all() or first[-1] + 1 != arrays["u"].size:
            raise InputError("first", f"{first.size} numbers", "the nodes of a table", "compute the table again")
        found = cls(
            stack=parse(Stack, header["stack"]),
            spectrum=parse(Spectrum, header["spectrum"]),
            grid=grid,
            axis=Axis(breaks, grid.shared_nodes - 1, segment_cells, first),
            **{name: arrays[name] for name in ARRAYS if name != "first"},
            losses={name: arrays[name] for name in LOSS_NAMES if name in arrays},
            excess=header["excess"],
            error_average_ratio=header["error_average_ratio"],
            error_single_ratio=header["error_single_ratio"],
        )
        found._refuse_other_shapes()
        return found

    def _refuse_other_shapes(self) -> None:
        """InputError where the arrays are not of the nodes and wavelengths that they say."""
        count = max(self.wavelength_nm.size, 1)
        for name in ("wavelength_nm", "weight", "n_inside", "n_outside"):
            _refuse_shape(name, getattr(self, name), (count,))
        _refuse_shape("u", self.u, (self.u.size,))
        _refuse_shape("T", self.T, (count, 2, self.axis.shared_nodes))
        for side in SIDES:
            for name in {f"{name}_{side}" for name in LOSSES} & set(self.losses):
                _refuse_shape(name, self.losses[name], (count, 2, self.nodes(side)))


def _refuse_shape(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise InputError("film", f"{name} of shape {array.shape}", f"{shape}", "compute the table again")


def _refuse_other_kinds(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """InputError where the header lacks something, or something is of another kind than in a table."""
    breaks = header.get("breaks")
    listed: list[Any] = [0.0, *breaks] if isinstance(breaks, list | tuple) and breaks else [None]
    numbers = [*listed, *(header.get(name) for name in NUMBERS)]
    known = all(isinstance(one, float | int) and abs(one) < MOST for one in numbers)
    known = known and all(low < high for low, high in pairwise(listed))
    if not known or not {"stack", "spectrum", "grid"} <= set(header):
        allowed = f"stack, spectrum, grid, breaks, {', '.join(NUMBERS)}"
        raise InputError("film", f"a header of {', '.join(sorted(header))}", allowed, "compute the table again")
    for name, array in arrays.items():
        kind = "i" if name == "first" else "f"
        if array.dtype.kind != kind or (name == "first" and array.ndim != 1) or not np.isfinite(array).all():
            found = f"{name} of {array.dtype.str}, {array.ndim} axes"
            raise InputError("film", found, "finite numbers of a table", "compute the table again")


def film_table(
    stack: Stack, spectrum: Spectrum | None = None, grid: Grid | None = None, report: Report = nothing
) -> FilmTable:
    """The table of a coherent stack for light of a spectrum (default: 445 nm, FWHM 18 nm) on a grid.

    Smooth, lossless stacks are computed by the real kernel, all others by the general one. `report` is called between
    parts of the work; what it raises ends it.

    Raises
    ------
    InputError for an incoherent layer, a half space that absorbs (k above 0.01), a wavelength outside the data of a
    material, or roughness beyond what the model can describe.
    """
    spectrum, grid = spectrum or Spectrum(), grid or Grid()
    samples, errors = refined(stack, spectrum, grid, report)
    rows, axis = samples.rows, samples.axis
    return FilmTable(
        stack=stack,
        spectrum=spectrum,
        grid=grid,
        axis=axis,
        u=axis.u,
        wavelength_nm=rows.wavelength_nm,
        weight=samples.weight,
        n_inside=rows.index[:, 0].real,
        n_outside=rows.index[:, -1].real,
        T=np.ascontiguousarray(samples.T[..., : axis.shared_nodes]),
        losses=_losses(samples),
        excess=samples.excess,
        error_average_ratio=errors.average_ratio,
        error_single_ratio=errors.single_ratio,
    )


def _losses(samples: Samples) -> dict[str, NDArray[np.float32]]:
    """What is lost anywhere, by name: at all nodes from the denser side, at the shared ones from the other."""
    inside, outside = (samples.rows.index[:, column].real.max() for column in (0, -1))
    denser = "inside" if inside >= outside else "outside"
    kept = {}
    for name, lost in zip(LOSS_NAMES, samples.lost, strict=False):  # a lossless stack has none
        if lost.any():
            nodes = slice(None) if name.endswith(denser) else slice(samples.axis.shared_nodes)
            kept[name] = np.ascontiguousarray(lost[..., nodes])
    return kept
