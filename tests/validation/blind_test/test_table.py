"""The table on made-up verdicts: who counts where, exact intervals, met or shown."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scipy.stats import binom

from tests.validation.blind_test.pretend import hiding, marked, record
from validation.blind_test.marks import Marked
from validation.blind_test.table import Confused, Row, alarms, interval, sizes, table


def row(sets: list[Marked], quantity: str) -> Row:
    """A line of the table."""
    (found,) = [one for one in table(sets) if one.quantity.startswith(quantity)]
    return found


def counts(sets: list[Marked], quantity: str) -> tuple[float, int]:
    """Its hits, of how many."""
    found = row(sets, quantity)
    return found.hits, found.of


@pytest.mark.parametrize(("hits", "of"), [(0, 10), (10, 10), (18, 20), (1, 1000)])
def test_the_interval_is_exact(hits: int, of: int) -> None:
    """At its ends the observed count is the 2.5 % tail of the binomial distribution."""
    low, high = interval(hits, of)
    assert low == 0.0 if hits == 0 else binom.sf(hits - 1, of, low) == pytest.approx(0.025)
    assert high == 1.0 if hits == of else binom.cdf(hits, of, high) == pytest.approx(0.025)


def test_met_is_the_share_and_shown_the_interval() -> None:
    """19 of 20 reach 95 %, which 20 sets cannot show; 199 of 200 show it; 18 of 20 fall short."""

    def said(hits: int, of: int) -> str:
        sets = [
            marked(record("one_effect", "vignetting" if k < hits else "camera_psf"), hiding("vignetting"))
            for k in range(of)
        ]
        return row(sets, "right group").said

    assert [said(19, 20), said(199, 200), said(18, 20), said(0, 0)] == ["met", "shown", "short", "no sets"]


def test_groups_are_the_fixed_ones_and_those_found() -> None:
    """camera_psf for receiver_btdf is of one group; so is vignetting for tilt where the diagnosis said so."""
    same = marked(record("one_effect", "camera_psf"), hiding("receiver_btdf"))
    found = marked(
        record("one_effect", "vignetting", groups=[["vignetting", "receiver_tilt"]]), hiding("receiver_tilt")
    )
    other = marked(record("one_effect", "vignetting"), hiding("receiver_tilt"))
    assert [one.in_group for one in (same, found, other)] == [True, True, False]
    assert [one.is_missed for one in (same, found, other)] == [False, False, True]
    assert counts([same, found, other], "true effect in the reported set") == (0, 3)


def test_exact_names_count_where_the_data_can_tell() -> None:
    """Sets with a rival nearer than 5 sigma ask for another verdict; sets without the measurement count nowhere."""
    far, near = {"camera_psf": 9.0, "dead_chip": 19.0}, {"camera_psf": 4.9}
    sets = [
        marked(record("one_effect", "distance_error"), hiding("distance_error", rivals=far)),
        marked(record("cannot_tell_apart", "distance_error", "camera_psf"), hiding("distance_error", rivals=far)),
        marked(record("one_effect", "distance_error"), hiding("distance_error", rivals=near)),
        marked(record("cannot_tell_apart", "camera_psf", "distance_error"), hiding("distance_error", rivals=near)),
        marked(record("one_effect", "distance_error"), hiding("distance_error")),
    ]
    assert counts(sets, "exact name") == (1, 2)
    assert counts(sets, "cannot_tell_apart") == (1, 2)
    assert counts(sets, "true effect in the reported set") == (5, 5)
    assert row(sets, "mean size").value == pytest.approx(7 / 5)


def test_strangers_that_a_known_effect_takes_have_a_row_of_their_own() -> None:
    """Beside a rival that leaves less than 5 sigma no data can say that it is unknown; that rival is to be named."""
    far, near = {"camera_psf": 9.0, "dead_chip": 19.0}, {"camera_psf": 4.9, "dead_chip": 19.0}
    sets = [
        marked(record("none_of_the_known"), hiding(kind="chip_sizes", rivals=far)),
        marked(record("one_effect", "camera_psf"), hiding(kind="chip_sizes", rivals=far)),
        marked(record("one_effect", "camera_psf"), hiding(kind="chip_sizes", rivals=near)),
        marked(record("one_effect", "dead_chip"), hiding(kind="chip_sizes", rivals=near)),
        marked(record("none_of_the_known"), hiding(kind="chip_sizes", rivals=near)),
        marked(record("none_of_the_known"), hiding(kind="chip_sizes")),
    ]
    assert counts(sets, "outside, sigma_rival >= 5") == (1, 2)
    assert counts(sets, "outside, sigma_rival < 5") == (1, 3)
    assert counts(sets, "outside, at 20 sigma") == (3, 6)
    assert [one.sigma_rival for one in sets] == [9.0, 9.0, 4.9, 4.9, 4.9, None]


def test_the_proposed_image_counts_in_a_row_of_its_own() -> None:
    """Sets with it stand in for those before; one whose image was not taken counts in neither way."""
    rivals = {"camera_psf": 9.0}
    asks = {"next_measurement": {"sample": {}}}
    open_, alone, exact, untaken = (
        marked(record(verdict, "distance_error", seal=seal, **more), hiding("distance_error", rivals=rivals))
        for verdict, seal, more in (
            ("cannot_tell_apart", "a", asks), ("cannot_tell_apart", "b", {}), ("one_effect", "c", {}),
            ("cannot_tell_apart", "d", asks),
        )
    )  # fmt: skip
    further = marked(record("one_effect", "distance_error"), hiding("distance_error", rivals=rivals), follows="a")
    sets = [open_, alone, exact, untaken]
    assert counts(sets, "the same, with the proposed image") == (0, 0)
    assert counts([*sets, further], "the same, with the proposed image") == (2, 3)
    assert counts([*sets, further], "exact name") == (1, 4)


def test_strengths_choose_the_rows() -> None:
    """Detection at 8 sigma counts sets of 8 sigma; a fit that is not trusted has detected nothing."""
    sets = [
        marked(record("none_of_the_known"), hiding("vignetting", sigma=8.3)),
        marked(record("nothing_visible"), hiding("vignetting", sigma=7.5)),
        marked(record("fit_not_trustworthy"), hiding("vignetting", sigma=20.0)),
        marked(record("one_effect", "dead_chip"), hiding("vignetting", sigma=25.0)),
    ]
    assert counts(sets, "detection at 8 sigma") == (1, 2)
    assert counts(sets, "detection at 20 sigma") == (1, 2)
    assert row(sets, "detection at 20 sigma").said == ""


def test_outside_of_the_catalogue() -> None:
    """By strength; a known effect that is called unknown counts against its own row."""
    sets = [
        marked(record("none_of_the_known"), hiding(kind="dust")),
        marked(record("one_effect", "vignetting"), hiding(kind="coma")),
        marked(record("none_of_the_known"), hiding(kind="hair", sigma=40.0)),
        marked(record("none_of_the_known"), hiding("dead_chip")),
    ]
    assert counts(sets, "outside, at 20") == (1, 2)
    assert counts(sets, "outside, at 40") == (1, 1)
    assert counts(sets, "a known one called") == (1, 1)
    assert row(sets, "a known one called").said == "short"
    assert [one.is_missed for one in sets] == [False, True, False, True]


def test_two_hidden_need_two_names() -> None:
    """One name cannot stand for both, even of one group; the second may come in a later round."""
    both = hiding("vignetting"), hiding("receiver_tilt")
    found = record(
        "one_effect", "chip_power_spread", added=[{"name": "chip_power_spread"}, {"name": "receiver_tilt"}]
    )
    alone = record("one_effect", "vignetting", groups=[["vignetting", "receiver_tilt"]])
    sets = [marked(found, *both), marked(alone, *both), marked(record("none_of_the_known"), *both)]
    assert [one.both_found for one in sets] == [True, False, False]
    assert counts(sets, "two hidden") == (1, 3)


def test_sizes_count_where_the_form_is_right() -> None:
    """A spacer's error is the catalogue's own parameter; an exponential crowding is not."""
    effect = {"name": "distance_error", "size": {"distance_um": {"value": 0.13, "error": 0.02, "unit": "um"}},
              "held_out_before": None}  # fmt: skip
    near = marked(
        record("one_effect", "distance_error", effects=[effect]), hiding("distance_error", kind="wrong_spacer")
    )
    other = marked(
        record("one_effect", "distance_error", effects=[effect]), hiding("distance_error", kind="bent_spacer")
    )
    assert near.size_pull == pytest.approx(1.5)
    assert other.size_pull is None
    assert counts([near, other], "size within 2") == (1, 1)


def test_held_out_errors() -> None:
    """It falls with the right effect; another of its group says nothing, one outside of it must not lower it."""

    def effect(name: str, after: float) -> dict[str, object]:
        return {"name": name, "held_out_before": 2.0, "held_out_after": after, "size": {}}

    tried = [effect("vignetting", 1.0), effect("chip_power_spread", 1.2), effect("dead_chip", 1.9),
             effect("camera_psf", 2.1)]  # fmt: skip
    sets = [marked(record("one_effect", "vignetting", effects=tried), hiding("vignetting"))]
    assert counts(sets, "held-out error falls with") == (1, 1)
    assert counts(sets, "sets without a held-out fall") == (0, 1)
    either = hiding("vignetting", "camera_psf")
    for best, other, falls in ((tried[0], tried[3], 1), (tried[3], tried[0], 0)):  # of two right ones the best counts
        both = marked(record("one_effect", "vignetting", effects=[best, other]), either)
        assert counts([both], "held-out error falls with") == (falls, 1)
    two = marked(record("one_effect", "vignetting", effects=[tried[0], tried[3]]), hiding("vignetting"))
    alone = marked(record("one_effect", "vignetting", effects=tried[:2]), hiding("vignetting"))
    assert counts([*sets, two, alone], "sets without a held-out fall") == (1, 2)


def test_a_held_out_error_falls_beyond_its_own_error() -> None:
    """By the diagnosis's own rule, twice the error; a record without that error counts as it stands."""

    def effect(name: str, change: float | None, error: float | None) -> dict[str, object]:
        return {"name": name, "held_out_before": 2.0, "held_out_after": 1.9, "size": {},
                "held_out_density_change": change, "held_out_density_error": error}  # fmt: skip

    def held(change: float | None, error: float | None) -> tuple[tuple[float, int], tuple[float, int]]:
        both = [effect(name, change, error) for name in ("vignetting", "dead_chip")]
        sets = [marked(record("one_effect", "vignetting", effects=both), hiding("vignetting"))]
        return counts(sets, "held-out error falls with"), counts(sets, "sets without a held-out fall")

    assert held(0.05, 0.01) == held(None, None) == ((1, 1), (0, 1))
    assert held(0.015, 0.01) == held(-0.05, 0.01) == ((0, 1), (1, 1))


