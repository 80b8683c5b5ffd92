"""From the words for a stack (`luxloop.stack`) to the arrays of the kernels, and from pairs to a DBR.

    gan_first, 2.5 pairs:    GaN bulk | GaN AlN GaN AlN GaN | air        R(0) 0.378
    aln_first, 2.5 pairs:    GaN bulk | AlN GaN AlN GaN AlN | air        R(0) 0.009

N.5 pairs end with the material they begin with, so half a pair more turns the mirror into an anti-reflection coating
and back. A GaN layer on the GaN bulk is optically part of it, hence R(gan_first, p) = R(aln_first, p - 0.5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.checked import wavelengths_nm
from containers.materials import material
from luxloop.errors import InputError
from luxloop.model import Environment
from luxloop.stack import Layer, Medium, Stack

LayerOrder = Literal["gan_first", "aln_first"]
AIR = Medium(n=1.0)
GAN, ALN = 0, 1
"""Kinds of DBR layers."""
MAX_PAIRS = 100.0


class Film(Layer):
    """The layer of a measured sample that is called its film: what effects on films act on (`with_film`)."""


@dataclass(frozen=True)
class StackRows:
    """A stack as the kernels read it: media from the inside bulk outwards, M layers, M + 1 faces."""

    wavelength_nm: NDArray[np.float64]
    """(wavelength,), in vacuum."""
    index: NDArray[np.complex128]
    """(wavelength, M + 2), n + ik."""
    thickness_nm: NDArray[np.float64]
    """(M,)"""
    roughness_nm: NDArray[np.float64]
    """(M + 1,), rms height of each face."""
    coherent: NDArray[np.bool_]
    """(M,), False where powers are added instead of amplitudes."""
    film: NDArray[np.bool_]
    """(M,), True for what effects on films act on: a layer that was marked (`with_film`)."""

    @property
    def lossless(self) -> bool:
        """Whether nothing absorbs and nothing scatters: no k, no roughness, all coherent."""
        return not self.index.imag.any() and not self.roughness_nm.any() and bool(self.coherent.all())


def resolve(stack: Stack, wavelength_nm: ArrayLike) -> StackRows:
    """The rows of a stack at each vacuum wavelength (wavelength,) in nm.

    Raises
    ------
    InputError : out of a material's range; a layer that an effect has made thinner than nothing.
    """
    wavelength = wavelengths_nm(wavelength_nm)
    for layer in stack.layers:
        if layer.thickness_nm < 0.0:
            mend = "an effect takes more of it than there is"
            raise InputError("thickness_nm", layer.thickness_nm, "0 nm or more", mend)
    media = [stack.inside, *(layer.medium for layer in stack.layers), stack.outside]
    columns = {medium: _index(medium, wavelength) for medium in set(media)}
    return StackRows(
        wavelength_nm=wavelength,
        index=np.stack([columns[medium] for medium in media], axis=-1),
        thickness_nm=np.array([layer.thickness_nm for layer in stack.layers], dtype=float),
        roughness_nm=np.array([stack.inside_roughness_nm, *(layer.roughness_nm for layer in stack.layers)]),
        coherent=np.array([layer.coherent for layer in stack.layers], dtype=bool),
        film=np.array(films_in(stack), dtype=bool),
    )


def _index(medium: Medium, wavelength: NDArray[np.float64]) -> NDArray[np.complex128]:
    if medium.plus is not None:
        index = _index(medium.model_copy(update={"plus": None}), wavelength) + complex(*medium.plus)
        if index.real.min() <= 0.0 or index.imag.min() < 0.0:
            raise InputError("plus", medium.plus, f"n above 0 and k from 0 on, for all of {medium}", "add less")
        return index
    if medium.material is not None:
        return material(medium.material).index(wavelength)
    if medium.cauchy is not None:
        a, b_um2 = medium.cauchy
        n = a + b_um2 * (1e-3 * wavelength) ** -2
        if np.any(n <= 0.0):
            allowed = "n = a + b / lambda^2 above 0 at all wavelengths"
            raise InputError("cauchy", medium.cauchy, allowed, f"here it comes down to {float(n.min()):g}")
        return n.astype(complex)
    return np.full(wavelength.shape, complex(medium.n or 0.0, medium.k))


def dbr_layers(dbr_pairs: float, layer_order: LayerOrder = "gan_first") -> tuple[int, ...]:
    """Kinds (GAN, ALN) of the layers of a DBR from the bulk outwards; 2 x pairs of them, 0 for a chip without DBR.

    Raises
    ------
    InputError unless `dbr_pairs` is a multiple of 0.5 from 0 to 100 and `layer_order` is known.
    """
    if not 0.0 <= dbr_pairs <= MAX_PAIRS or not float(2 * dbr_pairs).is_integer():
        allowed = f"a multiple of 0.5 from 0 to {MAX_PAIRS:g}"
        raise InputError("dbr_pairs", dbr_pairs, allowed, "N.5 pairs end with the material they begin with")
    if layer_order not in ("gan_first", "aln_first"):
        raise InputError("layer_order", layer_order, "gan_first or aln_first", "which comes first")
    first, second = (GAN, ALN) if layer_order == "gan_first" else (ALN, GAN)
    return tuple(second if j % 2 else first for j in range(round(2 * dbr_pairs)))


def dbr_stack(
    dbr_pairs: float,
    *,
    gan: Medium,
    aln: Medium,
    gan_layer_nm: float,
    aln_layer_nm: float,
    layer_order: LayerOrder = "gan_first",
    inside: Medium | None = None,
    outside: Medium = AIR,
    roughness_nm: float = 0.0,
) -> Stack:
    """The stack of a DBR between its bulk (`inside`, default: the GaN of the layers) and `outside`.

    `gan`, `aln` are the media of the two kinds of layers, `gan_layer_nm`, `aln_layer_nm` their thicknesses,
    `roughness_nm` the rms height of every face. Pairs and order as in `dbr_layers`.
    """
    kinds = {GAN: (gan, gan_layer_nm), ALN: (aln, aln_layer_nm)}
    chosen = [kinds[kind] for kind in dbr_layers(dbr_pairs, layer_order)]
    layers = [Layer(medium=medium, thickness_nm=nm, roughness_nm=roughness_nm) for medium, nm in chosen]
    return Stack(inside=inside or gan, layers=tuple(layers), outside=outside, inside_roughness_nm=roughness_nm)


def dbr_of(environment: Environment, dbr_pairs: float, roughness_nm: float = 0.0) -> Stack:
    """The stack on the chip of an environment: its GaN, its layers and their order, against air (n = 1)."""
    fixed = environment.indices == "fixed"
    return dbr_stack(
        dbr_pairs,
        gan=Medium(n=environment.n_gan) if fixed else Medium(material="GaN"),
        aln=Medium(n=environment.n_aln) if fixed else Medium(material="AlN"),
        gan_layer_nm=environment.gan_layer_nm,
        aln_layer_nm=environment.aln_layer_nm,
        layer_order=environment.layer_order,
        roughness_nm=roughness_nm,
    )


def added(medium: Medium, n: float = 0.0, k: float = 0.0) -> Medium:
    """The medium with n and k larger by so much at all wavelengths; the very same one for zeros."""
    if not n and not k:
        return medium
    if medium.n is not None and medium.plus is None:
        return Medium(n=medium.n + n, k=medium.k + k)
    before = medium.plus or (0.0, 0.0)
    return medium.model_copy(update={"plus": (before[0] + n, before[1] + k)})


def with_layers(stack: Stack, change: Callable[[Layer], Layer]) -> Stack:
    """The stack with each of its layers changed."""
    return stack.model_copy(update={"layers": tuple(map(change, stack.layers))})


def kind_of(layer: Layer, stack: Stack) -> int:
    """GAN or ALN for a layer of a DBR: GaN is what the bulk is made of, or literature's GaN; AlN all else."""
    return GAN if layer.medium == stack.inside or layer.medium.material == "GaN" else ALN


