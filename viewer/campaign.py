"""The page of a campaign: learning curve, best design with and without its DBR, losses, tables, where it came from.

    document and arrays of `luxloop campaign report` ──▶ one HTML file that loads nothing and runs nothing

Every figure's caption says what its error is, and which record or command it comes from. The same document gives the
same bytes.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from viewer import campaign_figures as figures
from viewer import campaign_tables as tables
from viewer import html
from viewer.html import in_words, lux, paragraph, percent, points

Document = Mapping[str, Any]
Arrays = Mapping[str, NDArray[Any]]

SECTIONS = {
    "learning": "Learning",
    "best": "Best design",
    "dbr": "With and without DBR",
    "losses": "Where the light goes",
    "pareto": "Uniformity and light",
    "geometry": "Geometry factor",
    "states": "States",
    "rewards": "Rewards",
    "work": "Work",
    "under": "Under other models",
    "provenance": "Provenance",
}


def draw(document: Document, arrays: Arrays, path: Path) -> None:
    """Write the page of a report's document and its arrays."""
    html.write(path, page_of(document, arrays))


def page_of(document: Document, arrays: Arrays) -> str:
    """The page of a report's document and its arrays, as HTML."""
    parts = {
        "learning": _learning(document, arrays),
        "best": _best(document, arrays),
        "dbr": _dbr(document, arrays),
        "losses": _losses(document),
        "pareto": _pareto(document, arrays),
        "geometry": _geometry(document, arrays),
        "states": tables.states(document),
        "rewards": tables.rewards(document),
        "work": tables.work(document),
        "under": tables.under(document),
        "provenance": tables.provenance(document),
    }
    body = [*_head(document), html.contents(SECTIONS)]
    body += [html.section(name, title, *parts[name]) for name, title in SECTIONS.items()]
    return html.page(f"{document['run']}: micro-LED backlight campaign", body)


def _head(document: Document) -> Iterator[str]:
    """What the run is, what came of it, and what one must know before believing it."""
    yield html.heading(document["run"])
    designer = f" by {document['designer']}" if document["designer"] else ""
    when = f", {document['times']['first_utc']}" if document["times"]["first_utc"] else ""
    yield paragraph(
        f"{document['kind'].capitalize()}{designer}, model {document['model']['name'] or 'unnamed'}{when}.", "soft"
    )
    best, start, gain = document["best"], document["start"], document["gain"]
    rows = []
    if best:
        rows.append((percent(best["uniformity"]), f"uniformity of the best design: {in_words(best['design'])}"))
        rows.append((lux(best["mean_illuminance_lx"]), "its mean illuminance at the receiver"))
    if start:
        rows.append((percent(start["uniformity"]), f"the start: {in_words(start['design'])}"))
    if gain:
        rows.append((f"{points(gain['uniformity'])} points", "gained over the start, errors combined"))
    if rows:
        yield html.highlights(rows)
    for warning in _warnings(document):
        yield paragraph(warning, "note")


def _warnings(document: Document) -> Iterator[str]:
    state, counts = document["state"], document["counts"]
    if state == "being written":
        yield "This run goes on: the page shows what was on record when it was made."
    elif state == "not finished":
        yield "This run was not ended: its process was stopped. The page shows all that was on record by then."
    elif document["ended"]:
        yield f"The run ended: {document['ended']}."
    if document["best"] is None:
        yield "No design was evaluated."
    elif not document["best_is_final"]:
        yield (
            "No finalist was evaluated anew: the best design is the best of the walk, chosen by the same noisy"
            " numbers that are shown, so its uniformity is more likely too high than too low."
        )
    else:
        yield (
            f"All {len(document['finalists'])} finalists were evaluated anew with seeds of their own, and the best of"
            " them once more, which is the number shown: the best of several noisy numbers is flattered, this is not."
            if document["best_is_confirmed"]
            else f"All {len(document['finalists'])} finalists were evaluated anew with seeds of their own. The best"
            " one is still chosen by these numbers: where several lie within their errors, read it as one of them."
        )
    if counts["failed"]:
        failed = "; ".join(f"{one['design']}: {one['failure']}" for one in document["failures"][:3])
        yield f"{counts['failed']} evaluations failed and are in no figure: {failed}"


