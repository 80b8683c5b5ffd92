"""What `luxloop blind` says on a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from validation.told import table

Document = Mapping[str, Any]

FEW = 8
MISSES = 20
"""Told of all; the page has the others."""


def made(document: Document) -> Iterator[str]:
    """What was made, and what comes next."""
    yield f"{document['folder']}: {document['sets']} sets, their answers sealed"
    yield f"root of all seals: {document['root']} (note it: score prints it, too)"
    yield from kinds_left_out(document)
    yield f"next: luxloop blind diagnose {document['folder']}, then luxloop blind score {document['folder']}"


def judged(document: Document) -> Iterator[str]:
    """The verdicts of this run by kind, and what comes next."""
    yield f"{document['folder']}: {document['judged']} verdicts put on record, {document['before']} were there"
    if document["verdicts"]:
        yield ", ".join(f"{name} {count}" for name, count in document["verdicts"].items())
    if document["not_made"]:
        again = f"repeat the `luxloop blind make {document['folder']} ...` that began them, then diagnose again"
        yield f"{document['not_made']} sets are not made yet: {again}"
    if document["last_verdict"]:
        yield f"verdicts: {document['last_verdict']} (note it: score prints it, too)"
    yield f"next: luxloop blind score {document['folder']}"


def measured(document: Document) -> Iterator[str]:
    """What was taken, and what comes next."""
    folder, of = document["folder"], document["of"]
    yield f"{folder}: {document['sets']} sets of {of} with the image that their verdict proposed"
    yield f"next: luxloop blind diagnose {folder}, then luxloop blind score {of} {folder}"


def scored(document: Document) -> Iterator[str]:
    """The table, who was taken for whom by group, the misses."""
    yield document["sentence"]
    if document["further"]:
        yield further(document["further"])
    if document["without_verdict"]:
        yield f"{document['without_verdict']} more that were asked for have no verdict: not made, or not judged."
    yield from (taken_away(folder, names) for folder, names in document["gone"].items() if names)
    yield from codes(document)
    yield from roots(document["roots"])
    yield from (f"verdicts of {name}: {end}" for name, end in document["last_verdicts"].items() if end)
    if document["not_checked"]:
        yield not_checked(document["not_checked"])
    yield ""
    yield from table(("quantity", "target", "hits", "found", "95 %", ""), [_row(row) for row in document["table"]])
    yield ""
    yield from _confusion(document["confusion"]["groups"])
    if document["misses"]:
        yield ""
        heads = ("missed", "hidden", "sigma", "beside its rival", "said")
        yield from table(heads, [_miss(one, document) for one in document["misses"][:MISSES]])
        if len(document["misses"]) > MISSES:
            yield f"... and {len(document['misses']) - MISSES} more: --page shows all of them"
    yield from kinds_left_out(document)
    for words, name in (("to make a set", "made"), ("to diagnose one", "diagnosed"),
                        ("to diagnose another one of its light", "diagnosed_again")):  # fmt: skip
        if spread := document["seconds"][name]:
            yield f"{words}: {spread['median']:.0f} s (median of {spread['sets']}), at most {spread['most']:.0f} s"


def taken_away(folder: str, names: Sequence[str]) -> str:
    """Sets that were bound in a folder and are not there."""
    which = ", ".join(names) if len(names) <= FEW else f"{', '.join(names[:FEW])} and {len(names) - FEW} more"
    return f"Bound by the root of {folder}, and not there: {which}."


def codes(document: Document) -> Iterator[str]:
    """By how many states of the sources verdicts were given, where that is not one."""
    known, unknown = len(document["codes"]), document["without_code"]
    if known > 1 or (known and unknown):
        count = f"at least {known + 1}" if unknown else f"{known}"
        yield f"UNLIKE verdicts: given by {count} states of luxloop's sources."
    if unknown:
        yield f"{unknown} records are of before such a state was put down."


def further(sets: int) -> str:
    """Sets that follow others."""
    return f"{sets} further sets, with the image that a verdict proposed, count in the row of that image alone."


def roots(of: Mapping[str, str | None]) -> Iterator[str]:
    """Which seals are bound together in each folder, and where nothing binds them."""
    for folder, root in of.items():
        missing = "none (not all sets are made, or an older luxloop made them): a set taken away would not be found"
        yield f"root of {folder}: {root or missing}"


def not_checked(sets: int) -> str:
    """Records without their data."""
    return f"data of {sets} sets are not there, only their records: not checked."


def kinds_left_out(document: Document) -> Iterator[str]:
    """Kinds that were not hidden in some truth, and why."""
    if document["too_weak"]:
        kinds = ", ".join(f"{name} {sigma:.1f}" for name, sigma in sorted(document["too_weak"].items()))
        yield f"not hidden in a truth where they do not show as strongly as was asked (sigma at their most): {kinds}"
    if document["no_amount"]:
        kinds = ", ".join(document["no_amount"])
        yield f"not hidden in a truth where no amount came near the asked strength: {kinds}"


def found(row: Document) -> tuple[str, str]:
    """A row's value and its interval; percent, but for the size of a set."""
    if row["value"] is None:
        return "-", "-"
    if row["unit"] != "share":
        return f"{row['value']:.2f}", f"{row['low']:.2f} to {row['high']:.2f} ({row['interval']})"
    return f"{100.0 * row['value']:.1f} %", f"{100.0 * row['low']:.1f} to {100.0 * row['high']:.1f} %"


def _row(row: Document) -> tuple[str, ...]:
    return (row["quantity"], row["target"], f"{row['hits']:g} of {row['of']}", *found(row), row["said"])


def _confusion(document: Document) -> Iterator[str]:
    if not document["rows"]:
        return
    yield "hidden -> said, by group:"
    for truth, counts in zip(document["rows"], document["counts"], strict=True):
        several = [(count, name) for count, name in zip(counts, document["columns"], strict=True) if count]
        yield f"  {truth}: " + ", ".join(f"{name} {count}" for count, name in sorted(several, reverse=True))


def _miss(one: Document, document: Document) -> tuple[str, ...]:
    beside = "-" if one["sigma_rival"] is None else f"{one['sigma_rival']:.1f}"
    said = one["verdict"] + (f": {', '.join(one['set'])}" if one["set"] else "")
    return (f"{document['names'][one['folder']]}/{one['id']}", one["truth"], f"{one['sigma']:.1f}", beside, said)
