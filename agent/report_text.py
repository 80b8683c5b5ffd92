"""What a person reads of `luxloop campaign report` on the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from luxloop.design import Design


def lines_of(document: Mapping[str, Any]) -> Iterator[str]:
    """A run in a few lines, and its winner under each model."""
    counts = document["counts"]
    ended = f": {document['ended']}" if document["ended"] else ""
    yield f"run          {document['run']} ({document['state']}{ended})"
    yield f"evaluated    {counts['evaluations']} designs in {counts['steps']} steps, {counts['failed']} failed"
    for name, title in (("best", "best"), ("start", "start")):
        row = document[name]
        if row is not None:
            note = "" if row["final"] else ", as the walk saw it"
            yield f"{title:<12} {_uniformity(row)}  {Design(**row['design'])}{note}"
    if document["gain"]:
        yield f"gained       {_points(document['gain']['uniformity'])} over the start"
    if document["under"]:
        yield from _under(document["under"])


def _under(under: Mapping[str, Any]) -> Iterator[str]:
    for row in under["rows"]:
        said = row["reason"] or _uniformity(row)
        yield f"under        {row['model']}: {said}  {Design(**row['design'])} of {row['run']}"
    for change in under["differences"]:
        sure = "" if change["significant"] else ", within its error"
        yield f"             {change['of']}: {change['to']} - {change['from']} {_points(change['uniformity'])}{sure}"


def _uniformity(row: Mapping[str, Any]) -> str:
    one = row["uniformity"]
    return f"{100.0 * one['value']:.2f} +- {100.0 * one['standard_error']:.2f} %"


def _points(one: Mapping[str, float]) -> str:
    return f"{100.0 * one['value']:+.2f} +- {100.0 * one['standard_error']:.2f} points"
