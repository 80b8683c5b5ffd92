"""A design's limits and order, feasibility, and the boxes it is looked for in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from luxloop.design import PRESETS, Bounds, Design
from luxloop.errors import InputError
from luxloop.words import parse, sha256_of

S_B3 = {"distance_um": 180.0, "width_um": 28.0, "spacing_um": 500.0, "thickness_um": 35.0, "dbr_pairs": 6.5}
BEST_OF_THE_PAPER = [(180, 40, 400, 20, 5.5), (160, 20, 460, 15, 5.5), (180, 28, 500, 35, 6.5)]


def designs(bounds: Bounds) -> st.SearchStrategy[Design]:
    """Any design in a box, lengths to 1e-6 um, pairs in halves."""
    ends = list(zip(bounds.low.as_vector(), bounds.high.as_vector(), strict=True))
    lengths = [st.floats(low, high).map(lambda x: round(x, 6)) for low, high in ends[:-1]]
    pairs = st.integers(int(2 * ends[-1][0]), int(2 * ends[-1][1])).map(lambda i: i / 2)
    return st.tuples(*lengths, pairs).map(Design.from_vector)


def test_the_state_vector_has_the_order_of_fields() -> None:
    """D, W, S, T, pairs, as one tuple says, both ways."""
    design = parse(Design, S_B3)
    assert tuple(S_B3) == Design.FIELDS
    assert design.as_vector().tolist() == [180.0, 28.0, 500.0, 35.0, 6.5]
    assert Design.from_vector(design.as_vector()) == design


@pytest.mark.parametrize("pairs", [0, 0.5, 2.5, 4.5, 6, 20])
def test_pairs_come_in_halves_from_zero(pairs: float) -> None:
    """Evaluation takes any half, no DBR included."""
    assert parse(Design, {**S_B3, "dbr_pairs": pairs}).dbr_pairs == pairs


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("dbr_pairs", 4.3), ("dbr_pairs", -0.5), ("dbr_pairs", 1e9), ("distance_um", 0.0), ("width_um", -1.0),
        ("spacing_um", float("nan")), ("thickness_um", float("inf")), ("width_um", "28"), ("width_um", True),
    ],
)  # fmt: skip
def test_a_senseless_value_is_refused_by_name(field: str, value: object) -> None:
    """The error names the field and the value."""
    with pytest.raises(InputError) as caught:
        parse(Design, {**S_B3, field: value})
    assert field in caught.value.field
    assert caught.value.value is value or caught.value.value == value


def test_unknown_and_missing_variables_are_refused() -> None:
    """Neither a sixth variable nor only four."""
    with pytest.raises(InputError, match="height_um"):
        parse(Design, {**S_B3, "height_um": 1.0})
    with pytest.raises(InputError, match="width_um"):
        parse(Design, {name: value for name, value in S_B3.items() if name != "width_um"})
    with pytest.raises(InputError, match="5 numbers"):
        Design.from_vector([1.0, 2.0])


def test_zero_pairs_of_either_sign_are_one_design_with_one_hash() -> None:
    """-0.0 equals 0.0, so their hashes must be equal too."""
    plus, minus = (parse(Design, {**S_B3, "dbr_pairs": zero}) for zero in (0.0, -0.0))
    assert plus == minus
    assert sha256_of(plus) == sha256_of(minus)


@pytest.mark.parametrize(("vector", "f"), [*zip(BEST_OF_THE_PAPER, (2.0, 3.0, 5.0), strict=True)])
def test_the_geometry_factor_is_the_papers(vector: tuple[float, ...], f: float) -> None:
    """The paper states f = 2, 3 and 5 for its three best designs."""
    assert Design.from_vector(vector).f == pytest.approx(f, rel=1e-15)


@pytest.mark.parametrize(
    ("distance_um", "distance_from", "feasible"),
    [(40.0, "substrate", True), (39.9, "substrate", False), (5.0, "chip_top", True), (4.9, "chip_top", False)],
)
def test_the_receiver_keeps_five_um_from_the_chip(distance_um: float, distance_from: str, feasible: bool) -> None:
    """D >= T + 5 from the substrate, D >= 5 from the chip's top; the reason names the distance."""
    reason = parse(Design, {**S_B3, "distance_um": distance_um}).feasibility(distance_from)  # type: ignore[arg-type]
    assert (reason is None) is feasible
    assert feasible or f"distance_um {distance_um:g}" in str(reason)


def test_chips_must_not_overlap_where_s_is_the_pitch() -> None:
    """W = S is a closed layer for a pitch, and chips side by side for a gap."""
    wide = parse(Design, {**S_B3, "width_um": 500.0})
    assert "overlap" in str(wide.feasibility())
    assert wide.feasibility(spacing_is="gap") is None


def test_the_entire_loop_has_the_papers_count_of_designs() -> None:
    """18 x 10 x 9 x 6 x 11 = 106,920 designs, all different, 92,070 of them feasible; `count` needs no walk."""
    bounds = Bounds.preset("paper-grid")
    assert [len(bounds.values(name)) for name in Design.FIELDS] == [18, 10, 9, 6, 11]
    feasible = [design.feasibility() is None for design in bounds.grid()]
    assert (bounds.count, len(feasible), sum(feasible)) == (106_920, 106_920, 92_070)


def test_the_grid_is_lazy_and_walks_the_pairs_fastest() -> None:
    """The first designs come at once, from the low corner."""
    walk = Bounds.preset("paper-grid").grid()
    first, second = next(walk), next(walk)
    assert first == Bounds.preset("paper-grid").low
    assert (second.as_vector() - first.as_vector()).tolist() == [0, 0, 0, 0, 0.5]


