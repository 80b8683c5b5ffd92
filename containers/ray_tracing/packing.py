"""From a `Scene` to the arrays that the kernels read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import (
    Bsdf,
    Coated,
    Facets,
    Fresnel,
    GaussianLobe,
    Lambertian,
    Mirror,
    Mixture,
    SpecularTable,
    Tabulated,
)
from containers.ray_tracing.arrays import FLAGS, INDEX, EmissionArrays, SceneArrays
from containers.ray_tracing.surfaces import (
    FACETS,
    KIND,
    LAMBERT,
    LAMBERT_THROUGH,
    LOBE,
    MIRROR,
    MOST_PARTS,
    REFRACTED,
    TABLE,
    Surfaces,
)
from containers.scene import Array, Cell, Emission, Scene
from luxloop.errors import InputError

Real = NDArray[np.float64]
FACE_NODES = 1025
"""Of one region of u: a bare face is then interpolated to 1e-6, a stack of ten pairs to 1e-5."""
OPAQUE_NODES = 257
QUANTILES = 4097
MOST_TABLED = 128
"""Surfaces whose tables are kept: a face has 33 kB a wavelength."""
INSIDE = "inside"
NEARLY_SMOOTH = 1e-6
"""Standard deviation of facets' slope up to which light outside all escape cones counts as shut in: 10,000
reflections turn it by 2e-4 rad. A column of the roughness begins below (`NEAR_OFF` of its step): above a mirror of
0.999 that light would be followed for 2 ms a ray, to be lost in the end."""


@dataclass(frozen=True)
class Part:
    """One way in which a surface sends light on."""

    kind: int
    share: Callable[[Real], Real]
    """Of the incident power, against theta_in_rad."""
    sigma_rad: float = 0.0
    """Of a lobe; of facets the standard deviation of their slope."""
    table: Tabulated | None = None


def parts_of(bsdf: Bsdf) -> list[Part]:
    """The parts of a surface, mirror and refracted first; InputError for one that kernels do not know."""
    if isinstance(bsdf, Lambertian):
        return [
            Part(kind, _constant(share))
            for kind, share in ((LAMBERT, bsdf.reflectance), (LAMBERT_THROUGH, bsdf.transmittance))
            if share > 0.0
        ]
    if isinstance(bsdf, GaussianLobe):
        return [Part(LOBE, _constant(bsdf.reflectance), sigma_rad=bsdf.sigma_rad)]
    if isinstance(bsdf, Facets):
        return [Part(FACETS, _constant(1.0), sigma_rad=bsdf.deviation)]
    if isinstance(bsdf, Mixture):
        weighted = zip(bsdf.parts, bsdf.shares, strict=True)
        return [_scaled(part, _constant(s)) for inner, s in weighted for part in parts_of(inner)]
    if isinstance(bsdf, Coated):
        through = lambda theta: bsdf.coat.deltas(theta).refracted  # noqa: E731
        base = [_scaled(part, through) for part in parts_of(bsdf.base)]
        return [Part(MIRROR, lambda theta: bsdf.coat.deltas(theta).mirror), *base]
    if isinstance(bsdf, Mirror | Fresnel | SpecularTable):
        return _specular(bsdf)
    if isinstance(bsdf, Tabulated):
        spread = lambda theta: np.maximum(bsdf.albedo(theta) - sum(bsdf.deltas(theta)), 0.0)  # noqa: E731
        return [*_specular(bsdf), Part(TABLE, spread, table=bsdf)]
    raise InputError("surface", type(bsdf).__name__, "a kind of containers.bsdf", "tabulate it first")


def _specular(bsdf: Bsdf) -> list[Part]:
    return [
        Part(MIRROR, lambda theta: bsdf.deltas(theta).mirror),
        Part(REFRACTED, lambda theta: bsdf.deltas(theta).refracted),
    ]


def _constant(value: float) -> Callable[[Real], Real]:
    return lambda theta: np.full(theta.shape, value)


def _scaled(part: Part, factor: Callable[[Real], Real]) -> Part:
    return Part(part.kind, lambda theta: factor(theta) * part.share(theta), part.sigma_rad, part.table)


def node_angles(n: float, inside: bool) -> Real:
    """theta_in_rad of the nodes of `surfaces.node_of` for a face of a chip of index n, seen from one side."""
    steps = np.linspace(0.0, 1.0, FACE_NODES)
    u = np.sqrt(1.0 - steps**2)
    if not inside:
        return np.arcsin(u)
    beyond = np.sqrt(1.0 + steps**2 * (n * n - 1.0))
    return np.arcsin(np.minimum(np.concatenate([u, beyond]) / n, 1.0))


class _Packer:
    """Surfaces one after the other, into `layout` and `tables`."""

    def __init__(self) -> None:
        self._rows: list[list[int]] = []
        self._tables: list[Real] = []
        self._size = 0

    def add(self, name: str, waves: tuple[Bsdf, ...], index: tuple[float, ...] = (), side: str = "") -> None:
        """A surface, by wavelength: one Bsdf each; of a chip's face the index each, and the side it is seen from."""
        same = tuple(map(_Same, waves))
        keeps = all(one.by_value or isinstance(one.bsdf, SpecularTable) for one in same)  # tables of cells are large
        one = (_kept if keeps else _tabled)(name, same, index, side)
        at, sigmas = self.keep(one.shares), self.keep(one.sigmas)
        cells = self.keep(one.cells) if one.cells.size else 0
        row = [len(one.kinds), one.nodes, one.stride, at, int(side == INSIDE), int(one.flat), sigmas, cells]
        self._rows.append(row + [*one.kinds] + [0] * (KIND + MOST_PARTS - len(row) - len(one.kinds)))

    def surfaces(self) -> Surfaces:
        """All that was added."""
        return Surfaces(np.array(self._rows, np.int64), np.concatenate(self._tables))

    def keep(self, array: Real) -> int:
        """Put numbers at the end; where they begin."""
        at = self._size
        self._tables.append(np.ascontiguousarray(array, float).ravel())
        self._size += array.size
        return at


