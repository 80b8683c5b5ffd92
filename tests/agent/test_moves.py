"""The space and its moves: nothing outside the box, nothing that cannot be built, nothing twice."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.moves import Moves, Profile, Space, key_of, moves_of, start_of
from luxloop.campaign import Move
from luxloop.design import Bounds, Design
from luxloop.errors import InputError
from tests.objectives import BOUNDS

AXES = [BOUNDS.values(name) for name in Design.FIELDS]
grid_points = st.tuples(*(st.sampled_from(axis) for axis in AXES))
spaces = st.builds(
    Space, st.just(BOUNDS), st.sampled_from(["substrate", "chip_top"]), st.sampled_from(["pitch", "gap"])
)


def test_profiles_have_the_papers_ten_moves_and_forty() -> None:
    """Each variable up and down by one step; `fast` also by 2, 4 and 8; no move twice."""
    ten, forty = moves_of("paper"), moves_of("fast")
    assert {(move.variable, move.steps) for move in ten} == {(name, s) for name in Design.FIELDS for s in (1, -1)}
    assert len(forty) == len(set(forty)) == 40
    assert {abs(move.steps) for move in forty} == {1, 2, 4, 8}


@settings(max_examples=60, derandomize=True, deadline=None)
@given(space=spaces, key=grid_points, profile=st.sampled_from(["paper", "fast"]))
def test_the_mask_offers_exactly_what_may_be_built(space: Space, key: tuple[float, ...], profile: Profile) -> None:
    """A move is offered where its design lies in the box and is feasible, and nowhere else."""
    moves = Moves(space, profile)
    offered = moves.mask(key)
    for move, may in zip(moves.all, offered, strict=True):
        change = move.steps * getattr(BOUNDS.step, move.variable)
        here = Design.from_vector(key)
        target = here.model_copy(update={move.variable: getattr(here, move.variable) + change})
        good = BOUNDS.contains(target) and target.feasibility(space.distance_from, space.spacing_is) is None
        assert bool(may) == good


def test_bounds_are_on_the_grid_of_designs() -> None:
    """A third of a millimetre for a pitch that stays: all designs have it, and lie in the box."""
    low, high = (150.0, 20.0, 1000.0 / 3.0, 10.0, 5.0), (180.0, 60.0, 1000.0 / 3.0, 20.0, 6.0)
    space = Space(Bounds(low=Design.from_vector(low), high=Design.from_vector(high), step=BOUNDS.step))
    here = space.draw(np.random.default_rng(1))
    assert here is not None
    assert here[2] == 333.333333
    assert space.bounds.contains(Design.from_vector(here))
    assert Moves(space, "fast").mask(here).any()


def test_a_known_design_is_not_offered_again() -> None:
    """What is known drops out of the mask, and only that."""
    space = Space(BOUNDS, spacing_is="gap")
    moves, here = Moves(space, "fast"), (100.0, 50.0, 500.0, 25.0, 6.5)
    known = {space.moved(here, moves.all[i]) for i in (0, 7, 14)}
    lost = np.flatnonzero(moves.mask(here) & ~moves.mask(here, known))
    assert lost.tolist() == [0, 7, 14]


def test_infeasible_moves_are_offered_on_request() -> None:
    """Without `build` only the bounds count: D 20 stays an option over a chip of 15 um and 5 um of clearance."""
    moves, here = Moves(Space(BOUNDS), "paper"), (20.0, 50.0, 500.0, 15.0, 6.5)
    down = moves.number[Move(variable="distance_um", steps=-1)]
    up = moves.number[Move(variable="thickness_um", steps=1)]
    assert not moves.mask(here)[[down, up]].any()
    assert moves.mask(here, build=False)[[down, up]].all()


def test_a_fixed_variable_has_no_moves() -> None:
    """Where low = high no move of that variable is offered."""
    high = BOUNDS.high.model_copy(update={"dbr_pairs": BOUNDS.low.dbr_pairs})
    moves = Moves(Space(Bounds(low=BOUNDS.low, high=high, step=BOUNDS.step)), "fast")
    offered = moves.mask((100.0, 50.0, 500.0, 25.0, 4.5))
    assert {moves.all[i].variable for i in np.flatnonzero(offered)} == set(Design.FIELDS) - {"dbr_pairs"}


def test_draws_are_on_the_grid_feasible_and_never_twice() -> None:
    """On a small grid each design that can be built is drawn once, then there is none."""
    low, step = (Design.from_vector(v) for v in ((20.0, 10.0, 300.0, 5.0, 4.5), (10.0, 2.0, 20.0, 10.0, 1.0)))
    bounds = Bounds(low=low, high=Design.from_vector((40.0, 12.0, 320.0, 25.0, 5.5)), step=step)
    space, random = Space(bounds), np.random.default_rng(5)
    drawn: dict[tuple[float, ...], None] = {}
    while (key := space.draw(random, drawn)) is not None:
        assert key not in drawn
        drawn[key] = None
    assert set(drawn) == {key_of(design) for design in bounds.grid() if design.feasibility() is None}


@pytest.mark.parametrize("start", [(190.0, 10.0, 300.0, 5.0, 4.5), (10.0, 10.0, 300.0, 55.0, 4.5)])
def test_a_start_that_cannot_be_is_refused(start: tuple[float, ...]) -> None:
    """Outside the bounds, or without room under the receiver: an InputError that names it."""
    with pytest.raises(InputError, match="start"):
        start_of(Space(BOUNDS), Design.from_vector(start))


def test_the_designer_and_the_controller_move_alike() -> None:
    """What `Space.moved` reckons with is what `Bounds.moved` gives, or outside of the box for both."""
    bounds = BOUNDS
    space, random = Space(bounds), np.random.default_rng(1)
    for _ in range(300):
        key = space.draw(random)
        assert key is not None
        move = moves_of("fast")[random.integers(40)]
        there = bounds.moved(Design.from_vector(key), move.variable, move.steps)
        reached = space.moved(key, move)
        inside = all(
            low <= x <= high
            for low, x, high in zip(bounds.low.as_vector(), reached, bounds.high.as_vector(), strict=True)
        )
        assert (there is not None) == inside
        assert there is None or key_of(there) == reached
