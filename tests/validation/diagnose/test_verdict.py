"""Who is named beside whom: two effects that explain nearly as much, one of which noise may have put first."""

from __future__ import annotations

from dataclasses import replace

import pytest

from validation.diagnose.explained import Share
from validation.diagnose.explanation import Explanation
from validation.diagnose.rounds import is_a_guess
from validation.diagnose.verdict import Verdict, concluded, decided, further_in_words, leaves_too_much, told_of_rest


def explanation(name: str, drop: float, share: Share, beside: dict[str, float]) -> Explanation:
    """What an effect came to, one that may be named; what is left beside each rival, in sigma."""
    return Explanation(
        name=name, parameter="size", unit="", value=0.1, error=0.02, shape=(), as_well=(), drop=drop, share=share,
        held_out=None, held_out_percent=None, log_evidence=None, plausible=True, at_end=False, has_members=False,
        by_place=None, distrust=(), p_left=0.3, sigma=drop**0.5, sigma_rival=beside,
    )  # fmt: skip


def said(drop: float, other: float, error: float, shares: tuple[float, float] = (0.64, 0.81)) -> tuple[str, ...]:
    """The verdict's word and its set, of two effects whose shares are known to +- `error`."""
    one, two = (Share(value, error) for value in shares)
    tried = [explanation("walls", other, two, {"chip": 4.0}), explanation("chip", drop, one, {"walls": 4.0})]
    verdict = decided(tried, 32, lambda: "", lambda _: "")
    return verdict.word, *verdict.set


@pytest.mark.parametrize(("other", "word"), [(26.0, "cannot_tell_apart"), (23.0, "one_effect")])
def test_of_two_weak_effects_the_one_that_noise_may_have_put_first_is_not_named_alone(
    other: float, word: str
) -> None:
    """Falls of 33 and 26 are 5.7 and 5.1 sigma, each +- 1; ten of chi2 are more than that."""
    assert said(33.0, other, error=0.25)[0] == word


def test_strong_effects_are_told_by_the_share_of_structure_they_explain() -> None:
    """Shares known to 3 % decide, however near the falls of chi2 are."""
    assert said(1000.0, 950.0, error=0.03, shares=(0.98, 0.7)) == ("one_effect", "chip")
    assert said(1000.0, 950.0, error=0.03, shares=(0.98, 0.95)) == ("cannot_tell_apart", "chip", "walls")


@pytest.mark.parametrize(
    ("error", "word"), [(0.2, "none_of_the_known"), (0.3, "one_effect"), (0.05, "none_of_the_known")]
)
def test_what_explains_next_to_nothing_is_not_named_while_structure_is_left(error: float, word: str) -> None:
    """A share of 0.01 +- 0.2 is two errors below a half; of one that is known to +- 0.3 nothing can be said."""
    one = replace(explanation("gradient", 20.0, Share(0.01, error), {}), p_left=0.0001)
    assert decided([one], 4, lambda: "stripes.", lambda _: "").word == word
    assert decided([replace(one, p_left=0.3)], 4, lambda: "", lambda _: "").word == "one_effect"


@pytest.mark.parametrize(("other", "word"), [(620.0, "cannot_tell_apart"), (600.0, "one_effect")])
def test_rivals_are_told_apart_no_better_than_their_fits_are(other: float, word: str) -> None:
    """Columns of a fit at a limit said 7 sigma; 19 of chi2 are 4.4, 39 are 6.2."""
    share = Share(0.98, 0.03)
    tried = [explanation("lobe", 639.0, share, {"far": 7.0}), explanation("far", other, share, {"lobe": 7.0})]
    assert decided(tried, 32, lambda: "", lambda _: "").word == word


def test_how_near_the_fits_are_is_said_where_columns_would_tell_them() -> None:
    """Else the sentence would say "now 7 sigma" of two that it cannot tell apart."""
    share = Share(0.98, 0.03)
    for by_columns, words in ((7.0, "lobe, far (fits 4.4 sigma apart). Take"), (3.0, "lobe, far. Take")):
        tried = [
            explanation("lobe", 639.0, share, {"far": by_columns}),
            explanation("far", 620.0, share, {"lobe": by_columns}),
        ]
        assert words in decided(tried, 32, lambda: "", lambda _: "Take one image.").sentence


