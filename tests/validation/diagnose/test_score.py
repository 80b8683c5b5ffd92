"""Score tests on made-up columns, where everything is known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm

from luxloop.effect import EffectParameter, EffectSpec
from validation.diagnose import refit, score
from validation.diagnose.in_words import LEVEL, limits
from validation.diagnose.score import Candidate, Projected, scores
from validation.diagnose.tried import promised
from validation.effects.confounding import confounding, left_beside
from validation.fit.least_squares import Basis, Parameter, basis, reduce

ROWS = 400
RANDOM = np.random.default_rng(5)
FITTED = np.linalg.qr(RANDOM.standard_normal((ROWS, 4)))[0]
PROJECTION = Basis(FITTED, np.zeros((0, 4)))


def candidate(
    name: str, columns: np.ndarray, *, one_sided: bool = False, group: bool = False, **shape: float
) -> Candidate:
    """An effect with these whitened columns."""
    lower = 0.0 if one_sided else -1.0
    parameter = EffectParameter(
        name="size", description="of it", lower=lower, upper=1.0, off=0.0, one_sided=one_sided, per_chip=group
    )
    spec = EffectSpec(name=name, stage="geometry", description=name, parameters=(parameter,))
    return Candidate(spec, parameter, tuple(shape.items()), np.atleast_2d(columns))


def column(seed: int) -> np.ndarray:
    """A column of length 100."""
    found = np.random.default_rng(seed).standard_normal(ROWS)
    return 100.0 * found / np.linalg.norm(found)


def noise(seed: int) -> np.ndarray:
    """What a fit leaves of white noise."""
    return PROJECTION.residual(np.random.default_rng(10_000 + seed).standard_normal(ROWS))


def test_what_an_effect_has_pushed_into_a_prior_is_found_there() -> None:
    """Of a fit that a prior holds: z is that by which chi2 falls once the effect is added, and normal without one.

    By the data rows alone, once projected and once more, z would be 9.8 of 13.8, and have a spread of 0.75.
    """
    level, effect = column(1), 0.8 * column(1) + 0.6 * column(2)
    held, free = Parameter("level", prior_sd=0.01), Parameter("effect")
    every = np.ones(1, bool)

    def left(data: np.ndarray, mean: float = 0.0) -> tuple[Projected, np.ndarray]:
        prior = Parameter("level", prior_mean=mean, prior_sd=0.01)
        reduced = reduce(level[None], data, (prior,), np.zeros(1))
        (found,) = reduced.step().change
        projected = Projected.of([candidate("a", effect)], basis(level[None], reduced, every))
        return projected, np.append(data - found * level, (mean - found) / 0.01)

    data = 0.15 * effect
    without = reduce(level[None], data, (held,), np.zeros(1)).step().chi2
    together = reduce(np.stack([level, effect]), data, (held, free), np.zeros(2)).step()
    best = scores(*left(data), draws=10).effects[0].best
    assert best.z**2 == pytest.approx(without - together.chi2, rel=1e-9)
    assert best.size == pytest.approx(together.change[1], rel=1e-9)
    random = np.random.default_rng(3)
    drawn = [
        scores(*left(random.standard_normal(ROWS), 0.01 * random.standard_normal()), draws=1).effects[0].best.z
        for _ in range(2000)
    ]
    assert np.std(drawn) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("sided", "size"), [(False, 0.05), (True, 0.05), (True, -0.05)])
def test_a_limit_to_which_what_is_missing_drove_the_fit_hides_less_of_it(sided: bool, size: float) -> None:
    """Its score keeps the parameter at the limit; beside the effect it comes back, and chi2 falls by more."""
    level, effect = column(1), 0.8 * column(1) + 0.6 * column(2)
    held = Parameter("level", lower=-0.01, upper=0.01)
    data = size * effect
    at = reduce(level[None], data, (held,), np.zeros(1)).step()
    assert at.at_limit.all()
    residual = data - at.change @ level[None]
    base: Any = SimpleNamespace(
        columns=level[None], residual=residual, values=at.change, at_limit=("level",),
        reduced=reduce(level[None], residual, (held,), at.change),
        problem=SimpleNamespace(unknowns=SimpleNamespace(parameters=(held,))),
    )  # fmt: skip
    tried = candidate("a", effect, one_sided=sided)
    drop, found = refit.expected(base, tried)
    if sided and size < 0.0:
        assert (drop, found) == (0.0, 0.0)
        return
    assert drop == pytest.approx(float(residual @ residual), rel=1e-9)
    assert found == pytest.approx(size, rel=1e-9)
    taken = basis(level[None], base.reduced, np.zeros(1, bool))
    score_of = scores(Projected.of([tried], taken), residual, draws=10).effects[0].best
    assert score_of.drop < 0.99 * drop
    assert score_of.size == pytest.approx(0.84 * size, rel=0.01)
    assert promised(base, score_of) == (drop, found)
    base.at_limit = ()
    assert promised(base, score_of) == (score_of.drop, score_of.size)


def test_a_hidden_effect_is_found_with_its_size_and_error() -> None:
    """Size within its error, which is one over the length of what is left of its column; z is size over error."""
    a = column(1)
    projected = Projected.of([candidate("a", a), candidate("b", column(2))], PROJECTION)
    found = scores(projected, PROJECTION.residual(0.2 * a) + noise(1))
    best = found.effects[0].best
    left = float(np.linalg.norm(PROJECTION.residual(a)))
    assert found.effects[0].name == "a"
    assert best.error == pytest.approx(1.0 / left, rel=1e-9)
    assert abs(best.size - 0.2) < 3.0 * best.error
    assert best.z == pytest.approx(best.size / best.error, rel=1e-9)
    assert found.p < 1e-6


def test_noise_alone_is_called_an_effect_as_often_as_is_said() -> None:
    """The family-wise p is uniform: of 400 sets of noise 5 % lie below 0.05, whatever the effects have in common."""
    a = column(1)
    tried = [candidate("a", a), candidate("like_a", a + 0.3 * column(2)), candidate("b", column(3), one_sided=True)]
    tried += [candidate("c", column(seed), length=float(seed)) for seed in (4, 5, 6)]
    tried += [candidate("many", np.array([column(seed) for seed in range(10, 16)]), group=True)]
    projected = Projected.of(tried, PROJECTION)
    p = np.array([scores(projected, noise(seed), draws=2000).p for seed in range(400)])
    assert 0.02 < np.mean(p < 0.05) < 0.085
    assert 0.42 < np.mean(p < 0.5) < 0.58


def test_a_side_that_does_not_exist_has_no_gain() -> None:
    """A one-sided effect is not called for what only its negative would explain."""
    a = column(1)
    projected = Projected.of([candidate("a", a, one_sided=True)], PROJECTION)
    assert scores(projected, PROJECTION.residual(-0.3 * a)).effects[0].best.drop == 0.0
    assert scores(projected, PROJECTION.residual(0.3 * a)).effects[0].best.drop > 100.0


@pytest.mark.parametrize(("one_sided", "z", "p"), [(True, 1.645, 0.05), (False, 1.645, 0.1), (True, 2.326, 0.01)])
def test_noise_is_on_the_other_side_as_often(one_sided: bool, z: float, p: float) -> None:
    """A one-sided effect at the normal quantile of 5 %: noise does as much in 5 % of cases; either side in 10 %."""
    a = PROJECTION.residual(column(1))
    projected = Projected.of([candidate("a", a, one_sided=one_sided)], PROJECTION)
    found = scores(projected, z * a / np.linalg.norm(a))
    assert found.effects[0].best.drop == pytest.approx(z**2, rel=1e-9)
    assert found.effects[0].p == pytest.approx(p, rel=0.2)
    assert found.p == pytest.approx(p, rel=0.2)


def test_all_variances_twice_as_large_make_errors_larger_and_sizes_the_same() -> None:
    """By the root of two; z is smaller by it."""
    a = column(1)
    projected = Projected.of([candidate("a", a)], PROJECTION)
    one, two = (
        scores(projected, PROJECTION.residual(0.2 * a), scale, draws=10).effects[0].best for scale in (1.0, 2.0)
    )
    assert one.size == pytest.approx(0.2, rel=1e-9)
    assert two.size == pytest.approx(0.2, rel=1e-9)
    assert two.error == pytest.approx(np.sqrt(2.0) * one.error, rel=1e-9)
    assert two.z == pytest.approx(one.z / np.sqrt(2.0), rel=1e-9)


def test_beyond_what_was_drawn_a_chance_counts_every_shape() -> None:
    """Of three shapes at 6 sigma three times that of one, 1.97e-9; drawn, it would be a ten-thousandth."""
    shapes = [candidate("a", PROJECTION.residual(column(seed)), length=float(seed)) for seed in (1, 2, 3)]
    along = 6.0 * shapes[0].columns[0] / np.linalg.norm(shapes[0].columns[0])
    few, many = (scores(Projected.of(some, PROJECTION), along, draws=1000) for some in (shapes[:1], shapes))
    assert few.effects[0].p == pytest.approx(1.973e-9, rel=1e-3)
    assert many.effects[0].p == pytest.approx(3.0 * 1.973e-9, rel=1e-3)
    assert many.p == pytest.approx(3.0 * 1.973e-9, rel=1e-3)


def test_what_the_fit_can_do_anyway_is_not_testable() -> None:
    """An effect inside of what is fitted, and one without any image, are told apart from the others."""
    tried = [candidate("inside", FITTED[:, 0]), candidate("nothing", np.zeros(ROWS)), candidate("a", column(1))]
    assert Projected.of(tried, PROJECTION).untestable == ("inside", "nothing")


def test_the_best_shape_is_taken_and_paid_for() -> None:
    """Of three shapes the true one; its chance is that of the largest of three."""
    shapes = [candidate("a", column(seed), length=float(seed)) for seed in (1, 2, 3)]
    found = scores(Projected.of(shapes, PROJECTION), PROJECTION.residual(0.05 * column(2)) + noise(3))
    assert dict(found.effects[0].best.candidate.shape) == {"length": 2.0}
    single = scores(Projected.of(shapes[1:2], PROJECTION), PROJECTION.residual(0.05 * column(2)) + noise(3))
    assert found.effects[0].p > single.effects[0].p


def test_a_group_is_found_by_its_energy_and_not_in_one_member() -> None:
    """Six chips displaced by random amounts: the group beats each single column, its rms is found."""
    members = np.array([column(seed) for seed in range(20, 26)])
    sizes = 0.15 * np.random.default_rng(0).standard_normal(6)
    tried = [candidate("all", members, group=True), candidate("one", members[0])]
    found = scores(Projected.of(tried, PROJECTION), PROJECTION.residual(sizes @ members) + noise(4))
    assert found.effects[0].name == "all"
    assert found.effects[0].best.size == pytest.approx(np.sqrt(np.mean(sizes**2)), rel=0.3)


def test_a_loud_group_is_not_outrun_by_effects_that_take_less() -> None:
    """Where no number is small enough for the chance of its energy, it still counts in full."""
    members = np.array([column(seed) for seed in range(20, 26)])
    hidden = np.array([3.0, -2.0, 4.0, -3.0, 2.5, -3.5]) @ members
    half = 0.7 * hidden + 200.0 * column(60)
    tried = [candidate("all", members, group=True), candidate("half", half)]
    found = scores(Projected.of(tried, PROJECTION), PROJECTION.residual(hidden))
    by_name = {one.name: one.best.drop for one in found.effects}
    assert found.effects[0].name == "all"
    assert by_name["all"] == pytest.approx(float(np.sum(PROJECTION.residual(hidden) ** 2)), rel=0.1)
    assert 1400.0 < by_name["half"] < by_name["all"]


@pytest.mark.parametrize("weights", [(1.0,), (1.0,) * 24, (1.0, *[0.1] * 9), (1.0, 0.5, 0.25, 0.125, 0.06, 0.03)])
def test_a_groups_sigma_are_as_rare_as_they_say(weights: tuple[float, ...]) -> None:
    """However unevenly the fit leaves its members: of 400,000 draws as many lie beyond as of a normal number's."""
    weight, random = np.array(weights), np.random.default_rng(3)
    drawn = np.sqrt(weight)[:, None] * random.standard_normal((len(weight), 400_000))
    z = score._group_z(drawn, np.diag(weight))
    for told in (1.5, 2.5, 3.5):
        least, most = (400_000 * norm.sf(told + by) for by in (0.03, -0.03))
        assert least - 3.0 * np.sqrt(least) < np.sum(z > told) < most + 3.0 * np.sqrt(most)


