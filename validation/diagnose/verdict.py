"""The verdict: one of five sentences, decided by rules that a reader can follow.

    fit_not_trustworthy   the fit itself says so; but by a limit only where no structure is left: what is missing yet
                          may drive a parameter there, and it is told beside
    nothing_visible       neither structure nor any effect's score is unlikely, each at half the level
    none_of_the_known     the best effect explains less than half of the structure by an error (by two, where the
                          share is known to no better than 0.15), or lowers chi2 by no more than noise does of so
                          many effects (15 by one number of 43 effects, 18 by two), and structure is left; or all
                          that was kept, round by round, explains less than 0.8, and structure is left; or a group is
                          all that was kept, and structure is left: with a number for each chip it takes most of
                          anything (one whose members follow the field is not even tried: chips know nothing of it).
                          Not where a second effect explains all that the best one leaves: both are named
    cannot_tell_apart     a rival explains nearly as much, and less than 5 sigma would be left of the one beside it,
                          or the two fits are nearer to each other than that
    one_effect            else

A rival explains nearly as much where its share is within 0.1 of the best. Where shares are known to no better than
0.15, where it lowers chi2 by 0.8 as much, or where noise may have put the other first.

The largest gain always blames somebody; so what decides is the share explained, what is left, and whether rivals can
be told apart. Chi2 only ranks; the error in data that the fit has not seen is told beside, and decides nothing: of
true effects, too, it rises in some (docs/figures.md, "Blind test").
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Literal

from scipy.special import chdtri  # scipy.stats takes half a second to import

from validation.diagnose.explained import Share
from validation.diagnose.explanation import LEVEL, Explanation
from validation.effects.confounding import TOLD_APART

Word = Literal["nothing_visible", "one_effect", "cannot_tell_apart", "none_of_the_known", "fit_not_trustworthy"]

HALF = 0.5
ENOUGH = 0.8
"""Of the structure: what effects that are said to explain the misfit explain together, where some of it is left."""
ALIKE = 0.10
"""Effects that explain within this of the best are in the set."""
NOISE_SIGMA, NOISE_DROP = 2.0, 9.0
"""Noise may have put one of two weak effects first whose falls of chi2 differ by less than this, and their square
roots, which have noise of 1 each, by less than that."""


@dataclass(frozen=True)
class Verdict:
    """What is said, and about whom."""

    word: Word
    sentence: str
    set: tuple[str, ...] = ()
    """Effects that explain within 10 % of the best."""
    rivals: tuple[str, ...] = ()
    """Of these, the ones that the data cannot tell from the best."""

    @property
    def names(self) -> bool:
        """Whether it names an effect, or several."""
        return self.word in ("one_effect", "cannot_tell_apart")


def not_trustworthy(reasons: Sequence[str]) -> Verdict:
    """The fit itself is in doubt."""
    return Verdict(
        "fit_not_trustworthy", f"The fit itself is not trustworthy: {'; '.join(reasons)}. Mend this first."
    )


def nothing_visible(limits: Sequence[str], more: str = "") -> Verdict:
    """Noise explains everything; `limits`: above which sizes one would have been seen; `more`: how."""
    seen = f": {', '.join(limits)}" if limits else ": none can be tested with these data"
    return Verdict(
        "nothing_visible",
        f"No missing effect visible. An effect of this kind would have been seen above{seen}.{more}",
    )


def is_visible(p_structure: float, p_scores: float) -> bool:
    """Whether there is anything to explain; each test has half of the level."""
    return min(p_structure, p_scores) < LEVEL / 2.0


def decided(
    explanations: Sequence[Explanation],
    known: int,
    left: Callable[[], str],
    next_image: Callable[[Sequence[str]], str],
    *,
    beside: Collection[str] | None = None,
) -> Verdict:
    """The verdict on what was tried.

    Parameters
    ----------
    explanations : of the short list. known : how many effects there are.
    left : what is left, in words, asked where nothing known explains it.
    next_image : what would separate the effects of these names, asked where the data do not.
    beside : effects that explain, in a fit with the best one, all that it leaves: it need not explain half by itself,
    and they are no rivals of it. None: it is alone.
    """
    usable = _in_order([one for one in explanations if one.plausible])
    too_little = bool(usable) and beside is None and _explains_too_little(usable[0])
    if not usable or too_little or _is_noise(usable[0], known):
        return none_of_the_known(known, max((one.share.value for one in explanations), default=0.0), left())
    best, others = usable[0], usable[1:]
    if best.distrust and best.p_left >= LEVEL / 2.0:  # else another effect may be what drives it there
        return doubted(best)
    alike = [one for one in others if _alike(best, one)]
    names = (best.name, *(one.name for one in alike))
    others_too = () if beside is None else beside
    rivals = [one for one in alike if one.name not in others_too and _sigma_apart(best, one) < TOLD_APART]
    if rivals:
        told = [best.name, *(one.name for one in rivals)]
        also = [name for name in names if name not in told and name not in others_too]
        more = f" As much is explained by {', '.join(also)}, which they tell from {best.name}." if also else ""
        sentence = f"The data cannot tell apart {', '.join(told)}{_by_fits(best, rivals)}.{more} {next_image(told)}"
        return Verdict("cannot_tell_apart", sentence, names, tuple(told[1:]))
    held = "a held-out test is not possible with these data"
    if best.held_out_percent is not None:
        held = _moved(*best.held_out_percent)
    following = f" Next best: {_next_best(others[0])}." if others else ""
    sentence = (
        f"One effect explains the misfit: {best.name}, {best.size}."
        f" It explains {100.0 * best.share.value:.0f} % of the structure and {held}.{following}"
    )
    return Verdict("one_effect", sentence, names)


def none_of_the_known(known: int, share: float, left: str) -> Verdict:
    """What is there is none of so many effects; `share`: that the best of them explains; `left`: in words."""
    percent = 100.0 * max(share, 0.0)
    sentence = (
        f"None of the {known} known effects explains this (best: {percent:.0f} %). What is left: {left}"
        " Write an effect: luxloop effects new."
    )
    return Verdict("none_of_the_known", sentence)


def leaves_too_much(p_left: float, shares: Sequence[Share]) -> bool:
    """Whether structure is left with all effects that were kept, and they explain too little for it to be noise.

    `shares`: of the structure that each round found, each with one of its errors in its favour.
    """
    left = math.prod(1.0 - min(max(one.value + one.error, 0.0), 1.0) for one in shares)
    return p_left < LEVEL / 2.0 and 1.0 - left < ENOUGH


def concluded(
    first: Verdict,
    only: Explanation | None,
    shares: Sequence[Share],
    p_left: float,
    known: int,
    left: Callable[[], str],
) -> Verdict:
    """The verdict once all rounds are over, from that of the first.

    Parameters
    ----------
    only : the effect that was kept, where it is the only one; a group by the fit of all its members. shares : of all
    that were kept, round by round; none where no further round could be tried. p_left : of the structure that they
    leave.
    known : effects that there are. left : what is left, in words.
    """
    group_leaves = only is not None and only.has_members and p_left < LEVEL / 2.0
    if only is not None and only.doubts() and not group_leaves:
        return doubted(only)
    if shares and (group_leaves or leaves_too_much(p_left, shares)):
        held = "" if only is None else _held(only)
        return none_of_the_known(known, shares[0].value, left() + held)
    return first


def further_in_words(name: str, size: str, rivals: Sequence[str]) -> str:
    """An effect of a further round."""
    return f"{name} ({size}" + (f", not told apart from {', '.join(rivals)})" if rivals else ")")


def told_of_rest(first: Verdict, tried: Sequence[Explanation], further: Sequence[str], p_left: float) -> str:
    """What follows a sentence that names effects: what explains what they leave, and whether structure is left.

    Parameters
    ----------
    tried : in the first round. further : effects of further rounds, with their sizes. p_left : of the structure that
    all of them leave; of rivals that is looked at which leaves least, for which it is cannot be told.
    """
    if first.word == "cannot_tell_apart" and not further:
        p_left = max((one.p_left for one in tried if one.name in first.set), default=p_left)
    leaves = p_left < LEVEL / 2.0
    if further:
        named = ", ".join(further)
        in_part = f"is explained in part by {named}; structure is left with all (p {p_left:.2g})."
        return f" What it leaves {in_part}" if leaves else f" What it leaves is explained by {named}."
    best = next((one for one in tried if one.name in first.set[:1]), None)
    held = "" if best is None else _held(best)
    return f" Structure is left that nothing named here explains (p {p_left:.2g}).{held}" if leaves else ""


def _held(best: Explanation) -> str:
    """What stays at its limit with the best effect, as sentences."""
    return "".join(f" With {best.name} added, {one}." for one in best.distrust)


def doubted(best: Explanation) -> Verdict:
    """The fit is in doubt even with the best effect."""
    return not_trustworthy([f"with {best.name} added, {reason}" for reason in best.distrust])


def _in_order(usable: Sequence[Explanation]) -> list[Explanation]:
    """By falling drop; before a group that leaves structure comes what lowers chi2 nearly as much and leaves none."""
    usable = sorted(usable, key=lambda one: -one.drop)
    best, others = next(iter(usable), None), usable[1:]
    if best is None:
        return []
    if best.has_members and best.p_left < LEVEL / 2.0:
        near = (one for one in others if one.p_left >= LEVEL / 2.0 and one.drop > (1.0 - 2.0 * ALIKE) * best.drop)
        best = next(near, best)
    return [best, *(one for one in usable if one is not best)]


def _explains_too_little(best: Explanation) -> bool:
    """Less than half, with its error (twice it where that is wide), while structure is left."""
    errors = 1.0 if best.share.decides else 2.0
    return best.share.value + errors * best.share.error < HALF and best.p_left < LEVEL / 2.0


def _is_noise(best: Explanation, known: int) -> bool:
    """Whether noise alone would lower chi2 as much by as many numbers of one of so many effects, structure left."""
    return best.drop < chdtri(best.numbers, LEVEL / 2.0 / max(known, 1)) and best.p_left < LEVEL / 2.0


def _alike(best: Explanation, other: Explanation) -> bool:
    """Whether another effect explains within 10 % of the best, by a share that decides; else by chi2."""
    if best.share.decides and other.share.decides:
        return other.share.value > best.share.value - ALIKE
    within = math.sqrt(max(best.drop, 0.0)) - math.sqrt(max(other.drop, 0.0)) < NOISE_SIGMA
    by_noise = within and best.drop - other.drop < NOISE_DROP
    return by_noise or other.drop > (1.0 - 2.0 * ALIKE) * best.drop


def _sigma_apart(best: Explanation, other: Explanation) -> float:
    """By how many sigma the data tell a rival from the best: by their columns, and no better than by their fits.

    Columns are those of the fit without either, which may be at a limit; fits have left it, each in its own way.
    """
    return min(_sigma_by_columns(best, other), _sigma_by_fits(best, other))


def _sigma_by_columns(best: Explanation, other: Explanation) -> float:
    return best.sigma_rival.get(other.name, best.sigma)


def _sigma_by_fits(best: Explanation, other: Explanation) -> float:
    return math.sqrt(max(best.drop - other.drop, 0.0))


def _by_fits(best: Explanation, rivals: Sequence[Explanation]) -> str:
    """How near the fits are, where columns alone would tell a rival: what `next` says of now is by columns."""
    near = [_sigma_by_fits(best, one) for one in rivals if _sigma_by_columns(best, one) >= TOLD_APART]
    return f" (fits {min(near):.1f} sigma apart)" if near else ""


def _moved(before: float, after: float) -> str:
    """What becomes of the held-out error, in percent."""
    if f"{before:.3g}" == f"{after:.3g}":
        return f"leaves the held-out error at {before:.3g} %"
    return f"{'lowers' if after < before else 'raises'} the held-out error from {before:.3g} % to {after:.3g} %"


def _next_best(other: Explanation) -> str:
    return f"{other.name} ({100.0 * other.share.value:.0f} %, chi2 drop {other.drop:.0f})"