def test_of_the_reported_set_the_sentence_names_all() -> None:
    """Those that explain as much and are told apart, too: a reader of the sentence alone would not know of them."""
    share = Share(0.98, 0.03)
    tried = [
        explanation("lobe", 639.0, share, {"far": 3.0, "walls": 8.0}),
        explanation("far", 630.0, share, {"lobe": 3.0}),
        explanation("walls", 560.0, share, {"lobe": 8.0}),
    ]
    verdict = decided(tried, 32, lambda: "", lambda _: "Take one image.")
    assert verdict.set == ("lobe", "far", "walls")
    assert verdict.rivals == ("far",)
    words = "cannot tell apart lobe, far. As much is explained by walls, which they tell from lobe. Take one image."
    assert verdict.sentence.endswith(words)
    beside = decided(tried, 32, lambda: "", lambda _: "Take one image.", beside=["walls"])
    assert "As much" not in beside.sentence


@pytest.mark.parametrize(
    ("left", "drop", "first"), [(0.001, 400.0, "dark"), (0.001, 300.0, "chips"), (0.3, 400.0, "chips")]
)
def test_a_group_that_leaves_structure_is_not_named_before_what_leaves_none(
    left: float, drop: float, first: str
) -> None:
    """Where that lowers chi2 nearly as much: a number for each chip takes most of anything."""
    share = Share(0.98, 0.03)
    group = replace(explanation("chips", 410.0, share, {"dark": 9.0}), has_members=True, p_left=left)
    tried = [group, explanation("dark", drop, share, {"chips": 9.0})]
    assert decided(tried, 32, lambda: "", lambda _: "").set[0] == first


def test_what_noise_does_of_so_many_effects_explains_no_structure() -> None:
    """A fall of 2.8, of a share that is known to 0.26: of 32 effects one lowers chi2 by 14 in one of 200 draws."""
    best = replace(explanation("indices", 2.8, Share(0.01, 0.26), {}), p_left=0.0001)
    words = {
        drop: decided([replace(best, drop=drop)], 32, lambda: "", lambda _: "").word for drop in (2.8, 14.0, 15.0)
    }
    assert words == {2.8: "none_of_the_known", 14.0: "none_of_the_known", 15.0: "one_effect"}
    assert decided([replace(best, p_left=0.3)], 32, lambda: "", lambda _: "").word == "one_effect"


@pytest.mark.parametrize(("numbers", "least"), [(1, 14.85), (2, 18.12), (3, 20.78)])
def test_what_noise_does_grows_with_the_numbers_of_an_effect(numbers: int, least: float) -> None:
    """The chance is meant to be 0.005 of 43 effects: by three numbers a fall of 14.85 has one of 0.002 each."""
    best = replace(explanation("plane", 2.8, Share(0.01, 0.26), {}), p_left=0.0001, numbers=numbers)
    words = [decided([replace(best, drop=drop)], 43, str, str).word for drop in (least - 0.05, least + 0.05)]
    assert words == ["none_of_the_known", "one_effect"]


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (1.61, "lowers the held-out error from 2.49 % to 1.61 %."),
        (2.6, "raises the held-out error from 2.49 % to 2.6 %."),
        (2.4901, "leaves the held-out error at 2.49 %."),
    ],
)
def test_what_becomes_of_the_held_out_error_is_said_as_it_is_written(after: float, words: str) -> None:
    """What is the same in three digits is neither lowered nor raised."""
    best = replace(explanation("walls", 50.0, Share(0.9, 0.05), {}), held_out_percent=(2.49, after))
    assert decided([best], 32, str, str).sentence.endswith(words)


def test_a_sentence_ends_with_what_is_left() -> None:
    """Of rivals one may leave nothing: then nothing is said to be left. A further effect may explain a part of it."""
    leaves = replace(explanation("walls", 50.0, Share(0.9, 0.05), {}), p_left=0.0003)
    nothing = explanation("chip", 49.0, Share(0.9, 0.05), {})
    alone, rivals = Verdict("one_effect", "", ("walls",)), Verdict("cannot_tell_apart", "", ("walls", "chip"))
    left = " Structure is left that nothing named here explains (p 0.0003)."
    assert told_of_rest(alone, [leaves, nothing], [], 0.0003) == left
    assert told_of_rest(alone, [leaves, nothing], [], 0.3) == ""
    assert told_of_rest(rivals, [leaves, nothing], [], 0.0003) == ""
    assert told_of_rest(rivals, [leaves, replace(nothing, p_left=0.0002)], [], 0.0003) == left
    assert (
        told_of_rest(alone, [leaves], ["chip (gain 0.1)"], 0.3) == " What it leaves is explained by chip (gain 0.1)."
    )
    either = further_in_words("chip", "gain 0.1", ["walls", "fog"])
    told = " What it leaves is explained by chip (gain 0.1, not told apart from walls, fog)."
    assert told_of_rest(alone, [leaves], [either], 0.3) == told
    assert further_in_words("chip", "gain 0.1", ()) == "chip (gain 0.1)"
    in_part = " What it leaves is explained in part by chip (gain 0.1); structure is left with all (p 0.0001)."
    assert told_of_rest(alone, [leaves], ["chip (gain 0.1)"], 0.0001) == in_part