def test_the_limits_of_time_are_of_six_images_and_a_solver() -> None:
    """60 s by the twin, 30 min by Monte Carlo; sets of three images, and those that share a light, say nothing."""
    monte_carlo = {"method": "anchored", "histories": 1000, "seed": 1}
    sets = [
        marked(record("nothing_visible", seconds=59.0)),
        marked(record("nothing_visible", seconds=61.0)),
        marked(record("nothing_visible", seconds=1700.0, solver=monte_carlo)),
        marked(record("nothing_visible", seconds=1.0, shots=[{"id": "a"}] * 3)),
        marked(record("nothing_visible", seconds=1.0, first_of_light=False)),
    ]
    assert counts(sets, "six images by the twin in 60 s") == (1, 2)
    assert counts(sets, "six images by Monte Carlo in 30 min") == (1, 1)


def test_alarms_draw_whole_truths_again() -> None:
    """Ten alarms on one truth of twenty are one accident: the interval is wider than that of 400 sets."""

    def sets(alarmed: list[int]) -> list[Marked]:
        return [
            marked(record("one_effect" if k in alarmed else "nothing_visible"), name=f"s{k}", light=f"l{k // 20}")
            for k in range(400)
        ]

    spread, one = alarms(sets(list(range(0, 200, 20)))), alarms(sets(list(range(10))))
    assert (spread.hits, one.hits, spread.of) == (10, 10, 400)
    assert spread.high is not None
    assert one.high is not None
    assert one.high > spread.high + 0.02
    assert alarms(sets([])).high == pytest.approx(interval(0, 400)[1])
    assert (alarms([]).said, alarms(sets([])).said, one.said) == ("no sets", "open", "short")
    assert replace(spread, value=0.01, low=0.003, high=0.019).said == "shown"


def test_the_mean_size_has_an_error() -> None:
    """One set says nothing of the spread; its interval is said to be no exact one."""
    assert (sizes([2, 1]).interval, sizes([]).interval, alarms([]).interval.split()[0]) == (
        "+- 1.96 s.e.", "+- 1.96 s.e.", "Clopper-Pearson",
    )  # fmt: skip
    assert (sizes([2]).said, sizes([2] * 30 + [1] * 10).said, sizes([4, 5]).said) == ("met", "shown", "short")


def test_who_is_taken_for_whom() -> None:
    """Truths are rows; what is a truth too comes first among the columns."""
    found = Confused.of([("b", "b"), ("a", "none_of_the_known"), ("b", "a"), ("b", "b")])
    assert (found.rows, found.columns) == (("a", "b"), ("a", "b", "none_of_the_known"))
    assert found.counts == ((0, 0, 1), (1, 2, 0))
