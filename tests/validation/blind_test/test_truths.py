"""What is drawn for a blind test: counts, names that say nothing, truths within the priors, kinds in turn."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest, truncnorm

from luxloop.errors import InputError
from luxloop.model_file import find_model
from validation import blind
from validation.blind_test.groups import GROUPS, group_of
from validation.blind_test.making import Asked
from validation.blind_test.truths import (
    Counts,
    Kinds,
    camera_of,
    planned,
    priors_of,
    sample_of,
    surroundings_of,
    truth_of,
)
from validation.dataset.simulation_plan import DECLARED, paper_plan
from validation.fit.parameters import free_paths

PAPER = find_model("paper")


def test_sets_are_counted_and_their_names_say_nothing() -> None:
    """All sorts as asked; sorts and names are shuffled; nothing-hidden sets share lights by twenty."""
    plan = planned(Counts(sets=100, outside=20, two=10, nothing=45, draws=20, per_truth=4), seed=3)
    sorts = Counter((one.count, one.outside) for one in plan)
    assert sorts == {(1, False): 25, (1, True): 20, (2, False): 10, (0, False): 45}
    assert sorted(one.id for one in plan) == [f"set-{number:03d}" for number in range(1, 101)]
    assert [one.id for one in plan] != sorted(one.id for one in plan)
    nothing = [one for one in plan if not one.count]
    assert sorted(Counter(one.light for one in nothing).values()) == [5, 20, 20]
    assert len({one.truth for one in nothing}) == 3
    assert max(Counter(one.truth for one in plan if one.count).values()) == 4
    assert not {one.truth for one in nothing} & {one.truth for one in plan if one.count}
    assert len({one.light for one in plan}) == 55 + 3
    assert len({one.seed for one in plan}) == 100
    assert planned(Counts(100, 20, 10, 45), 3) == plan != planned(Counts(100, 20, 10, 45), 4)


def test_more_sorts_than_sets_are_refused() -> None:
    """The rest would be negative."""
    with pytest.raises(InputError, match="--sets"):
        Counts(sets=5, outside=3, nothing=3)


def test_truths_are_drawn_within_the_priors() -> None:
    """A truth does not depend on the others; none is near a limit; all that is not free stays."""
    found = [truth_of(number, PAPER, 6, seed=2) for number in range(60)]
    assert truth_of(7, PAPER, 6, seed=2) == found[7]
    assert len({one.seed for one in found}) == 60
    for path in free_paths(PAPER):
        values = [float(one.model.leaves()[path]) for one in found]
        limits = PAPER.fit[path]
        margin = 0.1 * (limits.upper - limits.lower)
        assert limits.lower + margin <= min(values) < max(values) <= limits.upper - margin
        assert len(set(values)) == 60
    fixed = {path: one for path, one in PAPER.leaves().items() if path not in free_paths(PAPER)}
    assert all(fixed[path] == one for path, one in found[0].model.leaves().items() if path in fixed)
    assert len(found[0].poses) == 6
    assert 0.0 < abs(found[0].poses[0].shift_row_px) < 3.0


def test_what_is_known_before_is_drawn_about_the_truth_for_every_set() -> None:
    """Twenty sets of one light had the truth's distance from one prior in common, which every test is told once."""
    truth = truth_of(6, PAPER, 6, seed=2)
    sets = [priors_of(truth, one.seed) for one in planned(Counts(sets=400, nothing=400, draws=400), seed=3)]
    assert sets[0] == priors_of(truth, planned(Counts(sets=400, nothing=400, draws=400), seed=3)[0].seed)
    with_prior = [path for path in free_paths(PAPER) if PAPER.fit[path].prior_sd is not None]
    assert len(with_prior) == 2
    free = []
    for path in with_prior:
        limits, at = PAPER.fit[path], float(truth.model.leaves()[path])
        means = [one[path] for one in sets]
        sd = float(limits.prior_sd or 0.0)
        assert limits.lower <= min(means) < max(means) <= limits.upper
        expected = truncnorm((limits.lower - at) / sd, (limits.upper - at) / sd, at, sd)
        assert kstest(means, expected.cdf).pvalue > 0.01
        if min(at - limits.lower, limits.upper - at) > 2.5 * sd:  # else a fit's limit cuts some of them
            free.append(path)
            assert abs(np.mean(means) - at) < 3.0 * sd / 20.0
            assert 0.9 < np.std(means) / sd < 1.1
    assert free == ["environment.substrate.reflectance"]
    assert all(set(one) == set(with_prior) for one in sets)


