"""Random, pattern and grid search: complete, exact where they must be, the same after a restart."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from agent.ask_tell import Checkpoint
from agent.designers import designer
from agent.moves import Space, key_of
from agent.searches import GridSearch, PatternSearch, RandomSearch
from luxloop.design import Bounds, Design
from luxloop.errors import InputError
from tests.agent.walking import Function, designs, drive
from tests.objectives import BOUNDS, Controller, ascended

SMALL = Bounds(
    low=Design.from_vector((20.0, 10.0, 300.0, 5.0, 4.5)),
    high=Design.from_vector((40.0, 14.0, 340.0, 25.0, 5.5)),
    step=Design.from_vector((10.0, 2.0, 20.0, 10.0, 0.5)),
)


@pytest.mark.parametrize("name", ["grid", "random"])
@pytest.mark.parametrize("lanes", [1, 3])
def test_every_feasible_design_once_and_then_no_more(name: str, lanes: int) -> None:
    """Grid and random search of a small box end when all that can be built has been asked for, nothing twice."""
    search = designer(name, Space(SMALL), seed=1, lanes=lanes)
    seen = [key_of(design) for design in designs(drive(search, Controller(bounds=SMALL), 400, lanes))]
    assert len(seen) == len(set(seen))
    assert set(seen) == {key_of(design) for design in SMALL.grid() if design.feasibility() is None}
    assert search.finished
    assert search.ask(0) is None


def test_the_grid_goes_film_by_film_and_chip_by_chip() -> None:
    """Pairs change least often, then W and T, then D: each film and each chip is one stretch of the walk."""
    seen = designs(drive(GridSearch(Space(SMALL)), Controller(bounds=SMALL), 400))
    film, chip = ["dbr_pairs"], ["dbr_pairs", "width_um", "thickness_um"]
    for names in (film, chip, [*chip, "distance_um"]):
        values = [tuple(getattr(design, name) for name in names) for design in seen]
        changes = sum(a != b for a, b in itertools.pairwise(values))
        assert changes == len(set(values)) - 1


@pytest.mark.parametrize("seed", range(5))
def test_pattern_finds_the_top_of_a_separable_hill_exactly(seed: int) -> None:
    """On a sum of concave functions the best of the whole grid is the end of the first climb from any start."""
    top = np.array([0.31, -0.47, 0.8, -0.05, 0.4])
    hill = Function(lambda x: float(90.0 - 20.0 * np.sum((x - top) ** 2)), BOUNDS)
    low, high = BOUNDS.low.as_vector(), BOUNDS.high.as_vector()
    summit = low + (top + 1.0) / 2.0 * (high - low)
    axes = [np.array(BOUNDS.values(name)) for name in Design.FIELDS]
    best = [float(axis[np.abs(axis - x).argmin()]) for axis, x in zip(axes, summit, strict=True)]
    search = PatternSearch(Space(BOUNDS), seed=seed)
    drive(search, hill, 150)
    assert search.known.best is not None
    assert search.known.best[0] == tuple(best)


def test_pattern_reaches_the_best_known_of_objective_a() -> None:
    """Within half a point of the best of 20 ascents in 400 evaluations, from five seeds."""
    space, random = Space(BOUNDS, spacing_is="gap"), np.random.default_rng(2)
    starts = [space.draw(random) for _ in range(20)]
    top = max(ascended("A", start)[0] for start in starts if start is not None)
    for seed in range(5):
        told = drive(PatternSearch(space, seed=seed), Controller(noise=0.003, seed=seed), 400)
        assert max(Controller().true_percent(design) for design in designs(told)) > top - 0.5


def test_pattern_asks_for_no_design_twice() -> None:
    """What is known is not evaluated again, over several climbs."""
    seen = [key_of(design) for design in designs(drive(PatternSearch(Space(BOUNDS), seed=4), Controller(), 500))]
    assert len(seen) == len(set(seen))


@pytest.mark.parametrize("name", ["random", "pattern", "grid"])
def test_a_restored_search_goes_on_the_same(name: str) -> None:
    """After 57 rounds of two lanes, through bytes into a new search: the next 100 rounds are the same."""
    first, second = (designer(name, Space(BOUNDS), seed=3, lanes=2) for _ in range(2))
    drive(first, Controller(), 57, lanes=2)
    second.restore(Checkpoint.from_bytes(first.state().to_bytes()))
    first_on, second_on = (designs(drive(search, Controller(), 100, lanes=2)) for search in (first, second))
    assert first_on == second_on


def test_failed_steps_are_not_learnt_from() -> None:
    """A failed design is neither known nor the best; the grid counts it; the pattern begins anew."""
    controller = Controller()
    controller.failing = {(0, number) for number in range(3, 400, 2)}
    for search in (RandomSearch(Space(BOUNDS)), PatternSearch(Space(BOUNDS)), GridSearch(Space(BOUNDS))):
        told = drive(search, controller, 40)
        good = {key_of(step.design) for _, step in told if step.failure is None}
        assert set(search.known.uniformity) == good
    assert search.failed == sum(step.failure is not None for _, step in told)  # type: ignore[attr-defined]


def test_a_checkpoint_of_another_search_is_refused() -> None:
    """Another kind, another seed, other bounds, or no checkpoint at all: each says what is wrong."""
    mine = PatternSearch(Space(BOUNDS), seed=1)
    others = (RandomSearch(Space(BOUNDS)), PatternSearch(Space(BOUNDS), seed=2), PatternSearch(Space(SMALL), seed=1))
    for other in others:
        with pytest.raises(InputError, match=r"checkpoint\.(name|settings)"):
            mine.restore(other.state())
    with pytest.raises(InputError, match=r"npz"):
        Checkpoint.from_bytes(b"not one")


def test_the_order_of_calls_is_held() -> None:
    """Asking a lane twice, or telling another step than the one under way, is refused."""
    search, controller = RandomSearch(Space(BOUNDS), lanes=2), Controller()
    ((proposal, step),) = drive(search, controller, 1)[:1]
    search.ask(0)
    with pytest.raises(ValueError, match="asked again"):
        search.ask(0)
    with pytest.raises(ValueError, match="under way"):
        search.tell(0, step)
    with pytest.raises(ValueError, match="under way"):
        search.tell(1, step)
    assert proposal.record.number == 0


def test_an_unknown_name_says_what_there_is() -> None:
    """The names are listed."""
    with pytest.raises(InputError, match="ddqn-fast"):
        designer("genetic", Space(BOUNDS), seed=0)
