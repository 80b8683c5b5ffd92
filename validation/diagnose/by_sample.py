"""The fit with an effect that each sample has its own of: a value for every sample, or for every chip of each.

    chips      members are normal about off; their spread is fitted with them, and kept as the prior of all
    samples    a tilt, a weak chip: no prior; a sample whose chi2 it hardly lowers stays without

Columns are those of every member by itself: first at the fit without the effect, then once more where the fit with it
ended; about Monte Carlo there, where the twin does not know the effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectParameter, EffectSpec, Value
from luxloop.errors import InputError
from luxloop.model import Fit as Limits
from luxloop.model import Model
from validation.diagnose.evidence import drawn_back
from validation.diagnose.frozen import slopes_of
from validation.diagnose.refit import LEAST_DROP, LEAST_SHARE, posed, with_slopes
from validation.diagnose.refitted import limits_of
from validation.effects.known import acting, applied, is_smooth, off_values, shapes_of, with_effect
from validation.effects.signatures import Column, Projection
from validation.fit import Fit, refitted
from validation.fit.anchored_fit import ANCHOR_MOVE, MAX_ANCHORS, moved
from validation.sample_values import Member, free_members, with_members, with_sample

Real = NDArray[np.float64]
Columns = Callable[[Fit, EffectSpec, Mapping[str, Value]], list[Column]]
"""The columns of an effect at a fit, in a shape, apart for every sample."""


def is_by_sample(spec: EffectSpec) -> bool:
    """Whether each sample has its own of an effect that has a size."""
    return bool(acting(spec)) and (spec.scope == "per_sample" or any(one.per_chip for one in spec.parameters))


@dataclass(frozen=True, eq=False)
class Own:
    """What a sample has of an effect: in which shape, with which columns."""

    shape: Mapping[str, Value]
    columns: tuple[Column, ...]
    size: Real
    """(column,), in the score variable, that is expected of each."""
    drop: float
    """Of chi2, that is expected."""


def with_own_values(base: Fit, spec: EffectSpec, columns_at: Columns) -> Fit:
    """The fit with an effect of which each sample has its own.

    Raises InputError where it shows in no sample.
    """
    own, spread = _chosen(base, spec, columns_at)
    model, start = _begun(base.model, spec, own, spread)
    slopes: dict[str, Sequence[Real]] = {**slopes_of(base)}
    slopes |= {member.path: column.parts for member, column in _members(own)}
    squares, lines = _squares(spec, own), frozenset([] if is_smooth(spec) else [spec.name])
    frozen, at = with_slopes(base.problem, slopes, squares, lines), base.problem.unknowns.named(base.values)
    found = refitted(*posed(frozen, model, tuple(slopes), at | start))
    for _ in range(1 if is_smooth(spec) else MAX_ANCHORS):
        before, found = found, _settled(base, found, spec, own, columns_at)
        if moved(found, before, tuple(start)) <= ANCHOR_MOVE:
            break
    return found


def with_members_free(base: Fit, specs: Sequence[EffectSpec], columns_at: Columns) -> Fit:
    """The fit of a model that has values by sample, these moving too; `base`: the same with them held."""
    free = free_members(base.model)
    slopes, squares = dict[str, Sequence[Real]](), set[str]()
    for spec in specs:
        columns = columns_at(base, spec, {})
        known = {_member(one).path: one for one in columns if _member(one).path in free}
        slopes |= {path: column.parts for path, column in known.items()}
        squares |= {path for path, column in known.items() if _parameter(spec, column).score_variable == "square"}
    lines = frozenset(spec.name for spec in specs if not is_smooth(spec))
    start = {path: free[path][1] for path in slopes}
    frozen, own = with_slopes(base.problem, slopes, frozenset(squares), lines), base.problem.unknowns
    return refitted(*posed(frozen, base.model, (*own.model_paths, *slopes), own.named(base.values) | start))


def _settled(base: Fit, found: Fit, spec: EffectSpec, own: Mapping[str, Own], columns_at: Columns) -> Fit:
    """The fit once more, with columns where it ended, and the spread that its members show with their errors."""
    shapes = {tuple(sorted(one.shape.items())): one.shape for one in own.values()}
    parts = {
        _member(one).path: one.parts
        for shape in shapes.values()
        for one in columns_at(found, spec, shape)
        if one.sample in own and own[one.sample].shape == shape
    }
    problem = replace(found.problem, predictor=base.problem.predictor, predict_curves=base.problem.predict_curves)
    if not is_smooth(spec) and problem.anchor is not None:
        poses = tuple(found.poses.values())
        problem = replace(problem, anchor=replace(problem.anchor, model=found.model, poses=poses))
    frozen = with_slopes(problem, parts, _squares(spec, own), frozenset([] if is_smooth(spec) else [spec.name]))
    model = found.model.model_copy(update={"fit": found.model.fit | _renewed(found, spec, own)})
    known = found.problem.unknowns
    return refitted(*posed(frozen, model, known.model_paths, known.named(found.values)))


def _renewed(found: Fit, spec: EffectSpec, own: Mapping[str, Own]) -> dict[str, Limits]:
    """The [fit] tables with the root of the mean of value^2 + error^2 of a group's members: its spread."""
    groups: dict[str, list[float]] = {}
    for member, column in _members(own):
        one = _parameter(spec, column)
        if one.per_chip:
            off = float(one.off or 0.0)
            square = (found.value(member.path) - off) ** 2 + found.error(member.path) ** 2
            groups.setdefault(member.limits_path, []).append(square)
    alike = [square for some in groups.values() for square in some]  # along x and along y alike
    sd = float(np.sqrt(np.mean(alike))) if alike else 0.0
    return {path: found.model.fit[path].model_copy(update={"prior_sd": sd}) for path in groups}