def test_a_prior_outside_of_where_truths_are_drawn_is_refused() -> None:
    """Instead of being drawn from for ever."""
    path = "environment.substrate.reflectance"
    near = PAPER.fit[path].model_copy(update={"lower": 0.0, "upper": 1.0, "prior_mean": 0.99, "prior_sd": 0.01})
    with pytest.raises(InputError, match=r"got '0.99 \+- 0.01', allowed: a prior with room between 0.1 and 0.9"):
        truth_of(0, PAPER.model_copy(update={"fit": PAPER.fit | {path: near}}), 6, seed=2)


def test_the_blind_forward_model_takes_the_paper() -> None:
    """Surroundings, samples, camera in its own words; what it has not is refused."""
    at = surroundings_of(PAPER)
    assert (at.substrate_reflectance, at.gan_nm, at.chip_bottom) == (0.97, 45.2, "mirror")
    samples = [sample_of(one) for one in paper_plan().samples]
    assert [one.chips for one in samples] == [1, 1, 1, 25, 25, 25]
    assert samples[0].module_half_um == 2000.0
    assert camera_of(DECLARED, 128).full_scale_dn == 4095.0
    with pytest.raises(InputError, match="fixed pattern"):
        camera_of(DECLARED.model_copy(update={"prnu_percent": 1.0}), 128)
    with pytest.raises(InputError, match=r"camera.gain_mode: got 'exposure', allowed: free"):
        camera_of(DECLARED.model_copy(update={"gain_mode": "exposure"}), 128)
    with pytest.raises(InputError, match=r"environment\.emission"):
        surroundings_of(PAPER.with_value("environment.emission", "in_plane_dipole"))


def test_a_plan_that_the_blind_forward_model_cannot_build_is_refused_at_once(tmp_path: Path) -> None:
    """Chips that nearly touch at the module's edge, pixels of 5 nm: a traceback once a folder was there."""
    wide = paper_plan().samples[3].model_copy(update={"width_um": 250.0})
    fine = DECLARED.model_copy(update={"pixel_um": 0.005})
    for changes, words in (
        ({"samples": (wide,)}, r"array-0: module_half_um: got 1000\.0, allowed: a number from 1050 to 100000; "),
        ({"camera": fine}, r"camera\.pixel_um: got 0\.005, allowed: a number from 0\.01 to 1000; "),
    ):
        plan = paper_plan().model_copy(update=changes)
        with pytest.raises(InputError, match=words):
            Asked(tmp_path / "out", Counts(1, nothing=1), 1, 20.0, plan, PAPER)
    assert not (tmp_path / "out").exists()


def test_kinds_are_taken_in_turn() -> None:
    """Each as often as any other; none that is left out; two of one group never together."""
    kinds = Kinds((), seed=1)
    taken = []
    for _ in range(2 * sum(bool(one.right) for one in blind.KINDS.values())):
        name = kinds.next(outside=False)
        assert name is not None
        kinds.took(name)
        taken.append(name)
    assert set(Counter(taken).values()) == {2}
    assert all(blind.KINDS[name].right for name in taken)
    beside = kinds.next(False, ["growth_drift"])
    assert beside is not None
    assert group_of(blind.KINDS[beside].right[0]) != "mirror"
    without = [name for name in blind.KINDS if name != "dust"]
    assert (kinds.next(True, (), without), kinds.next(False, (), without)) == ("dust", None)
    assert (Kinds(["dust"], seed=1).has(False), kinds.has(False)) == (False, True)
    assert [Kinds(names, seed=1).has_two() for names in (["clipped_pupil", "binning"], ["binning", "weak_chip"])] == [
        False, True,
    ]  # fmt: skip
    with pytest.raises(InputError, match="did you mean dust"):
        Kinds(["dusk"], seed=1)


def test_no_effect_is_in_two_groups() -> None:
    """Else a name could be right for two reasons."""
    names = [name for group in GROUPS.values() for name in group]
    assert len(names) == len(set(names))
    assert (group_of("camera_psf"), group_of("dead_chip")) == ("lobe", "dead_chip")
