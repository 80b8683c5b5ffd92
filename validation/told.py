"""What the commands of this room say on a terminal: tables of plain text, short enough for one look."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from luxloop.units import unit_of

Document = Mapping[str, Any]

REGIONS = 8
LINES = re.compile(r"\b(rows|columns) \d")
FAR_PULL = 3.0  # standard deviations: of two priors an image, one of six images is so far in 3 % of data sets
MEND = {"gain_error": "is its exposure_ms right?", "rotation_deg": "does the sample lie straight under the camera?"}


def comparison(document: Document) -> Iterator[str]:
    """A row per shot, the sentence, what is not to be trusted."""
    images = [shot for shot in document["shots"] if shot["kind"] == "image"]
    others = [shot for shot in document["shots"] if shot["kind"] != "image"]
    if images:
        heads = ("image", "rms error", "noise", "MSE (Eq. 1)", "chi2/pixel", "p", "worst region")
        yield from table(heads, [_image(shot) for shot in images])
    if others:
        heads = ("curve", "rms error", "noise", "values", "chi2/value", "p", "worst region")
        yield from table(heads, [_curve(shot) for shot in others])
    if document["parameters"]:
        yield ""
        yield from parameters(document["parameters"])
    yield ""
    yield document["sentence"] + "."
    if not document["trusted"]:
        yield f"Not to be trusted: {document['reason']}."
    yield from warnings(document)
    yield from pulled(images)
    if _by_twin(document):
        yield "By the twin alone, whose own error may show as structure: leave --twin out for the verdict."


def warnings(document: Document) -> Iterator[str]:
    """Faults of the data, and errors stated too large; documents of earlier versions have none."""
    yield from (f"Warning: {warning}." for warning in document.get("warnings", ()))


def _by_twin(document: Document) -> bool:
    """Whether the twin spoke where Monte Carlo could have: films have no other solver."""
    traced = any(shot["kind"] != "spectrum" for shot in document["shots"])
    return traced and document["solver"]["method"] == "twin"


def pulled(images: Sequence[Document]) -> Iterator[str]:
    """Gains and places of images that are further from what is expected of them than chance explains."""
    for shot in images:
        for one in shot.get("nuisances", []):
            if one["pull"] is not None and abs(one["pull"]) > FAR_PULL:
                value = f"{one['value']:.3g} +- {one['error'] or 0.0:.1g}"
                far = f"{one['pull']:+.1f} sd of what is expected"
                yield f"{shot['id']}: {one['name']} is {value}, {far}; {MEND[one['name']]}"


def regions(document: Document) -> Iterator[str]:
    """Where the model fails, the least likely first."""
    rows = [
        (f"{region['z']:+.1f}", region["family"], region["region"], region["shot"])
        for region in document["regions"][:REGIONS]
    ]
    yield from table(("sigma", "seen in", "where", "shot"), rows)


def binned(shots: Sequence[Document], said: Sequence[str]) -> Iterator[str]:
    """What rows and columns are, where something is said of them and images were binned for it."""
    if not any(LINES.search(line) for line in said):
        return
    sides: dict[int, list[str]] = {}
    for shot in shots:
        sides.setdefault(shot.get("binning") or 1, []).append(shot["id"])
    for side in sorted(sides.keys() - {1}):
        of = "" if len(sides) == 1 else f" of {', '.join(sides[side])}"
        yield f"Rows and columns{of} are of the images as compared: each is {side} of the camera's."


def parameters(rows: Sequence[Document]) -> Iterator[str]:
    """Fitted values with their standard errors."""
    yield from table(("fitted", "value", "limits"), [_parameter(row) for row in rows])


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Columns of text, as wide as they must be."""
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    for row in (heads, *rows):
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def _image(shot: Document) -> tuple[str, ...]:
    return (
        shot["id"],
        f"{shot['rms_error_percent']:.2f} %",
        f"{shot['noise_percent']:.2f} %",
        f"{shot['mse']:.2e}",
        f"{shot['chi2_per_pixel']:.2f}",
        shot["p_text"],
        f"{shot['worst_region']} ({shot['worst_z']:+.1f} sigma)",
    )


