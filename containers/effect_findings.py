"""What is asked of an effect before it is used: an example of its stage, the laws that hold there, a time limit.

off      at its off value the example comes back bit for bit
acts     inside the range, and at its ends, it makes something that a worker can use, of its stage alone, that
         is finite, does not shine more than it is lit, and takes less than `ACT_S`; told is what it changes
again    the same comes of the same, and what it was given stays as it was
conserves energy, reciprocity    where it says so
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from containers.acting import Effects
from containers.effect import CurveEffect, Effect, SceneEffect, StackEffect
from containers.effect_example import SHARE, Example, Seen
from containers.effect_on_films import films
from containers.effect_on_images import curves, images
from containers.effect_on_scenes import SIDE, scenes
from luxloop.effect import EffectParameter, EffectSpec, Value
from luxloop.errors import InputError
from luxloop.words import parse

Look = Callable[[], str]

ACT_S = 1.0


def findings_of(kind: type[Effect], spec: EffectSpec) -> Iterator[tuple[str, Look]]:
    """What to look at, one by one: a name, and a look that tells what it found or raises what is wrong."""
    examples, values = examples_of(kind), list(inside(spec))
    yield "off", lambda: _off(kind, spec, examples)
    yield "acts", lambda: _acts(kind, values, examples)
    yield "again", lambda: _again(kind, values[0], examples)
    for law in spec.conserves:
        yield f"conserves {law}", lambda law=law: _conserves(kind, values, examples, law)  # type: ignore[misc]


def examples_of(kind: type[Effect]) -> list[Example[Any]]:
    """What an effect of that class is tried on: one thing or more for each of its hooks."""
    if issubclass(kind, StackEffect):
        return list(films(kind))
    if issubclass(kind, SceneEffect):
        return list(scenes())
    return list(curves() if issubclass(kind, CurveEffect) else images())


def inside(spec: EffectSpec) -> Iterator[dict[str, Value]]:
    """Values of the parameters: a third of the way from off, then both ends, then every value of every shape."""
    middle = {one.name: _at(one, 1.0 / 3.0) for one in spec.parameters}
    yield middle
    for share in (1.0, -1.0):
        yield {one.name: _at(one, share) for one in spec.parameters}
    for one in spec.parameters:
        for shape in one.shape_grid or one.choices:
            yield middle | {one.name: shape}


def _at(one: EffectParameter, share: float) -> Value:
    """The value that share of the way from off to the upper end, below 0 to the lower one; of chips every other."""
    if one.off is None or one.choices:
        grid = one.shape_grid or one.choices
        return grid[len(grid) // 2] if grid[len(grid) // 2] != one.off else grid[0]
    off, lower, upper = float(one.off), float(one.lower or 0.0), float(one.upper or 0.0)
    end = upper if (share > 0.0 and upper > off) or lower >= off else lower
    value = end if abs(share) == 1.0 else off + abs(share) * (end - off)
    return tuple([value, off] * (SIDE**2 // 2) + [value]) if one.per_chip else value


def _off(kind: type[Effect], spec: EffectSpec, examples: Sequence[Example[Any]]) -> str:
    if all(one.off is None for one in spec.parameters):
        return "it has no off value: it is absent where it is left out"
    shapes: list[dict[str, Value]] = [{}]
    shapes += [{one.name: x} for one in spec.parameters if one.off is None for x in one.shape_grid or one.choices]
    for shape in shapes:
        effects = Effects((kind.at_off(**shape),))
        for example in examples:
            before, after = example.seen(example.thing), example.seen(example.act(effects, example.thing))
            if not _same(before, after):
                where = f"{spec.name} at off" + "".join(f", {name} {value}" for name, value in shape.items())
                mend = "give back what came in where the parameter is at off"
                raise InputError(where, f"{example.name} changed", "the same to the last bit", mend)
    return f"{', '.join(one.name for one in examples)}: the same to the last bit"


def _acts(kind: type[Effect], values: Sequence[dict[str, Value]], examples: Sequence[Example[Any]]) -> str:
    longest_s, changed = 0.0, dict.fromkeys((one.name for one in examples), False)
    for given in values:
        effects = Effects((parse(kind, given),))
        for example in examples:
            try:
                found, taken_s = _timed(example, effects)
                example.refuse(found)
            except InputError as error:
                error.args = (f"{example.name}, {_told(given)}: {error}",)
                raise
            longest_s = max(longest_s, taken_s)
            changed[example.name] |= not _same(example.seen(example.thing), example.seen(found))
    touched = ", ".join(name for name, is_so in changed.items() if is_so)
    said = f"it changes {touched}" if touched else f"it changes nothing of {', '.join(changed)}"
    return f"{len(values)} settings inside the range: {said}; one act takes at most {1e3 * longest_s:.2g} ms"


def _again(kind: type[Effect], given: dict[str, Value], examples: Sequence[Example[Any]]) -> str:
    effects = Effects((parse(kind, given),))
    for example in examples:
        before = [part.copy() for part in example.seen(example.thing)]
        first, second = (example.seen(example.act(effects, example.thing)) for _ in range(2))
        if not _same(first, second):
            mend = "an effect draws no random numbers and remembers nothing"
            raise InputError(example.name, "two results of the same values", "one", mend)
        if not _same(before, example.seen(example.thing)):
            raise InputError(example.name, "it was changed in place", "untouched", "make a copy, change that")
    return "the same of the same; what it is given stays as it was"


def _timed(example: Example[Any], effects: Effects) -> tuple[Any, float]:
    """What an act gives, and its time in s, the shorter of two where the first is long; InputError over `ACT_S`."""
    taken_s: list[float] = []
    while not taken_s or (taken_s[-1] > ACT_S and len(taken_s) < 2):
        begin_s = time.perf_counter()
        found = example.act(effects, example.thing)
        taken_s.append(time.perf_counter() - begin_s)
    if min(taken_s) > ACT_S:
        raise InputError(
            "one act", f"{min(taken_s):.1f} s", f"at most {ACT_S:g} s", "do less, or do it once at import"
        )
    return found, min(taken_s)


def _conserves(
    kind: type[Effect], values: Sequence[dict[str, Value]], examples: Sequence[Example[Any]], law: str
) -> str:
    for given in values:
        for example in examples:
            example.conserved(example.thing, example.act(Effects((parse(kind, given),)), example.thing), law)
    return f"{law} is conserved" + (f" within {SHARE:g}" if law == "energy" else "")


def _told(given: dict[str, Value]) -> str:
    return ", ".join(f"{name} {'per chip' if isinstance(value, tuple) else value}" for name, value in given.items())


def _same(before: Sequence[Seen], after: Sequence[Seen]) -> bool:
    return len(before) == len(after) and all(
        a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in zip(before, after, strict=True)
    )
