"""What the rounds of a diagnosis found, and what they come to together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from validation.diagnose.explanation import LEVEL, Explanation
from validation.diagnose.ground import Ground
from validation.diagnose.in_words import left_in_words
from validation.diagnose.proposal import Proposal
from validation.diagnose.refitted import Refitted
from validation.diagnose.score import Scores
from validation.diagnose.verdict import HALF, Verdict, concluded, further_in_words, told_of_rest
from validation.effects.confounding import Confounding
from validation.fit import Fit

SURE = 3.0
"""Errors by which the first of two effects must be off its off value beside the second."""


@dataclass(frozen=True, eq=False)
class Step:
    """One round: what scored on a fit, what each of the short list came to."""

    ground: Ground
    scores: Scores
    confounding: Confounding
    refits: tuple[Refitted, ...]
    explanations: tuple[Explanation, ...]
    verdict: Verdict
    proposals: tuple[Proposal, ...] = ()
    """Where it cannot tell effects apart: the measurements that would."""
    beside: tuple[str, ...] | None = None
    """Effects of further rounds with which the verdict was made: together with its best one they leave nothing."""

    @property
    def best(self) -> Explanation:
        """The explanation that the verdict names first."""
        return next(one for one in self.explanations if one.name == self.verdict.set[0])

    @property
    def kept(self) -> Refitted | None:
        """The refit of the effect that the verdict names first; None where it names none."""
        return next((one for one in self.refits if one.candidate.effect.name in self.verdict.set[:1]), None)

    @property
    def leads_to(self) -> Fit | None:
        """The fit beside which another effect can be looked for; None without one, or of a group by a line."""
        return None if self.kept is None else self.kept.fit


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """All rounds; the first one's verdict is the verdict."""

    steps: tuple[Step, ...]
    known: int
    """Effects that the first round tested; of a fit that may not be trusted, that there are."""

    @property
    def verdict(self) -> Verdict:
        """Of the first round; a second effect that was found besides is told after it, and what is left with all."""
        first, added, ground = self.steps[0].verdict, self.added, self.steps[0].ground
        only = added[0] if len(added) == 1 else None
        shares = [one.share for one in added] if self.steps[-1].leads_to is not None else []
        p_left = added[-1].p_left if added else 1.0
        found = concluded(
            first, only, shares, p_left, self.known, lambda: left_in_words(ground, self.steps[0].explanations)
        )
        if not added or found is not first:
            return found
        named = [step for step in self.steps if step.verdict.names]
        further = [further_in_words(step.best.name, step.best.size, step.verdict.rivals) for step in named[1:]]
        rest = told_of_rest(first, self.steps[0].explanations, further, p_left)
        return replace(first, sentence=first.sentence + rest)

    @property
    def added(self) -> list[Explanation]:
        """The effect of each round that was kept, and of the last one where it explains what is left."""
        return [step.best for step in self.steps if step.verdict.names]

    @property
    def set(self) -> tuple[str, ...]:
        """Names of the effects that the verdict speaks of."""
        return self.steps[0].verdict.set if self.verdict.names else ()

    @property
    def proposals(self) -> tuple[Proposal, ...]:
        """The measurements that the last round which could not tell effects apart asks for."""
        asked = [step.proposals for step in self.steps if step.verdict.word == "cannot_tell_apart"]
        return asked[-1] if asked and self.verdict.names else ()


def trusted(steps: Sequence[Step]) -> list[Step]:
    """The rounds without the last ones that name nothing, or nothing to be trusted: the ones before stand.

    So does what leaves structure and explains less than half of what was there, or is a group of many members: as a
    second effect it is a guess.
    """
    found = list(steps)
    while len(found) > 1 and (found[-1].kept is None or found[-1].best.distrust or is_a_guess(found[-1].best)):
        found.pop()
    return found


def is_a_guess(best: Explanation) -> bool:
    """Whether an effect explains less than half, or is a group, and leaves structure."""
    return (best.share.value < HALF or best.has_members) and best.p_left < LEVEL / 2.0


def is_the_rest(part: Step, rest: Step) -> bool:
    """Whether the effect of a further round explains all that a part leaves, and the part is still there beside it.

    Neither may be a group, which takes most of anything (what leads on has numbers of a model), nor be in doubt.
    """
    if part.kept is None or rest.leads_to is None or rest.best.has_members or rest.best.distrust:
        return False
    return rest.best.p_left >= LEVEL / 2.0 and _still_there(part.kept, rest.leads_to)


def _still_there(first: Refitted, both: Fit) -> bool:
    """Whether a number of an effect is off its off value in the fit with another one, too; a switch is."""
    if first.candidate.is_switch:
        return True
    tried = (first.candidate, *first.candidate.others)
    found = [(one.parameter.off, path) for one, path in zip(tried, first.paths, strict=True) if path in both.names]
    return any(
        isinstance(off, float) and abs(both.value(path) - off) > SURE * both.error(path) for off, path in found
    )