@pytest.mark.parametrize("members", [1, 5, 24])
def test_a_chance_too_small_for_a_number_goes_on_from_one_that_is_not(members: int) -> None:
    """Against scipy's own chi2 as far as that reaches; beyond, all of the energy counts, less noise's share."""
    energy = np.linspace(40.0, 1300.0, 20)
    products = np.sqrt(energy / members) * np.ones((members, 1))
    z = score._group_z(products, np.eye(members))
    np.testing.assert_allclose(norm.logsf(z), chi2.logsf(energy, members), rtol=0.0, atol=0.16 / members)
    far = score._group_z(1e6 * np.ones((members, 1)), np.eye(members))
    assert far[0] == pytest.approx(1e6 * np.sqrt(members), rel=1e-6)


def test_most_of_a_groups_energy_along_one_member_counts_as_its_own() -> None:
    """However many others the fit hardly leaves: 13 sigma of the one are 13 of all, not 17."""
    gram = np.diag([1.0, *[0.1] * 9])
    z = score._group_z(np.array([[13.0], *[[0.0]] * 9]), gram)
    assert 12.5 < z[0] < 13.0


def test_the_error_of_a_spread_is_how_far_it_scatters() -> None:
    """Of 300 draws of members and noise, for a spread far above the noise and one of none."""
    members = np.array([column(seed) for seed in range(20, 32)])
    projected = Projected.of([candidate("all", members, group=True)], PROJECTION)
    random = np.random.default_rng(11)
    for spread in (0.1, 0.0):
        found = [
            scores(projected, PROJECTION.residual(spread * random.standard_normal(12) @ members) + noise(k), draws=10)
            for k in range(300)
        ]
        sizes, errors = (
            np.array([getattr(one.effects[0].best, name) for one in found]) for name in ("size", "error")
        )
        if spread:
            assert np.median(errors) == pytest.approx(np.std(sizes), rel=0.25)
        assert np.mean(np.abs(sizes - spread) < 2.0 * errors) > 0.85


