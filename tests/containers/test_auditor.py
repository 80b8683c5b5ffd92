"""The physics' part of a replay: figures once more from maps and cut lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from containers.auditor import FINEST, OF_MAP, between, beyond, re_derive
from luxloop.audit import Compared
from luxloop.campaign import Cut, Step
from luxloop.journal.journal import Journal
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import map_record, reply_record, step_record
from luxloop.messages import Outcome
from tests.journals import METADATA, START_NS, a_step, put

GOLDEN = Path(__file__).parents[1] / "golden" / "runs"
BIAS = -0.003
CENTRES = (np.arange(64) + 0.5) / 64 - 0.5


def field(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """An even illuminance (y, x) in lx, x and y in widths of the cell: a few modes, the 20th the finest."""
    ripple = 0.1 * np.cos(2 * np.pi * x) + 0.01 * np.cos(40 * np.pi * x)
    return 1e5 * (1.0 + ripple + 0.1 * np.cos(2 * np.pi * y)[:, None])


def a_run(
    folder: Path, off: float = 0.0, map_lx: np.ndarray | None = None, kept: str = "", **changes: object
) -> dict[str, Compared]:
    """What is compared of a run of one final step whose figures are those of `field`, the uniformity by `off` not."""
    x = np.linspace(-0.5, 0.5, 401)
    line = field(x, np.zeros(1))[0]
    plain = float(line.min() / line.max())
    spot = field(np.array([0.0, -0.5]), np.array([0.0, -0.5]))
    told = {"value": plain - BIAS + off, "standard_error": 0.004, "bias": BIAS}
    figures = {
        "uniformity": told,
        "mean_illuminance_lx": {"value": 1e5, "standard_error": 10.0},
        "hot_spot_ratio": {"value": float(spot[0, 0] / spot[1, 1]), "standard_error": 0.01, "bias": 0.0},
    }
    cut = Cut(x_um=tuple(x), illuminance_lx=tuple(line), illuminance_error_lx=tuple(0.0 * x))
    step = a_step(0, told["value"], **{"figures": figures, "final": True, "role": "best", "cut": cut} | changes)
    journal = Journal(folder, METADATA, {})
    replies = [reply_record("ray", Outcome(task_id=kept, result={}), {}, 0, START_NS)] if kept else []
    put(
        journal,
        [
            *replies,
            map_record(field(CENTRES, CENTRES) if map_lx is None else map_lx, 0, START_NS),
            step_record(step, 0, START_NS),
        ],
    )
    journal.finish()
    journal.close()
    said: list[Compared] = []
    re_derive(RunJournal(folder), said.append, same_machine=True)
    return {one.what: one for one in said}


def test_between_its_points_a_map_is_its_field() -> None:
    """A sum of modes below half the number of points, at places that are no points of the map, at its edge too."""
    x, y = np.array([-0.5, -0.31, 0.0, 0.123, 0.5]), np.array([0.0, 0.27])
    assert between(field(CENTRES, CENTRES), x, y) == pytest.approx(field(x, y), rel=1e-12)


def test_an_odd_map_and_a_constant_are_kept() -> None:
    """Weights add up to 1 for any number of points."""
    for count in (7, 8, 65):
        assert between(np.full((count, count), 3.0), np.array([0.2]), np.array([-0.4])) == pytest.approx(3.0)


def test_its_finest_modes_bound_what_a_map_cannot_show() -> None:
    """0 for modes that it holds with room to spare, their amplitude for one near its limit."""
    assert beyond(field(CENTRES, CENTRES)) < 1e-12
    fine = round(FINEST * 32) + 2
    ripple = 1.0 + 0.01 * np.cos(2 * np.pi * fine * CENTRES) * np.ones((64, 1))
    assert beyond(ripple) == pytest.approx(0.01, rel=1e-9)


def test_right_figures_hold(tmp_path: Path) -> None:
    """Uniformity from the line and from the map, mean and hot-spot ratio: each within its tolerance."""
    found = a_run(tmp_path / "r")
    assert set(found) == {"uniformity, cut", "uniformity, map", "hot-spot ratio, map", "mean illuminance, map"}
    assert {one.verdict for one in found.values()} <= {"identical", "within tolerance"}


def test_a_wrong_uniformity_differs(tmp_path: Path) -> None:
    """By a hundredth of its error: both the line and the map see it."""
    found = a_run(tmp_path / "r", off=4e-5)
    assert found["uniformity, cut"].verdict == found["uniformity, map"].verdict == "differs"
    assert found["uniformity, map"].logged - found["uniformity, map"].now == pytest.approx(4e-5, abs=OF_MAP)
    assert found["mean illuminance, map"].verdict != "differs"


def test_a_uniformity_that_was_clipped_cannot_be_compared(tmp_path: Path) -> None:
    """Noise left it above 1, where it was cut off: what it was is lost."""
    figures = {"uniformity": {"value": 1.0, "standard_error": 0.01, "bias": -0.2}}
    found = a_run(tmp_path / "r", figures=figures)
    assert found["uniformity, cut"].verdict == found["uniformity, map"].verdict == "not comparable"


def test_a_map_too_coarse_for_its_light_says_nothing(tmp_path: Path) -> None:
    """Modes near the finest that it holds: whether there are finer ones it cannot tell. The line still can."""
    rough = np.random.default_rng(1).normal(1e5, 3e3, (64, 64))
    found = a_run(tmp_path / "r", map_lx=rough)
    assert found["figures, map"].verdict == "not comparable"
    assert set(found) == {"figures, map", "uniformity, cut"}


def test_what_was_known_or_could_not_be_built_left_no_arrays(tmp_path: Path) -> None:
    """Nothing is said of it."""
    assert a_run(tmp_path / "a", cached=True) == {}
    assert a_run(tmp_path / "b", feasible=False, reason="chips overlap") == {}


def test_what_the_controller_had_kept_is_compared(tmp_path: Path) -> None:
    """No worker had to compute it; its reply and its arrays are on record."""
    found = a_run(tmp_path / "r", kept="a" * 64, task_id="a" * 64, cached=True)
    assert {"uniformity, cut", "uniformity, map"} <= set(found)


@pytest.mark.parametrize("name", ["paper-mc", "fast-twin"])
def test_recorded_figures_follow_from_their_arrays(name: str) -> None:
    """Real fields: uniformity of line and map agree with what was told to 1e-9 and 1e-6."""
    said: list[Compared] = []
    re_derive(RunJournal(GOLDEN / name), said.append, same_machine=False)
    steps: list[Step] = list(RunJournal(GOLDEN / name).steps())
    unresolved = [one.sequence for one in said if one.what == "figures, map"]
    off = {what: [abs(one.logged - one.now) for one in said if one.what == what]
           for what in ("uniformity, cut", "uniformity, map")}  # fmt: skip
    assert [len(off["uniformity, map"]) + len(unresolved), len(off["uniformity, cut"])] == [len(steps), 4]
    assert max(off["uniformity, cut"]) < 1e-9
    assert max(off["uniformity, map"]) < 1e-6
    # the receiver 45 um above chips 700 um apart
    assert [steps[place].design.distance_um for place in unresolved] == ([100.0] if name == "paper-mc" else [])
