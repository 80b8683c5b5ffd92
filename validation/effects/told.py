"""What the commands of effects say on a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from luxloop.effect import EffectParameter, EffectSpec
from validation.effects.known import Known
from validation.told import table

Document = Mapping[str, Any]


def listed(known: Known) -> Iterator[str]:
    """A row for each effect, and why files are refused."""
    rows = [(spec.name, spec.stage, _ranges(spec), spec.description) for spec in known.specs]
    yield from table(("effect", "stage", "parameters", "what it is"), rows)
    yield from (f"refused  {reason}" for reason in known.refused.values())


def _ranges(spec: EffectSpec) -> str:
    return "; ".join(f"{one.name} {one.allowed}" for one in spec.parameters)


def card(spec: EffectSpec, document: Document) -> Iterator[str]:
    """Everything about an effect, for people."""
    facts = {
        "effect": f"{spec.name}, {spec.stage}", "what": spec.description, "formula": spec.formula,
        "source": spec.reference, "scope": spec.scope, "conserves": ", ".join(spec.conserves) or "nothing said",
        "predicted": "by the twin" if spec.twin else "by Monte Carlo alone: the twin cannot represent it",
        "instead of": ", ".join(spec.excludes) or "-",
        "file": f"SHA-256 {spec.source_sha256}" if spec.source_sha256 else "of the catalogue",
    }  # fmt: skip
    yield from (f"{key:<11}{text}" for key, text in facts.items())
    for one in spec.parameters:
        yield f"{'parameter':<11}{one.name}: {one.description}; {one.allowed}{_off_of(one)}"
    values = ", ".join(f"{name} = {_short(value)}" for name, value in document["values"].items())
    if document["kind"] == "nothing":
        yield f"{'picture':<11}none: with {values} it changes neither the example module nor the example film"
        return
    if document["kind"] == "image":
        rms, most = document["rms_percent"], document["largest_percent"]
        yield f"{'does':<11}{rms:.2g} % rms, {most:.2g} % at most, of the mean"
    yield f"{'picture':<11}{document['picture']}, with {values}"
    yield f"\nInto a model file, with values of your own:\n{document['stanza']}"


def _off_of(one: EffectParameter) -> str:
    off = f"; off at {one.off}" if one.off is not None else "; a shape, it has no off"
    return off + (", counts by its square" if one.score_variable == "square" else "")


def _short(value: Any) -> str:
    return f"{len(value)} values, one per chip" if isinstance(value, list | tuple) else f"{value}"


def report(document: Document) -> Iterator[str]:
    """A line for each finding, what to paste."""
    signs = {True: "ok", False: "FAILED", None: "-"}
    for one in document["findings"]:
        yield f"{signs[one['ok']]:<7} {one['check']:<21} {one['said']}"
    if document["ok"]:
        yield f"\nInto a model file, with values of your own:\n{document['stanza']}"
    else:
        yield f"\n{document['effect']} is not to be used as it is."


def confusing(document: Document, page: Path | None) -> Iterator[str]:
    """Groups, then each effect with its nearest."""
    for one in document["maps"]:
        names, cosine = one["names"], one["cosines"]
        yield f"On {one['ground']}, calibration and nuisances taken out; groups: |cosine| > {one['alike']:g}"
        several = [group for group in one["groups"] if len(group) > 1]
        groups = {name: number + 1 for number, group in enumerate(several) for name in group}
        rows = []
        for i, name in enumerate(names):
            near = sorted(((cosine[i][j], names[j]) for j in range(len(names)) if j != i), reverse=True)[:3]
            text = ", ".join(f"{other} {value:.2f}" for value, other in near)
            rows.append((str(groups.get(name, "")), name, f"{one['sigma'][name]:.3g}", text))
        if rows:
            yield from table(("group", "effect", "sigma at 1/3 of its range", "most alike"), rows)
        if one["imitated"]:
            yield f"Wholly imitated by calibration: {', '.join(one['imitated'])}"
        yield from (f"not predicted: {name}: {why}" for name, why in one["failed"].items())
        yield ""
    if page is not None:
        yield f"drawn into {page}"