class _Same:
    """A surface that is the same as an equal one; as itself alone where it holds arrays, which have no hash.

    Nobody writes into those.
    """

    __slots__ = ("_hash", "bsdf")

    def __init__(self, bsdf: Bsdf) -> None:
        self.bsdf = bsdf
        try:
            self._hash: int | None = hash(bsdf)
        except TypeError:
            self._hash = None

    @property
    def by_value(self) -> bool:
        """Whether it is known by its value."""
        return self._hash is not None

    def __hash__(self) -> int:
        return id(self.bsdf) if self._hash is None else self._hash

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Same):
            return NotImplemented
        return self.bsdf is other.bsdf or (
            self._hash is not None and self._hash == other._hash and self.bsdf == other.bsdf
        )


@dataclass(frozen=True)
class _Tabled:
    """A surface as kernels read it."""

    kinds: tuple[int, ...]
    shares: Real
    """(wavelength or 1, node, part), of the incident power, each with those before it."""
    sigmas: Real
    """(part,)"""
    cells: Real
    """Of a table; (0,): none."""
    nodes: int
    stride: int
    flat: bool


def _tabled(name: str, waves: tuple[_Same, ...], index: tuple[float, ...], side: str) -> _Tabled:
    """A surface's tables."""
    parts = [parts_of(wave.bsdf) for wave in waves]
    if not any(parts):
        parts = [[Part(LAMBERT, _constant(0.0))]] * len(waves)
    kinds = tuple(part.kind for part in parts[0])
    if len(kinds) > MOST_PARTS or any(tuple(part.kind for part in wave) != kinds for wave in parts):
        raise InputError(name, len(kinds), f"at most {MOST_PARTS} parts, the same for all wavelengths")
    angles = [node_angles(n, side == INSIDE) for n in index] or [np.arccos(np.linspace(0.0, 1.0, OPAQUE_NODES))]
    shares = np.stack(
        [np.cumsum([part.share(theta) for part in wave], axis=0).T for wave, theta in zip(parts, angles, strict=True)]
    )
    if not np.all(np.isfinite(shares)) or shares.min() < -1e-12 or shares.max() > 1.0 + 1e-9:
        raise InputError(name, float(shares.max()), "shares of power from 0 to 1", "it would create energy")
    shares = np.minimum(shares, 1.0) + 0.0  # -0 and 0 are one
    shares[..., -1][shares[..., -1] > 1.0 - 1e-13] = 1.0
    if len(waves) > 1 and np.ptp(shares, axis=0).max() == 0.0:
        shares = shares[:1]
    tables = [part.table for part in parts[0] if part.table is not None]
    if len(tables) > 1:
        raise InputError(name, len(tables), "one table per surface", "tabulate the whole surface")
    return _Tabled(
        kinds=kinds,
        shares=shares,
        sigmas=np.array([part.sigma_rad for part in parts[0]]),
        cells=_cells(tables[0]) if tables else np.zeros(0),
        nodes=angles[0].size // (2 if side == INSIDE else 1),
        stride=shares[0].size if shares.shape[0] > 1 else 0,
        flat=bool(np.ptp(shares, axis=1).max() == 0.0),
    )