def test_groups_of_alike_effects_are_boxed() -> None:
    """Cosine 0.99 and -0.99 are one group; an orthogonal one stands alone; signs are kept."""
    a, b = column(1), column(2)
    b = b - a * (a @ b) / (a @ a)
    found = confounding({"a": a[None], "b": b[None], "like": (a + 0.1 * b)[None], "against": (-a + 0.1 * b)[None]})
    assert set(found.groups[0]) == {"a", "like", "against"}
    assert found.group_of("b") == ("b",)
    assert found.cosines[0, 3] == pytest.approx(-0.995, abs=1e-3)
    assert found.rivals("a")[0][0] in ("like", "against")


def test_what_is_left_beside_a_rival() -> None:
    """The sine of the angle between them."""
    a, b = column(1), column(2)
    cosine = float(a @ b) / 1e4
    assert left_beside(a, [b[None]]) == pytest.approx(100.0 * np.sqrt(1.0 - cosine**2), rel=1e-6)
    assert left_beside(a, []) == pytest.approx(100.0)


def test_the_error_of_a_refitted_spread_is_how_far_it_scatters() -> None:
    """Of 300 draws of 12 members far above the noise: the spread of 12 numbers is known to one in sqrt(24)."""
    one = candidate("all", np.array([column(seed) for seed in range(20, 32)]), group=True)
    random, known = np.random.default_rng(12), SimpleNamespace(parameters=())
    found = []
    for k in range(300):
        residual = PROJECTION.residual(0.1 * random.standard_normal(12) @ one.columns) + noise(k)
        base: Any = SimpleNamespace(
            basis=PROJECTION, residual=residual, residual_with_priors=residual, chi2=float(residual @ residual),
            values=np.zeros(0), problem=SimpleNamespace(unknowns=known),
        )  # fmt: skip
        found.append(refit.spread(base, one))
    values, errors = (np.array([getattr(each, name) for each in found]) for name in ("value", "error"))
    assert np.median(values) == pytest.approx(0.1, rel=0.05)
    assert np.median(errors) == pytest.approx(0.1 / np.sqrt(24.0), rel=0.1)
    assert np.std(values) == pytest.approx(0.1 / np.sqrt(24.0), rel=0.15)