def _learning(document: Document, arrays: Arrays) -> Iterator[str]:
    counts = document["counts"]
    if not counts["steps"]:
        yield paragraph("No step is on record.")
        return
    at = document["best_at"]
    told = f"{counts['steps']:,} steps, {counts['evaluations']:,} different designs"
    parts = {
        "infeasible": "cannot be built",
        "out_of_bounds": "led out of the bounds",
        "known_before": "known before",
    }
    told += "".join(f", {counts[name]:,} {title}" for name, title in parts.items() if counts[name])
    caption = (
        f"Uniformity (Eq. 8) of every step of the walk, in the order in which the designer was told; {told}. Grey:"
        " one standard error either side of a step; blue: the best so far with its own."
    )
    if counts["episodes"]:
        caption += (
            f" Below, as Figs. 6a-c count their iterations: {counts['episodes']} episodes, mean with the mean error"
            " of its evaluations (they share their random numbers, so it does not average out), and best of each."
        )
    caption += (
        " The best of many noisy steps is biased upwards, which is why the finalists are evaluated anew. Records"
        " /step and /agent."
    )
    yield html.figure(figures.learning_curve(arrays), "learning curve", caption, document["command_line"])
    if at:
        episode = "" if at["episode"] is None else f", in episode {at['episode'] + 1}"
        yield paragraph(
            f"The best of the walk, {percent(at['uniformity'])}, was met at step {at['step']:,}, after"
            f" {at['evaluations']:,} different designs{episode}."
        )
    if len(document["runs"]) > 1:
        caption = "Best uniformity so far of each run against the designs it evaluated; bands: one standard error."
        command = shlex.join(document["report_command"])
        yield html.figure(figures.runs_compared(document, arrays), "runs compared", caption, command)


def _best(document: Document, arrays: Arrays) -> Iterator[str]:
    best = document["best"]
    if best is None:
        yield paragraph("No design was evaluated.")
        return
    if "best_map_lx" not in arrays:
        yield paragraph(f"{in_words(best['design'])}: {percent(best['uniformity'])}. Its map is not on record.")
        return
    shown = document["shown"]["best"]
    window = shown["cut"]["window_um"]
    caption = (
        f"{in_words(best['design'])}, {percent(best['uniformity'])}, {lux(best['mean_illuminance_lx'])}, as Figs."
        " 6d-f. Left: one cell of the endless array, colours from its smallest to its largest value. Right: the line"
        f" through the chips over two pitches; Eq. 8 takes its middle half, {window[0]:g} to {window[1]:g} µm."
        f" {_bias(shown)} {_band(shown)} {_record(shown)}"
    )
    yield html.figure(
        figures.best_design(document, arrays), "map and cut of the best design", caption, shown["command"]
    )
    for warning in shown["warnings"] or ():
        yield paragraph(f"Warning of the ray worker: {warning}", "note")


def _dbr(document: Document, arrays: Arrays) -> Iterator[str]:
    dbr = document["dbr"]
    if dbr["without"] is None:
        yield paragraph("The best design without its DBR was not evaluated.")
        return
    light, share = dbr["illuminance_ratio"], dbr["uniformity_ratio"]
    said = f"The DBR changes the uniformity by {points(dbr['uniformity'])} points"
    if share:
        said += f", by {_change(share)} of what it is without"
    if light:
        said += f", and the mean illuminance by {_change(light)}"
    yield paragraph(f"{said}; errors combined, the two have seeds of their own.")
    if "bare_map_lx" in arrays and "with_map_lx" in arrays:
        rows = {"without": dbr["without"], "with": dbr["with"]}
        values = "; ".join(
            f"{name} {percent(row['uniformity'])}, {lux(row['mean_illuminance_lx'])}" for name, row in rows.items()
        )
        shown = document["shown"]
        records = f"{_record(shown['bare'])} {_record(shown['with'])}"
        caption = (
            f"{in_words(dbr['with']['design'])}, as Fig. 8: {values}. {_band(document['shown']['with'])} {records}"
        )
        command = f"{shown['bare']['command']} ; {shown['with']['command']}"
        yield html.figure(figures.dbr_compared(document, arrays), "with and without DBR", caption, command)