@pytest.mark.parametrize(
    ("group", "left", "share", "word"),
    [
        (True, 0.001, 0.95, "none_of_the_known"),
        (True, 0.3, 0.95, "one_effect"),
        (False, 0.001, 0.95, "one_effect"),
        (False, 0.001, 0.6, "none_of_the_known"),
        (False, 0.3, 0.6, "one_effect"),
    ],
)
def test_a_group_alone_must_leave_nothing_an_effect_may_leave_a_fifth(
    group: bool, left: float, share: float, word: str
) -> None:
    """A number for each chip takes most of anything: what it leaves is told by its null, not by its share."""
    share_of = Share(share, 0.02)
    only = replace(explanation("chips", 400.0, share_of, {}), has_members=group, p_left=left)
    first = Verdict("one_effect", "One effect.", ("chips",))
    found = concluded(first, only, [share_of], left, 32, lambda: "stripes.")
    assert found.word == word
    assert (found is first) == (word == "one_effect")
    assert ("What is left: stripes." in found.sentence) == (word != "one_effect")


LIMIT, DARK = "a is at its limit (0 to 1); widen the limits", "an image may be of no light at all"


@pytest.mark.parametrize(("group", "left", "share", "reason", "word"), [
    (False, 0.3, 0.95, LIMIT, "fit_not_trustworthy"),
    (False, 0.001, 0.95, LIMIT, "one_effect"),
    (False, 0.001, 0.5, LIMIT, "none_of_the_known"),
    (False, 0.001, 0.95, DARK, "fit_not_trustworthy"),
    (True, 0.3, 0.95, LIMIT, "fit_not_trustworthy"),
    (True, 0.001, 0.95, LIMIT, "none_of_the_known"),
])  # fmt: skip
def test_a_doubted_fit_is_mended_first_but_for_limits_to_which_what_is_missing_may_drive_it(
    group: bool, left: float, share: float, reason: str, word: str
) -> None:
    """While structure is left, something else may be what drives the fit to a limit; other doubts stay."""
    told = Share(share, 0.02)
    only = replace(explanation("chips", 400.0, told, {}), has_members=group, p_left=left, distrust=(reason,))
    first = Verdict("one_effect", "One effect.", ("chips",))
    found = concluded(first, only, [told], left, 32, lambda: "stripes.")
    assert found.word == word
    assert (reason in found.sentence) == (word != "one_effect")  # there it follows (`told_of_rest`)


def test_a_limit_that_is_left_standing_is_told() -> None:
    """Beside structure that is left: sizes are in doubt as long as a parameter is at its limit."""
    held = replace(explanation("walls", 50.0, Share(0.9, 0.05), {}), p_left=0.0003, distrust=(LIMIT,))
    alone = Verdict("one_effect", "", ("walls",))
    left = " Structure is left that nothing named here explains (p 0.0003)."
    assert told_of_rest(alone, [held], [], 0.0003) == f"{left} With walls added, {LIMIT}."


def test_what_all_rounds_explain_is_what_none_of_them_leaves() -> None:
    """Halves of halves, each with one error in its favour: 1 - 0.5 x 0.5 is below 0.8, 1 - 0.4 x 0.4 above."""
    half, more = Share(0.4, 0.1), Share(0.5, 0.1)
    assert leaves_too_much(0.001, [half, half])
    assert not leaves_too_much(0.001, [more, more])
    assert not leaves_too_much(0.006, [half])
    assert leaves_too_much(0.0049, [Share(-3.0, 0.1), Share(0.7, 0.05)])


@pytest.mark.parametrize(
    ("group", "left", "share", "guess"),
    [
        (True, 0.001, 0.9, True),
        (True, 0.3, 0.9, False),
        (False, 0.001, 0.9, False),
        (False, 0.001, 0.4, True),
        (False, 0.3, 0.4, False),
    ],
)
def test_a_second_effect_that_leaves_structure_is_a_guess_where_it_is_a_group_or_small(
    group: bool, left: float, share: float, guess: bool
) -> None:
    """So many members explain 0.9 of most things."""
    best = replace(explanation("chips", 400.0, Share(share, 0.02), {}), has_members=group, p_left=left)
    assert is_a_guess(best) == guess