@pytest.mark.parametrize("vector", BEST_OF_THE_PAPER)
def test_table_3_holds_the_papers_best_designs_on_its_steps(vector: tuple[float, ...]) -> None:
    """Each best design lies in the box and a whole number of steps from its low corner."""
    bounds, design = Bounds.preset("paper-table3"), Design.from_vector(vector)
    assert bounds.contains(design)
    assert all(getattr(design, name) in bounds.values(name) for name in Design.FIELDS)


def test_a_preset_that_does_not_exist_lists_those_that_do() -> None:
    """The error names both presets."""
    with pytest.raises(InputError, match="paper-table3 or paper-grid"):
        Bounds.preset("paper")


@pytest.mark.parametrize("name", PRESETS)
def test_the_corners_are_minus_one_and_one(name: str) -> None:
    """low -> -1, high -> 1 in every variable."""
    bounds = Bounds.preset(name)
    assert bounds.normalise(bounds.low).tolist() == [-1.0] * 5
    assert bounds.normalise(bounds.high).tolist() == [1.0] * 5


@settings(max_examples=100, derandomize=True)
@given(designs(PRESETS["paper-table3"]))
def test_normalising_there_and_back_is_the_same_design(design: Design) -> None:
    """Exactly the same, not nearly: it is hashed."""
    bounds = PRESETS["paper-table3"]
    x = bounds.normalise(design)
    assert np.all(np.abs(x) <= 1.0 + 1e-12)
    assert bounds.denormalise(x) == design


@settings(max_examples=100, derandomize=True)
@given(designs(Bounds(low=Design.from_vector((1, 1, 1, 1, 0)), high=Design.from_vector((900, 900, 900, 90, 50)),
                      step=Design.from_vector((1, 1, 1, 1, 0.5)))))  # fmt: skip
def test_clipping_ends_in_the_box_and_moves_only_what_is_outside(design: Design) -> None:
    """The clipped design lies inside; a variable that lay inside is untouched; clipping twice is clipping once."""
    bounds = PRESETS["paper-table3"]
    clipped = bounds.clip(design)
    x, low, high = design.as_vector(), bounds.low.as_vector(), bounds.high.as_vector()
    inside = (x >= low) & (x <= high)
    assert bounds.contains(clipped)
    assert bounds.contains(design) == inside.all()
    assert np.array_equal(clipped.as_vector()[inside], x[inside])
    assert bounds.clip(clipped) == clipped


def test_a_variable_can_be_held_fixed() -> None:
    """low = high is one grid value, 0 when normalised, and comes back whatever is asked for."""
    low, high = (Design.from_vector((100, 10, 300, 5, 5.5)), Design.from_vector((180, 10, 300, 5, 5.5)))
    bounds = Bounds(low=low, high=high, step=Design.from_vector((10, 1, 1, 1, 0.5)))
    assert bounds.count == 9
    assert bounds.normalise(low).tolist() == [-1.0, 0.0, 0.0, 0.0, 0.0]
    assert bounds.denormalise([1.0, 0.7, -0.7, 1.0, 1.0]) == high


@pytest.mark.parametrize(("corner", "value"), [("low", 200.0), ("step", 0.0), ("step", 1e-310), ("step", 1e-5)])
def test_senseless_bounds_are_refused_by_name(corner: str, value: float) -> None:
    """low above high, a step of zero, or one that makes over 1,000,000 values: each is named."""
    bounds = PRESETS["paper-table3"].model_dump()
    bounds[corner]["distance_um"] = value
    with pytest.raises(InputError, match=f"{corner}.distance_um"):
        parse(Bounds, bounds)


def test_a_grid_is_counted_without_being_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """6.6e25 designs, in no time and no memory."""
    monkeypatch.delattr(Bounds, "values")
    low, high = Design.from_vector((100, 10, 300, 5, 0)), Design.from_vector((1000, 910, 1200, 905, 50))
    bounds = Bounds(low=low, high=high, step=Design.from_vector((0.001, 0.001, 0.001, 0.001, 0.5)))
    assert bounds.count == 900_001**4 * 101


def test_a_steps_last_value_is_met_only_where_it_fits() -> None:
    """Steps of 0.1 um from 1 to 2 make eleven values without rounding noise, steps of 0.3 end at 1.9."""
    low, high = Design.from_vector((1, 1, 300, 5, 0)), Design.from_vector((2, 2, 300, 5, 0))
    bounds = Bounds(low=low, high=high, step=Design.from_vector((0.1, 0.3, 1, 1, 0.5)))
    assert bounds.values("distance_um") == (1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9, 2.0)
    assert bounds.values("width_um") == (1.0, 1.3, 1.6, 1.9)


def test_a_move_stays_in_the_box_or_leads_nowhere() -> None:
    """So many steps of one variable; pairs in halves; the faces belong to the box."""
    bounds = Bounds.preset("paper-table3")
    design = Design.from_vector((150.0, 30.0, 500.0, 20.0, 5.5))
    assert bounds.moved(design, "distance_um", 3) == design.model_copy(update={"distance_um": 180.0})
    assert bounds.moved(design, "distance_um", 4) is None
    assert bounds.moved(design, "dbr_pairs", -2) == design.model_copy(update={"dbr_pairs": 4.5})
    assert bounds.moved(design, "dbr_pairs", -3) is None
    assert bounds.moved(design, "width_um", -10) == design.model_copy(update={"width_um": 10.0})
