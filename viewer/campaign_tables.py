"""The tables of a campaign's page: states, rewards, work, winners under other models, where all of it came from."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from typing import Any

from viewer import html
from viewer.campaign_figures import ENDS, EVENTS
from viewer.html import NOTHING, duration, in_words, lux, paragraph, percent, points

Document = Mapping[str, Any]

HEADS = ("D, µm", "W, µm", "S, µm", "T, µm", "pairs")
FIELDS = ("distance_um", "width_um", "spacing_um", "thickness_um", "dbr_pairs")
PAPER_WORK = (
    ("entire loop, as the paper reports it", "106,920", "297 h", "89.61 %"),
    ("designing agent, as the paper reports it", "16,000", "53.3 h", "90.32 %"),
)
"""Table 6 of the paper: no errors are stated there."""


def states(document: Document) -> Iterator[str]:
    """The start, the finalists and the best without DBR, as evaluated anew; then the best of the walk."""
    rows = []
    for name, row in (("start", document["start"]), ("without DBR", document["dbr"]["without"])):
        if row is not None:
            rows.append(_state(name if row["final"] else f"{name}, in the walk", row))
    rows[1:1] = [_state(f"finalist {i}", row) for i, row in enumerate(document["finalists"], 1)]
    if not rows:
        yield paragraph("No design was evaluated.")
        return
    heads = ("state", *HEADS, "f", "mean illuminance, lx", "chip / gap", "uniformity, %")
    caption = (
        "Standard errors; each final evaluation has a seed of its own. In the walk: what the search was told of the"
        " same design, by the one seed of all its steps. Chip / gap: illuminance above a chip's centre over that"
        " midway between four chips."
    )
    yield html.table((*heads, "in the walk, %"), rows, caption)
    if document["top"]:
        yield "<h3>Best of the walk</h3>"
        top = [_state(f"{i}", row)[:-1] for i, row in enumerate(document["top"], 1)]
        yield html.table(heads, top, "Standard errors of the walk.")


def rewards(document: Document) -> Iterator[str]:
    """Each run's reward and what came of it, as Table 5."""
    rows = []
    for run in document["runs"]:
        at, best = run["best_at"] or {}, run["best"]
        rows.append((
            run["run"],
            run["designer"] or NOTHING,
            f"{run['reward']['name']}: {run['reward']['formula']}",
            in_words(best["design"]) if best else NOTHING,
            f"{at['evaluations']:,}" if at else NOTHING,
            f"{at['episode'] + 1:,}" if at and at["episode"] is not None else NOTHING,
            percent(best["uniformity"] if best else None),
        ))  # fmt: skip
    heads = ("run", "designer", "reward, U in percent", "best state", "designs", "episode", "best uniformity")
    caption = (
        "As Table 5. Designs and episode: when the best of the walk was met; the paper counts iterations. Best"
        " uniformity: of the finalists, evaluated anew, where there are some. Infeasible designs have U = 0."
    )
    yield html.table(heads, rows, caption, words=4)


def work(document: Document) -> Iterator[str]:
    """Evaluations, time and result of each run beside the whole grid, as Table 6."""
    rows = []
    for run in document["runs"]:
        grid, times, counts = run["grid"], run["times"], run["counts"]
        best = percent(run["best"]["uniformity"] if run["best"] else None)
        name = f"{run['run']}: {run['designer'] or run['kind']}"
        rows.append(
            (name, f"{counts['evaluations']:,}", duration(times["walk_s"]), duration(times["walk_physics_s"]), best)
        )
        projected = duration(grid["projected_physics_s"])
        rows.append(
            (
                f"its whole grid, projected: {grid['designs']:,} designs",
                f"{grid['feasible']:,}",
                NOTHING,
                projected,
                NOTHING,
            )
        )
    rows += [(name, count, time, NOTHING, best) for name, count, time, best in PAPER_WORK]
    heads = ("", "designs evaluated", "wall time", "computing time of workers", "best uniformity")
    caption = (
        "As Table 6; the walk alone, while something was under way: finalists, pauses between starts, and a learner"
        " that thinks while nothing is computed, aside. Projected: the grid's feasible designs times the mean"
        " computing time of a design in this walk, at its fidelity and on its machine; nobody computed it. Workers"
        " run side by side, so computing time may exceed wall time."
    )
    yield html.table(heads, rows, caption)
    grid = document["grid"]
    if grid["share"]:
        yield paragraph(
            f"The walk evaluated {100.0 * grid['share']:.3g} % of the grid's {grid['feasible']:,} feasible designs."
        )


def losses(document: Document, names: Mapping[str, str]) -> str:
    """The ledger and the optical events in numbers."""
    rows = []
    for part, titles in (("ledger", ENDS | {"roulette": "made by roulette"}), ("optical_events", EVENTS)):
        for key, title in titles.items():
            of_it = [document["shown"][name][part].get(key) for name in names]
            if not all(of_it):
                continue
            rows.append((title, *(percent(one, 3) for one in of_it)))
    defect = max(abs(document["shown"][name]["ledger_defect"]) for name in names)
    caption = (
        f"Share of the emitted light, standard errors. All ends and the emitted light differ by {defect:.0e},"
        " counting what roulette made, whose mean is 0 (a negative number: taken away)."
    )
    return html.table(("", *names.values()), rows, caption)


