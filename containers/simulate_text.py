"""What a person reads of `luxloop simulate`: the design, its numbers with their errors, the ledger, the time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

METRICS = {
    "uniformity": "uniformity (Eq. 8)",
    "uniformity_2d": "uniformity, whole area",
    "percentile_ratio": "1st over 99th percentile",
    "uniformity_5": "uniformity of 5 points",
    "uniformity_9": "uniformity of 9 points",
    "uniformity_13": "uniformity of 13 points",
    "uniformity_25": "uniformity of 25 points",
    "coefficient_of_variation": "coefficient of variation",
    "optical_efficiency": "optical efficiency",
}
"""Those in percent, in their order."""
ENDS = {
    "receiver": "taken by the receiver",
    "chip": "absorbed in chips",
    "substrate": "absorbed in the substrate",
    "dbr": "absorbed in the DBR",
    "edge": "lost at the edge",
    "trapped": "trapped in chips",
    "roulette": "made by roulette (net)",
}
EVENTS = {
    "through_dbr": "through the top",
    "from_sides": "directly from the sides",
    "after_top_reflection": "after reflection at the top",
    "after_receiver": "after the receiver",
}
WIDTH = 28
TRUSTED_BIAS = 0.05
"""Above that the correction is itself uncertain."""


def as_text(document: Mapping[str, Any]) -> str:
    """All of a result document, some thirty lines."""
    shares = _shares(document) if "ledger" in document else ()
    return "\n".join([*_head(document), *_metrics(document), *shares, *_end(document)])


def _head(document: Mapping[str, Any]) -> Iterator[str]:
    names = ("distance_um", "width_um", "spacing_um", "thickness_um")
    lengths = ", ".join(f"{letter} {document['design'][name]:g}" for letter, name in zip("DWST", names, strict=True))
    array, module = document["array"], "an endless array"
    if array is not None:
        wall = array["wall_reflectance"]
        edge = "open edge" if wall is None else f"walls of reflectance {wall:g}"
        module = f"{array['rows']} x {array['columns']} chips, {edge}"
    yield f"{lengths} um, {document['design']['dbr_pairs']:g} pairs; {module}; model {document['model']['name']!r}"
    yield document["region"]
    for warning in document.get("warnings", ()):
        yield f"WARNING: {warning}"


def _metrics(document: Mapping[str, Any]) -> Iterator[str]:
    metrics = document["metrics"]
    for name, title in METRICS.items():
        if name in metrics:
            one = metrics[name]
            notes = [f"bias taken off {100 * one['bias']:+.2f}"] * (abs(one["bias"]) >= 5e-5)
            notes += [f"truncation up to {100 * one['truncation']:.2f}"] * (one["truncation"] >= 5e-5)
            note = f"   ({', '.join(notes)})" if notes else ""
            digits = 2 if one["standard_error"] >= 5e-5 else 3
            value, error = 100 * one["value"], 100 * one["standard_error"]
            yield f"{title:<{WIDTH}}{value:{6 + digits}.{digits}f} +- {error:.{digits}f} %{note}"
    lux, hot = metrics["mean_illuminance_lx"], metrics["hot_spot_ratio"]
    yield f"{'mean illuminance':<{WIDTH}}{lux['value']:8.0f} +- {lux['standard_error']:.0f} lx"
    yield f"{'chip centre over gap':<{WIDTH}}{hot['value']:8.3f} +- {hot['standard_error']:.3f}"
    if abs(metrics["uniformity"]["bias"]) > TRUSTED_BIAS:
        yield f"WARNING: too few histories: noise moved the uniformity by more than {100 * TRUSTED_BIAS:g} points"


def _shares(document: Mapping[str, Any]) -> Iterator[str]:
    yield f"where the light ended, % of what was emitted (ends and emitted differ by {document['ledger_defect']:.0e})"
    for name, title in ENDS.items():
        yield _share(title, document["ledger"][name])
    yield "arrivals at the receiver, each counted, % of what was emitted"
    for name, title in EVENTS.items():
        yield _share(title, document["optical_events"][name])


def _share(title: str, one: Mapping[str, float]) -> str:
    return f"    {title:<{WIDTH}}{100 * one['value']:8.3f} +- {100 * one['standard_error']:.3f}"


def _end(document: Mapping[str, Any]) -> Iterator[str]:
    target = document["target_error_points"]
    asked = f" for {target:g} points" if target is not None else ""
    how = "stored chip exits" if document["stored_exits"] else "full histories"
    how = "exits, by the twin" if document["method"] == "twin" else how
    seeds = f"seed {document['seed']}" + (f", exit seed {document['exit_seed']}" if "exit_seed" in document else "")
    yield f"{document['histories']:,} histories{asked} in {document['compute_s']:.2f} s ({how}, {seeds})"
    for name, file in document.get("files", {}).items():
        yield f"{name}: {file}"