_kept = lru_cache(MOST_TABLED)(_tabled)
"""The same, kept: faces of chips are asked for again and again, by each scene that has them."""


def _cells(table: Tabulated) -> Real:
    """A table of cells as `surfaces.from_table` reads it."""
    edges = table.theta_out_edges_rad
    powers = (table.mean * table.projected_sr).reshape(table.theta_in_rad.size, -1)
    ends = np.concatenate([np.zeros((powers.shape[0], 1)), np.cumsum(powers, axis=1)], axis=1)
    total = ends[:, -1:]
    ends = np.where(total > 0.0, ends / np.where(total > 0.0, total, 1.0), np.linspace(0.0, 1.0, ends.shape[1]))
    upper = (edges[1:] <= np.pi / 2 * (1.0 + 1e-12)).astype(float)
    head = [table.theta_in_rad.size, edges.size - 1, table.phi_out_edges_rad.size - 1, table.images]
    squares = np.sin(np.minimum(edges, np.pi)) ** 2
    return np.concatenate(
        [head, table.theta_in_rad, total[:, 0], squares, upper, table.phi_out_edges_rad, ends.ravel()]
    )


def scene_arrays(scene: Scene) -> SceneArrays:
    """The arrays of a scene. Raises InputError for a surface that kernels cannot draw from."""
    chip, packer = scene.chip, _Packer()
    index = tuple(map(float, chip.index))
    for name, face in (("top", chip.top), ("sides", chip.sides)):
        packer.add(f"chip.{name}.inside", face.inside, index, INSIDE)
        packer.add(f"chip.{name}.outside", face.outside, index, "outside")
    bottom = chip.mirror if chip.mirror is not None else scene.substrate
    wall = scene.layout.wall if isinstance(scene.layout, Array) and scene.layout.wall is not None else Mirror(0.0)
    for name, bsdf in (
        ("chip.bottom", bottom),
        ("substrate", scene.substrate),
        ("receiver", scene.receiver.bsdf),
        ("wall", wall),
    ):
        packer.add(name, (bsdf,))
    response_at = packer.keep(scene.receiver.response)
    offsets_at = packer.keep(scene.layout.offset_um if isinstance(scene.layout, Array) else np.zeros(2))
    tables = (response_at, scene.receiver.response.size, offsets_at)
    return SceneArrays(_numbers(scene), _flags(scene, tables), packer.surfaces())


def emission_arrays(scene: Scene) -> EmissionArrays:
    """The arrays of a scene's emission."""
    emission, layout = scene.emission, scene.layout
    position = np.asarray(emission.position, float)
    power, centres = np.ones(1), np.zeros((1, 2))
    if isinstance(layout, Array):
        power, centres = layout.power.ravel(), layout.centres_um.reshape(-1, 2)
    return EmissionArrays(
        wave_cumulative=np.cumsum(scene.wavelength_weight),
        cosine_quantiles=quantiles(emission.cosine, emission.intensity),
        intensity=_per_solid_angle(emission),
        height_quantiles=np.array(emission.heights),
        row_cumulative=_cumulative(position.sum(axis=1)),
        column_cumulative=np.stack([_cumulative(row) for row in position]),
        chip_cumulative=_cumulative(power)[1:],
        centres_um=centres,
    )