def _chosen(base: Fit, spec: EffectSpec, columns_at: Columns) -> tuple[dict[str, Own], float | None]:
    """What each sample has of it, and of a group the spread. Raises InputError where it shows nowhere."""
    projection = Projection.of(base)
    tried = [_by_sample(base, spec, shape, columns_at(base, spec, shape), projection) for shape in shapes_of(spec)]
    own: dict[str, Own] = {}
    for some in tried:
        for sample, one in some.items():
            own[sample] = one if sample not in own or one.drop > own[sample].drop else own[sample]
    if any(one.per_chip for one in spec.parameters):
        return _with_spread(base, spec, own, projection)
    shown = {sample: one for sample, one in own.items() if one.drop >= LEAST_DROP}
    if not shown:
        most = max((one.drop for one in own.values()), default=0.0)
        allowed = f"an effect that lowers chi2 of a sample by {LEAST_DROP:g} or more"
        mend = f"the most that it does is {most:.2g}; luxloop diagnose tells what the data show"
        raise InputError("EFFECT", spec.name, allowed, mend)
    return shown, None


def _by_sample(
    base: Fit, spec: EffectSpec, shape: Mapping[str, Value], columns: Sequence[Column], projection: Projection
) -> dict[str, Own]:
    """Each sample's columns in a shape, with the sizes that they ask for within their ranges."""
    found = {}
    for sample in dict.fromkeys(one.sample for one in columns):
        some = tuple(one for one in columns if one.sample == sample)
        rows = _left(base, some, projection)
        along, gram = rows @ base.residual_with_priors, rows @ rows.T
        sizes = zip(some, np.linalg.lstsq(gram, along, rcond=1e-10)[0], strict=True)
        size = np.array([_within(_parameter(spec, one), float(value)) for one, value in sizes])
        found[sample] = Own(shape, some, size, float(2.0 * along @ size - size @ gram @ size))
    return found


def _with_spread(
    base: Fit, spec: EffectSpec, own: Mapping[str, Own], projection: Projection
) -> tuple[dict[str, Own], float]:
    """The members of all samples drawn back to off by the spread that they have together."""
    if not own:
        mend = "the power and the place of a single chip are its image's gain and place"
        raise InputError("EFFECT", spec.name, "an effect on modules of several chips", mend)
    columns = [column for one in own.values() for column in one.columns]
    _, upper = limits_of(_parameter(spec, columns[0]))
    spread, size, _ = drawn_back(_left(base, columns, projection), base.residual_with_priors, upper)
    ends = np.cumsum([len(one.columns) for one in own.values()])[:-1]
    parts = np.split(size, ends)
    return {sample: replace(one, size=part) for (sample, one), part in zip(own.items(), parts, strict=True)}, spread


def _begun(
    model: Model, spec: EffectSpec, own: Mapping[str, Own], spread: float | None
) -> tuple[Model, dict[str, float]]:
    """The model with the effect: off in general, with values of its own in each sample, and the values by path."""
    limits, start = dict[str, Limits](), dict[str, float]()
    model = with_effect(model, applied(spec, off_values(spec, next(iter(own.values())).shape)))
    for sample, one in own.items():
        chips = 1 + max((column.chip or 0 for column in one.columns), default=0)
        model = with_sample(model, sample, spec.name, off_values(spec, one.shape, chips))
    for (member, column), size in zip(_members(own), np.concatenate([o.size for o in own.values()]), strict=True):
        parameter = _parameter(spec, column)
        lower, upper = limits_of(parameter)
        least = LEAST_SHARE * (upper - lower)
        start[member.path] = float(np.clip(_value(parameter, float(size)), lower + least, upper - least))
        prior = (float(parameter.off or 0.0), spread) if parameter.per_chip else (None, None)
        limits[member.limits_path] = Limits(
            free=True, lower=lower, upper=upper, prior_mean=prior[0], prior_sd=prior[1]
        )
    model = model.model_copy(update={"fit": model.fit | limits})
    return with_members(model, start), start


def _left(base: Fit, columns: Sequence[Column], projection: Projection) -> Real:
    """Whitened columns, less what the fit's own parameters do."""
    rows = np.array([projection.rows(one) for one in columns])
    return base.basis.left(rows)


def _members(own: Mapping[str, Own]) -> list[tuple[Member, Column]]:
    return [(_member(column), column) for one in own.values() for column in one.columns]


def _member(column: Column) -> Member:
    return Member(column.sample, column.effect, column.parameter, column.chip)


def _parameter(spec: EffectSpec, column: Column) -> EffectParameter:
    return next(one for one in spec.parameters if one.name == column.parameter)


def _squares(spec: EffectSpec, own: Mapping[str, Own]) -> frozenset[str]:
    """Paths of members whose image goes with their square."""
    both = ((member.path, _parameter(spec, column)) for member, column in _members(own))
    return frozenset(path for path, one in both if one.score_variable == "square")


def _value(one: EffectParameter, size: float) -> float:
    """The parameter at a size of its score variable."""
    return float(one.off or 0.0) + (float(np.sqrt(max(size, 0.0))) if one.score_variable == "square" else size)


def _within(one: EffectParameter, size: float) -> float:
    """A size brought back to where the parameter is in its range."""
    lower, upper = limits_of(one)
    value = float(np.clip(_value(one, size), lower, upper)) - float(one.off or 0.0)
    return value**2 if one.score_variable == "square" else value
