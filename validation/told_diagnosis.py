"""What diagnose, next, add and ladder say on a terminal."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from validation.diagnose.explanation import size_in_words
from validation.diagnose.proposal import chip_by_chip, next_in_words
from validation.told import binned, table, warnings

Document = Mapping[str, Any]

SCORES, CANDIDATES, NAMED, MOST_NAMES = 8, 8, 6, 8
OPTIONS = {
    "--model", "--free", "--histories", "--most-histories", "--seed", "--pixel-um", "--film", "--runs", "--router",
}  # fmt: skip
FLAGS = {"--twin", "--no-local"}
"""Of diagnose, which add has, too: what both say of the fit."""
LONGEST = 118
"""Characters of a line of a diff: values of many chips are long."""


def diagnosis(document: Document) -> Iterator[str]:
    """The verdict, the effects that were tried, what else scored, the rivals, the next measurement."""
    yield document["sentence"]
    found = document["structure"]
    chance = "< 1e-9" if document["scores_p"] < 1e-9 else f"{document['scores_p']:.2g}"
    yield f"Structure: p {found['p_text']}; the {document['known']} known effects: p {chance}."
    yield from warnings(document)
    yield from (one["words"] for one in document["held"])
    yield from binned(document["shots"], [document["sentence"]])
    if document["effects"]:
        yield ""
        heads = ("effect", "size", "chi2 drop", "explains", "held-out error", "ln evidence", "p left", "alike")
        yield from table(heads, [_effect(row) for row in document["effects"]])
    others: list[Document] = [
        row for row in document["scores"] if row["name"] not in {one["name"] for one in document["effects"]}
    ]
    if others:
        yield ""
        yield "scored, not tried: " + ", ".join(f"{row['name']} {row['z']:+.1f}" for row in others[:SCORES])
    if document["parameters"]:
        yield ""
        yield from table(
            ("fitted", "without", "with the best effect", "prior"), [_moved(r) for r in document["parameters"]]
        )
    if document["limits"] and document["verdict"] == "nothing_visible":
        yield ""
        yield from _seen_above(document["limits"])
    if document["candidates"]:
        yield ""
        yield from next_measurement(document)
    if document["set"] and (document["verdict"] == "one_effect" or not document["candidates"]):
        yield ""
        yield f"{add_command(document)} puts it into {document['model']['file']}."
    for reason in document["untestable"]:
        yield f"not testable with these data: {reason}, for what is fitted anyway does all that it does"
    by_reason: dict[str, list[str]] = {}
    for name, _, reason in (line.partition(": ") for line in document["not_tested"]):
        by_reason.setdefault(reason, []).append(name)
    for reason, names in by_reason.items():
        which = ", ".join(names) if len(names) <= MOST_NAMES else f"{len(names)} effects"
        yield f"not testable with these data: {which}, because {reason}"


def add_command(document: Document) -> str:
    """The command that adds the effect which a verdict names, to the same model, fitted as it was for the verdict."""
    words, kept = iter(shlex.split(document["command"])), []
    for word in words:
        name, is_joined = word.partition("=")[::2]
        if name in FLAGS or (name in OPTIONS and is_joined):
            kept.append(word)
        elif name in OPTIONS:
            kept += [word, next(words, "")]
    return shlex.join(["luxloop", "add", document["set"][0], *kept])


def _seen_above(limits: Sequence[Document]) -> Iterator[str]:
    rows = [(f"{row['name']}.{row['parameter']}", f"{row['value']:.2g} {row['unit']}") for row in limits]
    yield from table(("effect", "would have been seen above"), rows)


def next_measurement(document: Document) -> Iterator[str]:
    """Candidates by what they would bring, and what to write into the manifest."""
    left_out = document.get("left_out", ())  # of `next`; a diagnosis says it in its sentence
    if not document["candidates"]:
        yield next_in_words((), left_out)
        return
    yield "Camera targets (a flat field, a slanted edge, an exposure series) settle what the camera does first."
    rows = [
        (row["words"], f"{row['expected_sigma']:.1f}", f"{row['now_sigma']:.1f}")
        for row in document["candidates"][:CANDIDATES]
    ]
    yield from table(("one more image", "expected sigma", "now"), rows)
    if left_out:
        yield f"That is of the others: {chip_by_chip(left_out)}"
    yield ""
    yield document["next_measurement"]["stanza"]


def ladder(document: Document) -> Iterator[str]:
    """A row for each version of the model."""
    heads = {"fitted_percent": "error", "held_out_percent": "held out", "blocks_percent": "in blocks",
             "noise_percent": "noise", "curves_fitted_percent": "error of curves",
             "curves_held_out_percent": "held out", "curves_noise_percent": "noise"}  # fmt: skip
    always = ("fitted_percent", "held_out_percent", "noise_percent")
    names = [name for name in heads if name in always or any(row.get(name) is not None for row in document["rungs"])]
    told = ("version", "by", *(heads[name] for name in names), "p of structure", "effects")
    yield from table(told, [_rung(row, names) for row in document["rungs"]])
    moved = document["parameters"]
    if moved:
        yield ""
        versions = [str(row["version"]) for row in document["rungs"]]
        columns = ("parameter", "prior", *(f"v{number}" for number in versions))
        yield from table(columns, [(r["path"], r["prior"], *r["values"]) for r in moved])


def added(document: Document) -> Iterator[str]:
    """What add and remove did."""
    yield from (line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..." for line in document["diff"])
    yield from _fitted_values(document["fitted"])
    before, after = document["before"], document["after"]
    errors = {
        "fitted_percent": "error in what was fitted", "held_out_percent": "held-out error",
        "blocks_percent": "held-out error, halves of the images in blocks",
    }  # fmt: skip
    for lead, what in (("", ""), ("curves_", ", of the curves")):
        for name, words in errors.items():
            if before.get(lead + name) is not None and after.get(lead + name) is not None:
                error, noise = after[lead + name], after[f"{lead}noise_percent"]
                yield f"{words}{what}: {before[lead + name]:.3g} % -> {error:.3g} % (noise {noise:.3g} %)"
    if after["held_out_percent"] is None:
        yield "held-out error: not computable, for a single sample leaves nothing to fit to when it is left out"
    yield f"p of structure: {before['p']:.2g} -> {after['p']:.2g}"
    if not document["trusted"]:
        yield f"Not to be trusted: {document['reason']}."
    yield from warnings(document)
    if document["version"] is None:
        yield f"{document['model']['file']} is as it was."
    else:
        file = document["model"]["file"]
        yield f"{file} is version {document['version']}; undo: luxloop model undo {file}"


def _fitted_values(rows: Sequence[Document]) -> Iterator[str]:
    """A line for each value; of the chips of a sample one line for all."""
    for name, several in groupby(rows, lambda row: row["group"] or row["path"]):
        some = list(several)
        value, error, unit = some[0]["value"], some[0]["error"], some[0]["unit"]
        if some[0]["group"] is None:
            yield f"{name} {_with_error(value, error)} {unit}".rstrip()
            continue
        rms = (sum(row["value"] ** 2 for row in some) / len(some)) ** 0.5
        worst = max(row["error"] or 0.0 for row in some)
        yield f"{name} of {len(some)} chips: {rms:.3g} {unit}".rstrip() + f" rms, each +- {worst:.2g} or less"


def _effect(row: Document) -> tuple[str, ...]:
    ((name, size),) = row["size"].items()
    held = "not possible"
    if row["held_out_before"] is not None:
        held = f"{row['held_out_before']:.3g} -> {row['held_out_after']:.3g} %"
    evidence = "" if row["log_evidence"] is None else f"{row['log_evidence']:.0f}"
    share = "nothing to explain"
    if (error := row["explained_share_error"]) is not None:
        digits = (error < 0.0095) + (error < 0.00095)  # whole percents would say that it is known exactly
        share = f"{100.0 * row['explained_share']:.{digits}f} +- {100.0 * error:.{digits}f} %"
    ends = row.get("at_end", False)
    return (
        row["name"] + (f" ({row['why_not']})" if row["why_not"] else ""),
        size_in_words(name, size["value"], size["error"], size["unit"], row["shape"], row["fits_as_well"], ends),
        f"{row['chi2_drop']:.0f}",
        share,
        held,
        evidence,
        f"{row['p_left']:.2g}",
        ", ".join(row["group"][:NAMED]),
    )


def _moved(row: Document) -> tuple[str, ...]:
    held = ", at its limit" if row["at_limit"] else ""
    prior = "" if row["prior_mean"] is None else f"{row['prior_mean']:g} +- {row['prior_sd']:g}"
    after = "" if row["with"] is None else _with_error(row["with"], row["with_error"])
    return row["path"], _with_error(row["value"], row["error"]) + held, after, prior


def _with_error(value: float, error: float | None) -> str:
    """None: the data do not know it."""
    return f"{value:.4g}" if error is None else f"{value:.4g} +- {error:.2g}"


def _rung(row: Document, names: Sequence[str]) -> tuple[str, ...]:
    return (
        str(row["version"]),
        row["command"],
        *(_percent(row[name]) for name in names),
        "" if row["p"] is None else f"{row['p']:.2g}",
        ", ".join(row["effects"]) or "-",
    )


def _percent(value: float | None) -> str:
    return "" if value is None else f"{value:.3g} %"
