"""What an effect on films is tried on: a stack for each of its hooks, and what holds of every film.

stacks    a DBR; a film on silicon and one on thick glass, as spots of an instrument
rows      the media of that film on silicon, at the wavelengths of a measurement
beside    the DBR of a chip on either side of a module's centre
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from containers.acting import Effects
from containers.effect import StackEffect
from containers.effect_example import Example, Seen, text_of
from containers.stack import StackRows, dbr_of, resolve, with_film
from luxloop.errors import InputError
from luxloop.model_file import find_model
from luxloop.stack import Layer, Medium, Stack
from luxloop.words import parse

Spot = tuple[tuple[float, Stack], ...]
"""Shares of a spot, and what lies there."""

WAVELENGTH_NM = (430.0, 445.0, 460.0)
ASIDE_UM = 1000.0
"""From the centre of a module of 5 x 5 chips to its outer columns."""


def films(kind: type[StackEffect]) -> Iterator[Example[Any]]:
    """The examples of an effect on DBRs, on measured films, or on both."""
    polymer = Layer(medium=Medium(cauchy=(1.5, 0.004)), thickness_nm=300.0)
    glass = Layer(medium=Medium(n=1.52), thickness_nm=5e5, coherent=False)
    air = Medium(n=1.0)
    if "dbr" in kind.of:
        dbr = dbr_of(find_model("paper").environment, 2.5)
        yield Example("a DBR of 2.5 pairs", dbr, _dbr, _spot, _refuse_spot, _spot_kept)
        for side, x_um in (("left", -ASIDE_UM), ("right", ASIDE_UM)):
            yield Example(f"the DBR of a chip on the {side}", dbr, _beside(x_um), _spot, _refuse_spot, _spot_kept)
    if "film" in kind.of:
        on_silicon = with_film(Stack(inside=Medium(material="Si"), layers=(polymer,), outside=air))
        on_glass = with_film(Stack(inside=air, layers=(glass, polymer), outside=air))
        yield Example("a polymer on silicon", on_silicon, Effects.film, _spot, _refuse_spot, _spot_kept)
        yield Example("a polymer on thick glass", on_glass, Effects.film, _spot, _refuse_spot, _spot_kept)
        media = resolve(on_silicon, WAVELENGTH_NM)
        yield Example("the media of a polymer on silicon", media, Effects.rows, _rows, _refuse_rows, _rows_kept)


def _dbr(effects: Effects, stack: Stack) -> Spot:
    return ((1.0, effects.dbr(stack)),)


def _beside(x_um: float) -> Callable[[Effects, Stack], Spot]:
    """The DBR of a chip at x. InputError where the one at the centre is changed: an endless module has it alone."""

    def act(effects: Effects, stack: Stack) -> Spot:
        if effects.beside(stack, 0.0) != stack:
            allowed = "that of a chip at the centre, as it was given"
            raise InputError("beside at x = 0", "another stack", allowed, "put into stack what all chips have")
        return ((1.0, effects.beside(stack, x_um)),)

    return act


def _spot(stacks: Any) -> list[Seen]:
    """Shares and rows of the stacks on a spot, or of a stack alone."""
    stacks = ((1.0, stacks),) if isinstance(stacks, Stack) else stacks
    parts = [[np.array([share]), *_rows(resolve(stack, WAVELENGTH_NM))] for share, stack in stacks]
    return [part for one in parts for part in one] + [text_of(stack.model_dump_json()) for _, stack in stacks]


def _refuse_spot(stacks: Any) -> None:
    """Every layer of a range that can be, and passive: then R + T is at most 1."""
    for share, stack in stacks:
        if not 0.0 <= share <= 1.0:
            raise InputError("share of the spot", share, "0 to 1", "shares of sum 1")
        _refuse_rows(resolve(parse(Stack, stack.model_dump(), "stack"), WAVELENGTH_NM))


def _spot_kept(before: Stack, stacks: Any, law: str) -> None:
    for _, stack in stacks:
        _rows_kept(resolve(before, WAVELENGTH_NM), resolve(stack, WAVELENGTH_NM), law)


def _rows(rows: StackRows) -> list[Seen]:
    return [rows.wavelength_nm, rows.index, rows.thickness_nm, rows.roughness_nm, rows.coherent, rows.film]


def _refuse_rows(rows: StackRows) -> None:
    """Arrays that belong together, layers that can be, and media that are passive."""
    waves, layers = len(WAVELENGTH_NM), rows.thickness_nm.size
    shapes = tuple(part.shape for part in _rows(rows))
    wanted = ((waves,), (waves, layers + 2), (layers,), (layers + 1,), (layers,), (layers,))
    if shapes != wanted or not np.array_equal(rows.wavelength_nm, WAVELENGTH_NM):
        mend = "a medium for each layer and both bulks, at the wavelengths that are given"
        raise InputError("rows", f"shapes {shapes}", f"{wanted}: {layers} layers", mend)
    for name, value in (("thickness_nm", rows.thickness_nm), ("roughness_nm", rows.roughness_nm)):
        if not np.all(np.isfinite(value) & (value >= 0.0)):
            raise InputError(f"rows.{name}", value.tolist(), "0 nm or more")
    if rows.index.imag.min() < 0.0 or rows.index.real.min() <= 0.0:
        worst = rows.index.imag.argmin() if rows.index.imag.min() < 0.0 else rows.index.real.argmin()
        raise InputError("n + ik", complex(rows.index.flat[worst]), "n > 0, k >= 0", "R + T > 1")


def _rows_kept(before: StackRows, after: StackRows, law: str) -> None:
    """A film that absorbs nothing goes on so; every film of isotropic layers is reciprocal."""
    if law == "energy" and after.index.imag.any() and not before.index.imag.any():
        raise InputError("conserves", "a film that absorbs", "k = 0 in all of it", 'leave out "energy"')
