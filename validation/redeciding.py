"""Level 3 of a replay: what was decided, anew from the numbers that were told with it.

compare, where  the sentence from the p-values of the shots and that of all together
diagnose        the verdict and its set from shares, held-out errors, p-values and rivals; ranks
add, remove     what changed from the two models; the errors of the ladder from those before and after, and whether
                the version that the model file keeps still has them
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from luxloop.audit import Place
from luxloop.errors import InputError
from luxloop.model import Model
from luxloop.model_file import diff, parse_toml
from validation.comparing import SEEN, differing, sentence_of
from validation.diagnose.explained import Share
from validation.diagnose.explanation import Explanation
from validation.diagnose.held_out import Change
from validation.diagnose.ladder import BEFORE, Rung
from validation.diagnose.verdict import (
    Verdict,
    concluded,
    decided,
    further_in_words,
    is_visible,
    told_of_rest,
)
from validation.fit import AT_LIMIT
from validation.model_versions import versions
from validation.sample_values import numbers

Document = Mapping[str, Any]


def shots_in_words(document: Document, said: str) -> str:
    """What follows of a comparison's shots; as it was said when each was held to the whole of `SEEN`, if so."""
    structure, shots = document["structure"], document["shots"]
    p_of = {shot["id"]: shot["p"] for shot in shots}
    curves = any(shot["kind"] != "image" for shot in shots)
    before, now = (
        sentence_of(count, len(p_of), structure["p"], structure["p_text"], curves=curves)
        for count in (sum(p < SEEN for p in p_of.values()), len(differing(p_of, structure["p"])))
    )
    return before if said == before else now


def diagnosis(document: Document, at: Place) -> None:
    """Compares a diagnosis with what follows from its numbers."""
    tried = [explanation_of(row) for row in document["effects"]]
    again = verdict_of(document, tried)
    if again is None:
        at.exact("verdict", document["verdict"], "fit_not_trustworthy" if document["distrust"] else "nothing_visible")
    else:
        at.exact("verdict", document["verdict"], again.word)
        at.exact("set of the verdict", document["set"], list(again.set))
        if again.word == "one_effect":
            sentence = again.sentence + _rest(document, again, tried)
            at.exact("sentence", document["sentence"], _as_before(sentence, document["sentence"]))
    drops = [(not one.plausible, -one.drop) for one in tried]
    at.exact("effects, the best first", drops, sorted(drops))
    scored = [-row["chi2_drop"] for row in document["scores"]]
    at.exact("scores, the best first", scored, sorted(scored))


def verdict_of(document: Document, tried: Sequence[Explanation]) -> Verdict | None:
    """The verdict on what was tried; None where nothing was to be seen, or the fit was in doubt before any score."""
    in_doubt = not document["scores"] and any(AT_LIMIT not in reason for reason in document["distrust"])
    if in_doubt or not is_visible(document["structure"]["p"], document["scores_p"]):
        return None
    added = document["added"]
    beside = added[0].get("beside") if added else None  # told since decision 54
    found = decided(tried, document["known"], str, lambda _: "", beside=beside)
    only = next((one for one in tried if one.name in found.set[:1]), None) if len(added) == 1 else None
    leads_on = bool(added) and added[-1].get("leads_on", False)  # told since decision 44, as errors of shares are
    shares = [Share(row["share"], _infinite(row["share_error"])) for row in added] if leads_on else []
    p_left = added[-1]["p_left"] if added else 1.0
    return concluded(found, only, shares, p_left, document["known"], lambda: "")


def _rest(document: Document, first: Verdict, tried: Sequence[Explanation]) -> str:
    """What is said after the first round's sentence; as it was said before structure that is left was told, if so."""
    added = document["added"]
    if not added:
        return ""
    further = [further_in_words(row["name"], row["size"], row.get("rivals", ())) for row in added[1:]]
    before = told_of_rest(first, (), further, 1.0)
    told = told_of_rest(first, tried, further, added[-1]["p_left"])
    return before if document["sentence"] == first.sentence + before else told


def _as_before(sentence: str, told: str) -> str:
    """A sentence as it was told before an error that stays the same was told so, if that is how it was told."""
    stays = r"leaves the held-out error at (\S+ %)"
    before = [re.sub(stays, rf"{moves} the held-out error from \1 to \1", sentence) for moves in ("lowers", "raises")]
    return told if told in before else sentence


def explanation_of(row: Document) -> Explanation:
    """What an effect came to, as its row says."""
    ((parameter, size),) = row["size"].items()
    change, percents = row["held_out_density_change"], (row["held_out_before"], row["held_out_after"])
    return Explanation(
        name=row["name"], parameter=parameter, unit=size["unit"], value=size["value"],
        error=_infinite(size["error"]), shape=tuple(row["shape"].items()), drop=row["chi2_drop"],
        share=Share(row["explained_share"], _infinite(row["explained_share_error"])),
        held_out=None if change is None else Change(change, row["held_out_density_error"]),
        held_out_percent=None if None in percents else percents, log_evidence=row["log_evidence"],
        plausible=row["plausible"], at_end=row.get("at_end", False), has_members=row.get("has_members", False),
        by_place=row.get("by_place"), distrust=tuple(row["distrust"]),
        p_left=row["p_left"], sigma=row["sigma"], sigma_rival=row["sigma_rival"],
        as_well=tuple(tuple(words) for words in row["fits_as_well"]), numbers=row.get("numbers", 1),
    )  # fmt: skip


def changed_model(document: Document, command: str, before: Model | None, at: Place) -> None:
    """Compares what add or remove told with the models before and after, and with the version that is kept."""
    after = parse_toml(document["after_model"], "after_model")
    at.exact("model after", document["after_sha256"], after.sha256)
    if before is not None:
        at.exact("what changed", document["diff"], [str(one) for one in diff(before, after)])
    here = numbers(after)
    for row in document["fitted"]:
        at.exact("fitted value", row["value"], here.get(row["path"]), row["path"])
    at.exact("trusted", document["trusted"], not document["reason"])
    rungs = Rung(**document["after"]), Rung(**document["before"])
    at.exact("errors of the version", document["errors"], rungs[0].errors() | rungs[1].errors(BEFORE))
    _ladder(document, f"{command} {document['effect']}", at)


def _ladder(document: Document, command: str, at: Place) -> None:
    """Compares with the line that the model file's versions have of it."""
    file = Path(document["model"]["path"])
    try:
        kept = [one for one in versions(file) if (one.command, one.sha256) == (command, document["after_sha256"])]
    except (InputError, OSError) as error:
        at.nothing("entry of the ladder", f"{error}"[:300])
        return
    if not kept:
        at.nothing("entry of the ladder", f"{file.name} has no version by {command!r} with this model")
    elif document["errors"] not in [one.errors for one in kept]:
        at.exact("entry of the ladder", document["errors"], kept[-1].errors, f"version {kept[-1].number}")
    else:
        at.exact("entry of the ladder", document["errors"], document["errors"])


def _infinite(value: float | None) -> float:
    """Documents write an error that is not known as null."""
    return float(np.inf) if value is None else value