def _numbers(scene: Scene) -> Real:
    layout, chip, receiver = scene.layout, scene.chip, scene.receiver
    origin = layout.origin_um if isinstance(layout, Array) else (0.0, 0.0)
    halves = (layout.half_x_um, layout.half_y_um) if isinstance(layout, Array) else (np.inf, np.inf)
    numbers = (
        layout.spacing_um, scene.distance_um, chip.width_um / 2.0, chip.thickness_um, chip.absorption_per_um,
        chip.absorption_rise_per_um, *scene.tilt_per_um, *halves, *origin, receiver.spread_share, receiver.spread_um,
        scene.leak_share, scene.leak_um,
    )  # fmt: skip
    if len(numbers) != INDEX:
        raise ValueError(f"{len(numbers)} numbers of a scene, not {INDEX}")
    return np.array([*numbers, *chip.index], float)


def _flags(scene: Scene, tables: tuple[int, int, int]) -> NDArray[np.int64]:
    layout, chip = scene.layout, scene.chip
    lossless, clear = {}, {}
    for name, face in (("top", chip.top), ("sides", chip.sides)):
        angles = [
            np.arcsin(1.0 / n) + (np.pi / 2 - np.arcsin(1.0 / n)) * np.linspace(1e-6, 1.0, 65) for n in chip.index
        ]
        lossless[name] = all(
            isinstance(bsdf, Fresnel) or float(bsdf.deltas(theta).mirror.min()) > 1.0 - 1e-12
            for bsdf, theta in zip(face.inside, angles, strict=True)
        )
        clear[name] = lossless[name] and _is_plain(face.inside)
    bottom = chip.mirror if chip.mirror is not None else scene.substrate
    kept = float(bottom.deltas(np.linspace(0.0, np.pi / 2, 65)).mirror.min()) > 1.0 - 1e-13  # as `_tabled` rounds
    air_gap = chip.bottom == "air_gap"
    closed = kept or air_gap
    by_mirror = chip.bottom == "mirror" and isinstance(chip.mirror, Mirror)
    nearly = all(isinstance(bsdf, Facets) and bsdf.deviation <= NEARLY_SMOOTH for bsdf in chip.sides.inside)
    flags = (
        isinstance(layout, Cell), *((layout.rows, layout.columns) if isinstance(layout, Array) else (1, 1)),
        isinstance(layout, Array) and layout.wall is not None, clear["sides"] and _is_plain(chip.top.inside), air_gap,
        closed, scene.emission.from_top, not lossless["top"], *tables,
        by_mirror and all(clear.values()) and not scene.emission.from_top,
        nearly and clear["top"] and (closed or by_mirror),
    )  # fmt: skip
    if len(flags) != FLAGS:
        raise ValueError(f"{len(flags)} flags of a scene, not {FLAGS}")
    return np.array(flags, np.int64)


def _is_plain(waves: tuple[Bsdf, ...]) -> bool:
    """Whether a face only reflects and refracts, its share of each in one part: the unfolded walk reads no others."""
    return all([part.kind for part in parts_of(bsdf)] == [MIRROR, REFRACTED] for bsdf in waves)


def quantiles(x: Real, density: Real) -> Real:
    """Values below which equal steps of probability lie, for a density linear between the points x; (QUANTILES,)."""
    step = np.diff(x)
    cumulative = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2.0 * step)])
    wanted = np.linspace(0.0, cumulative[-1], QUANTILES)
    cell = np.clip(np.searchsorted(cumulative, wanted, "right") - 1, 0, step.size - 1)
    rise, base = (density[cell + 1] - density[cell]) / step[cell], density[cell]
    left = wanted - cumulative[cell]
    root = np.sqrt(np.maximum(base**2 + 2.0 * rise * left, 0.0))
    inside = np.divide(2.0 * left, base + root, out=np.zeros_like(left), where=base + root > 0.0)
    return np.asarray(np.clip(x[cell] + inside, x[0], x[-1]))


def _per_solid_angle(emission: Emission) -> Real:
    at = np.linspace(-1.0, 1.0, QUANTILES)
    intensity = np.interp(at, emission.cosine, emission.intensity, left=0.0, right=0.0)
    total = 2.0 * np.pi * np.trapezoid(emission.intensity, emission.cosine)
    return np.asarray(intensity / total)


def _cumulative(weights: Real) -> Real:
    """Shares up to the end of each weight, a leading 0; equal steps where all weights are 0."""
    total = float(np.sum(weights))
    weights = weights if total > 0.0 else np.ones_like(weights)
    ends = np.concatenate([[0.0], np.cumsum(weights)]) / np.sum(weights)
    ends[-1] = 1.0
    return np.asarray(ends)