def geometry(document: Document) -> str:
    """f of the best designs."""
    rows = [
        (f"finalist {i}", in_words(row["design"]), f"{row['f']:.2f}", percent(row["uniformity"]))
        for i, row in enumerate(document["finalists"], 1)
    ] or [
        (f"walk {i}", in_words(row["design"]), f"{row['f']:.2f}", percent(row["uniformity"]))
        for i, row in enumerate(document["top"], 1)
    ]
    return html.table(("", "design", "f = 4T/W", "uniformity"), rows, words=2)


def under(document: Document) -> Iterator[str]:
    """Each winner under each model, and the differences."""
    found = document["under"]
    if not found:
        yield paragraph("Not asked for. The winners are evaluated anew under other models by:")
        yield html.code(shlex.join([*document["report_command"], "--under", "A.toml", "--under", "B.toml"]))
        return
    rows = []
    for row in found["rows"]:
        if row["reason"]:
            rows.append((row["run"], in_words(row["design"]), row["model"], row["reason"], NOTHING, NOTHING, NOTHING))
            continue
        rows.append((
            row["run"], in_words(row["design"]), row["model"], percent(row["uniformity"]),
            lux(row["mean_illuminance_lx"]), percent(row["optical_efficiency"]), row["seed"],
        ))  # fmt: skip
    heads = ("winner of", "design", "model", "uniformity", "mean illuminance", "optical efficiency", "seed")
    caption = (
        "Each winner evaluated anew under each model, with a seed of its own that had no part in choosing it;"
        " standard errors. Models: "
        + "; ".join(f"{one['name']} {one['sha256'][:12]}" for one in found["models"])
        + "."
    )
    yield html.table(heads, rows, caption, words=3)
    if found["differences"]:
        changes = [
            (
                f"{change['of']}: {change['to']} minus {change['from']}",
                points(change["uniformity"]),
                "yes" if change["significant"] else "no",
            )
            for change in found["differences"]
        ]
        yield html.table(("difference", "uniformity, points", "above twice its error"), changes)
    yield html.code(shlex.join(document["report_command"]))


def provenance(document: Document) -> Iterator[str]:
    """What made this page can be checked and made again."""
    chain, environment = document["chain"], document["environment"]
    plan = document["plan"]
    rows = [
        ("run", f"{document['run']} ({document['kind']}), {document['state']}"),
        ("ended", document["ended"] or NOTHING),
        ("time", f"{document['times']['first_utc']} to {document['times']['last_utc']}"),
        ("designer", document["designer"] or NOTHING),
        ("seed", document["seed"] or NOTHING),
        ("seed of the walk's evaluations", plan["walk"]["seed"]),
        ("seeds of the finalists", ", ".join(row["seed"] or NOTHING for row in document["finalists"]) or NOTHING),
        (
            "model",
            f"{document['model']['name'] or NOTHING}, effects: {', '.join(document['model']['effects']) or 'none'}",
        ),
        ("model, SHA-256", document["model"]["sha256"]),
        ("journal", f"{chain['records']:,} records"),
        ("journal, root of the chain", chain["root"]),
        ("luxloop", document["version"]),
        *((name, value) for name, value in sorted(environment.items()) if name not in ("pid", "host")),
        *((f"attached: {name}", digest) for name, digest in document["attachments"].items()),
    ]
    yield html.facts(rows)
    if document["command_line"]:
        yield paragraph("The run was made by:")
        yield html.code(document["command_line"])
    if document["later_command_lines"]:
        yield paragraph("It was interrupted, and gone on with by:")
        yield html.code("\n".join(document["later_command_lines"]))
    yield paragraph("This page, and the check that the journal is what was written:")
    verify = f"luxloop audit verify {document['run']} --root {chain['root']} --records {chain['records']}"
    yield html.code(f"{shlex.join(document['report_command'])}\n{verify}")
    for title, value in (("Fidelity of walk and finalists", {name: plan[name] for name in ("walk", "final")}),
                         ("Bounds", plan["bounds"]), ("Settings", document["settings"])):  # fmt: skip
        if value:
            text = json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False)
            yield f"<details><summary>{title}</summary>{html.code(text)}</details>"


def _state(name: str, row: Document) -> tuple[str, ...]:
    design = row["design"]
    hot = row["hot_spot_ratio"]
    return (
        name,
        *(f"{design[field]:g}" for field in FIELDS),
        f"{row['f']:.2f}",
        lux(row["mean_illuminance_lx"]).removesuffix(" lx"),
        f"{hot['value']:.3f} ± {hot['standard_error']:.3f}" if hot else NOTHING,
        percent(row["uniformity"]).removesuffix(" %"),
        percent(row["in_walk"]).removesuffix(" %"),
    )