def _curve(shot: Document) -> tuple[str, ...]:
    unit = " deg" if shot["unit"] == "deg" else ""
    return (
        shot["id"],
        f"{shot['rms_error']:.3g}{unit}",
        f"{shot['noise']:.3g}{unit}",
        str(shot["pixels"]),
        f"{shot['chi2_per_pixel']:.2f}",
        shot["p_text"],
        f"{shot['worst_region']} ({shot['worst_z']:+.1f} sigma)",
    )


def _parameter(row: Document) -> tuple[str, str, str]:
    unit = unit_of(row["path"])
    error = "not seen by these data" if row["error"] is None else f"+- {row['error']:.2g} {unit}"
    value = f"{row['value']:.5g} {error}".rstrip()
    held = ", held at its limit" if row["at_limit"] else ""
    return row["path"], value, f"{row['lower']:g} to {row['upper']:g}{held}"


def calibration(document: Document) -> Iterator[str]:
    """The paper's table of least errors, the fitted values beside it, the error of every shot before and after."""
    for stage in document["stages"]:
        yield f"{stage['name']}: {len(stage['curves'])} kinds of scatter, MSE (Eq. 1) by reflectance"
        heads = ("", *(f"{100.0 * x:g} %" for x in stage["curves"][0]["x"]))
        least = stage["best"]["mse"]
        rows = [
            (curve["label"], *(f"{mse:.2e}{' *' if mse == least else ''}" for mse in curve["mse"]))
            for curve in stage["curves"]
        ]
        yield from table(heads, rows)
        yield f"least (Eq. 2): {stage['best']['label']}, {100.0 * stage['best']['x']:g} %"
        yield ""
    fit = document["fit"]
    heads = ("fitted", "value", "95 % interval", "was")
    yield from table(heads, [_fitted(row) for row in fit["parameters"]])
    yield from fit["correlated"]
    if fit.get("unseen"):
        yield f"not seen by these data: {', '.join(fit['unseen'])}"
    if fit.get("left_out"):
        yield f"not fitted, for the chosen surface has none within its limits: {', '.join(fit['left_out'])}"
    yield ""
    before, after = document["errors"]
    heads = ("shot", "rms error before", "noise", "after", "noise")
    names = ("rms_error_percent", "noise_percent")
    units = {shot["id"]: "deg" if shot.get("unit") == "deg" else "%" for shot in document["shots"]}
    rows = [
        (shot, *(f"{one[name][shot]:.2f} {units[shot]}" for one in (before, after) for name in names))
        for shot in after["rms_error_percent"]
    ]
    yield from table(heads, rows)
    yield ""
    left = f"chi2/pixel {fit['chi2_per_pixel']:.3f}, p of structure {document['structure']['p_text']}"
    yield f"{document['sentence']}; {left}."
    if not document["trusted"]:
        yield f"Not to be trusted: {document['reason']}."
    yield from warnings(document)
    if _by_twin(document):
        yield "By the twin alone, whose own error moves values by more than their errors: leave --twin out to decide."
    if document.get("version") is None:
        yield f"{document['model']['file']} is as it was."
    else:
        file = document["model"]["file"]
        yield f"{file} is version {document['version']}; luxloop model undo {file} takes it back."


def _fitted(row: Document) -> tuple[str, ...]:
    unit = row["unit"]
    held = ", at its limit" if row["at_limit"] else ""
    return (
        row["path"],
        f"{row['value']:.5g} +- {row['error']:.2g} {unit}".rstrip(),
        f"{row['lower95']:.5g} to {row['upper95']:.5g}{held}",
        f"{row['start']:g}" if isinstance(row["start"], float) else "",
    )