def test_a_larger_score_is_never_the_likelier_one() -> None:
    """35 effects, of which one stands out: beyond few draws its own chance is reckoned, and that of all went down to
    a thirtieth and back; by Sidak, 1 - (1 - p)^35 of the own p."""
    columns = np.linalg.qr(np.random.default_rng(3).standard_normal((ROWS, 35)))[0].T
    rows = [PROJECTION.residual(one) for one in columns]
    projected = Projected.of([candidate(f"e{k}", one) for k, one in enumerate(rows)], PROJECTION)
    along = rows[0] / np.linalg.norm(rows[0])
    z = np.arange(3.0, 4.4, 0.05)
    alone = 2.0 * norm.sf(z)
    right = 1.0 - (1.0 - alone) ** 35
    off = []
    for seed in (1, 2, 3, 4):  # of one the chances stand on counts from 11 up, other ones on another processor
        p = np.array([scores(projected, one * along, seed=seed).p for one in z])
        assert np.all(np.diff(p) <= 0.0)
        off.append(np.log(p / right))
    assert np.all(np.abs(np.mean(off, axis=0))[z < 4.0] < 0.35)


def test_what_would_have_been_seen_pays_for_its_shapes() -> None:
    """With 90 % power at the level of a verdict, for one shape and the best of five."""
    one = [candidate("a", column(1), length=1.0)]
    five = [candidate("a", column(k), length=float(k)) for k in (1, 2, 3, 4, 5)]
    for tried, shapes in ((one, 1), (five, 5)):
        found = scores(Projected.of(tried, PROJECTION), 1e-6 * column(1), draws=100)
        ((_, _, value, _),) = limits(found)
        wanted = norm.isf(LEVEL / 4.0 / shapes) + norm.isf(0.1)
        assert value == pytest.approx(wanted * found.effects[0].best.error, rel=1e-9)