def roughened(stack: Stack, roughness_nm: float) -> Stack:
    """The stack with all its faces rougher; variances of heights add up. The very same one for 0."""
    if not roughness_nm:
        return stack
    rougher = with_layers(stack, lambda layer: layer.model_copy(update=_rougher(layer.roughness_nm, roughness_nm)))
    return rougher.model_copy(
        update={"inside_roughness_nm": float(np.hypot(stack.inside_roughness_nm, roughness_nm))}
    )


def _rougher(before_nm: float, more_nm: float) -> dict[str, float]:
    return {"roughness_nm": float(np.hypot(before_nm, more_nm))}


def with_film(stack: Stack) -> Stack:
    """The stack as it was measured, its film marked: the thickest coherent layer, the innermost of several.

    Whatever effects then do to thicknesses, coherence and neighbours, the film stays the layer that it was. A stack
    without coherent layers has none.
    """
    coherent = [number for number, layer in enumerate(stack.layers) if layer.coherent]
    if not coherent:
        return stack
    film = max(coherent, key=lambda number: stack.layers[number].thickness_nm)
    layers = (Film(**dict(layer)) if number == film else layer for number, layer in enumerate(stack.layers))
    return stack.model_copy(update={"layers": tuple(layers)})


def films_in(stack: Stack) -> list[bool]:
    """Which of the layers are the film: one, none, or all parts of one that an effect cut."""
    return [isinstance(layer, Film) for layer in stack.layers]


def with_index_added(rows: StackRows, added: NDArray[np.complex128] | NDArray[np.float64]) -> StackRows:
    """The rows with dn + i dk (wavelength,) added to the index of the film."""
    index = rows.index.copy()
    index[:, 1:-1] += np.where(rows.film, added[:, None], 0.0)
    return replace(rows, index=index)


def film_face(film: Sequence[bool] | NDArray[np.bool_], side: Literal["inner", "outer"]) -> int:
    """Number of the film's face to the inside (inner) or outside (outer), by which layers are the film.

    Faces are counted from the bulk's, 0. Without a film they are the first and the last face of the stack.
    """
    numbers = np.flatnonzero(film) if np.any(film) else np.arange(len(film))
    if not numbers.size:
        return 0
    return int(numbers[0] if side == "inner" else numbers[-1] + 1)