def _losses(document: Document) -> Iterator[str]:
    shown = document["shown"]
    if not shown.get("best", {}).get("ledger"):
        yield paragraph("No ledger is on record: the twin follows only part of the light, Monte Carlo all of it.")
        return
    pair = {"with": "with DBR", "bare": "without DBR"}
    both = all(shown.get(name, {}).get("ledger") for name in pair) and document["dbr"]["with"] == document["best"]
    names = pair if both else {"best": "best design"}
    caption = (
        "Where the light of the best design ends, and how often it arrives at the receiver by each of the paper's"
        " optical events (Fig. 9): a share of what was emitted; bars: one standard error. Light that the receiver"
        f" sends back and that comes again is counted again. {_record(shown[next(iter(names))])}"
    )
    yield html.figure(figures.losses(document, names), "ledger and optical events", caption, shown["best"]["command"])
    yield tables.losses(document, names)


def _pareto(document: Document, arrays: Arrays) -> Iterator[str]:
    if not len(arrays["pareto_lx"]):
        yield paragraph("No design was evaluated.")
        return
    caption = (
        f"All {len(arrays['pareto_lx']):,} designs of the walk, coloured by their pairs, and the front: designs that"
        " no other one beats in both. Median standard error in the walk"
        f" {100.0 * _median(arrays['pareto_error']):.2f} points and {_median(arrays['pareto_lx_error']):,.0f} lx, so"
        " a design near the front may belong to it. Finalists with their own errors. Records /step."
    )
    yield html.figure(figures.pareto(document, arrays), "uniformity against illuminance", caption)


def _geometry(document: Document, arrays: Arrays) -> Iterator[str]:
    if not len(arrays["pareto_f"]):
        yield paragraph("No design was evaluated.")
        return
    caption = (
        "Uniformity against f = 4T/W, the side faces over the top face (Eq. 9), of all designs of the walk (median"
        f" standard error {100.0 * _median(arrays['pareto_error']):.2f} points); finalists with their errors."
        " f is exact. Records /step."
    )
    yield html.figure(figures.geometry(document, arrays), "uniformity against geometry factor", caption)
    yield tables.geometry(document)


def _band(shown: Document) -> str:
    if shown.get("band") == "recorded":
        return "The line is the map's own, exact to its rounding. Band: the standard error of each point."
    return (
        "The line is the map's own, exact to its rounding. Band: the standard error of a point, estimated from that"
        " of the uniformity as if smallest and largest value shared it equally (U error / (√2 U))."
    )


def _bias(shown: Document) -> str:
    bias = shown["metrics"]["uniformity"]["bias"]
    return (
        f"Noise makes the smallest value smaller and the largest larger: {100.0 * bias:+.2f} points, taken off the"
        " uniformity, not off the line."
    )


def _record(shown: Document) -> str:
    return f"Records /map/sim and /reply/ray {shown['sequence']}, task {(shown['task_id'] or '')[:12]}."


def _change(ratio: Mapping[str, float]) -> str:
    return f"{100.0 * (ratio['value'] - 1.0):+.1f} ± {100.0 * ratio['standard_error']:.1f} %"


def _median(values: NDArray[Any]) -> float:
    return float(sorted(values)[len(values) // 2])
