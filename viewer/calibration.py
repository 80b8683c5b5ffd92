"""The page of a calibration: the paper's virtual-realistic experiment, and beside it the fit with its errors.

    document and arrays of `luxloop calibrate` ──▶ one HTML file that loads nothing and runs nothing

Every figure's caption says what its error is and which command made it. The same document gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from viewer import calibration_figures as figures
from viewer import html
from viewer.comparison_tables import number, provenance, unit, warnings
from viewer.html import NOTHING, paragraph
from viewer.look import save

Document = Mapping[str, Any]
Arrays = Mapping[str, NDArray[Any]]

PAPER = {
    "environment.substrate.reflectance": ("substrate", "High-reflectivity white bottom surface", "Gaussian 5°, 97 %"),
    "environment.receiver.reflectance": ("receiver", "Receiver reflectivity", "Lambertian, 35 %"),
}
"""Rows 2 and 3 of the paper's Table 4: its name in a round, the paper's words, the paper's value."""
STRONG = 0.95
"""A correlation above this leaves two parameters that the data hardly tell apart."""


def draw(document: Document, arrays: Arrays, path: Path) -> None:
    """Write the page (.html) of a calibration, or the one picture that says most (.png, .svg, .pdf)."""
    if path.suffix.lower() in (".html", ".htm"):
        html.write(path, page_of(document, arrays))
    elif document["stages"]:
        save(figures.all_stages(document), path)
    else:
        save(figures.error_figure(_errors_by_model(document), _units(document), document["sentence"]), path)


def page_of(document: Document, arrays: Arrays) -> str:  # noqa: ARG001  # every view takes the arrays of its document
    """The page of a calibration, as HTML."""
    parts = {
        "stages": ("Error against reflectance", list(_stages(document))),
        "best": ("Best parameters", list(_best(document))),
        "fit": ("Continuous fit", list(_fit(document))),
        "correlation": ("Correlation", list(_correlation(document))),
        "errors": ("Before and after", list(_errors(document))),
        "provenance": ("Provenance", list(provenance(document, "This calibration was made by:"))),
    }
    present = {name: (title, body) for name, (title, body) in parts.items() if body}
    body = [*_head(document), html.contents({name: title for name, (title, _) in present.items()})]
    body += [html.section(name, title, *inside) for name, (title, inside) in present.items()]
    return html.page(f"Calibration of {document['model']['name']} with {document['dataset']['name']}", body)


def _head(document: Document) -> Iterator[str]:
    """What was found, and whether to believe it."""
    yield html.heading(f"Calibration of {document['model']['name']} with {document['dataset']['name']}")
    yield paragraph(f"{document['sentence'].rstrip('.')}.", "lead")
    rows = [
        (f"{stage['best']['label']}, {100.0 * stage['best']['x']:g} %", f"smallest MSE, {stage['name']}")
        for stage in document["stages"]
    ]
    fit = document.get("fit")
    if fit:
        rows.append((number(fit["chi2_per_pixel"], 4), "χ² per pixel of the continuous fit; noise alone gives 1"))
    yield html.highlights(rows)
    if not document["trusted"]:
        yield paragraph(f"The fit itself is not trustworthy: {document['reason']}. Mend this first.", "note")
    yield from warnings(document)


def _stages(document: Document) -> Iterator[str]:
    """The curves of Fig. 5, and the same with a noise model."""
    for stage in document["stages"]:
        told = [name for name in figures.TITLES if any(name in curve for curve in stage["curves"])]
        pictures = {f"{stage['name']}, {figures.TITLES[name]}": figures.stage_picture(stage, name) for name in told}
        caption = (
            "As Fig. 5: mean-square error (Eq. 1) after gain and offset were fitted to each image, scaled to the"
            f" measured maximum. Ring: the smallest (Eq. 2), {stage['best']['label']} with"
            f" {100.0 * stage['best']['x']:g} %, MSE {number(stage['best']['mse'], 4)}. The MSE has no error of its"
            " own; in χ² per pixel noise alone gives 1."
        )
        yield html.row(pictures, "two", caption, document["command"])
    rounds = document.get("rounds") or ()
    if rounds:
        rows = [(f"{one['round']}", one["substrate"], one["receiver"], number(one["mse"], 4)) for one in rounds]
        caption = "Each stage takes what the other found; repeated until nothing changes."
        yield html.table(("round", "substrate", "receiver", "MSE"), rows, caption, words=3)


def _best(document: Document) -> Iterator[str]:
    """The parameters found, as the paper's Table 4 lists its own."""
    fitted = {one["path"]: one for one in (document.get("fit") or {}).get("parameters", ())}
    last = (document.get("rounds") or [{}])[-1]
    rows = []
    for stage in document["stages"]:
        path = stage["parameter"]
        key, words, paper = PAPER.get(path, ("", figures.short(path), NOTHING))
        found = last.get(key) or f"{stage['best']['label']}, {100.0 * stage['best']['x']:g} %"
        rows.append((words, found, _with_error(fitted.get(path)), paper))
    if rows:
        caption = (
            "As the paper's Table 4. Smallest MSE: the arg min on the grid (Eq. 2), which has no error. Continuous"
            " fit: whitened least squares with the noise of the camera, ± 1 standard error. The paper states none."
        )
        yield html.table(("parameter", "smallest MSE", "continuous fit", "the paper"), rows, caption, words=4)


def _fit(document: Document) -> Iterator[str]:
    """Every free parameter with its interval, its prior and its profile."""
    fit = document.get("fit")
    if not fit:
        return
    rows = []
    for one in fit["parameters"]:
        low, high = number(one["lower95"], 5), number(one["upper95"], 5)
        prior = f"{number(one['prior_mean'], 4)} ± {number(one['prior_sd'], 2)}" if one.get("prior_sd") else "none"
        rows.append((figures.short(one["path"]), one["unit"] or "1", number(one["start"], 5), number(one["value"], 5),
                     number(one["error"], 2), f"{low} to {high}", prior, "at its limit" if one["at_limit"] else "")
                    )  # fmt: skip
    caption = (
        "Error: one standard error. A parameter at its limit makes the fit untrustworthy. χ² per pixel"
        f" {number(fit['chi2_per_pixel'], 4)}, {fit['iterations']} iterations, convergence gap"
        f" {number(fit['gap'], 2)}."
    )
    heads = ("parameter", "unit", "start", "value", "error", "95 % interval", "prior", "")
    yield html.table(heads, rows, caption, words=2, ending=1)
    yield from _fit_pictures(document, fit)


def _fit_pictures(document: Document, fit: Document) -> Iterator[str]:
    if any(one.get("prior_sd") for one in fit["parameters"]):
        caption = (
            "How far the data moved each parameter from its prior. Shaded: the prior's standard deviation; bars: the"
            " 95 % interval. A bar as wide as the shade was told by the prior, not by the data."
        )
        pictures = {"parameters against their priors": figures.pull_picture(fit["parameters"])}
        yield html.row(pictures, "two", caption, document["command"])
    profiles = fit.get("profiles") or ()
    if profiles:
        known = {one["path"]: one for one in fit["parameters"]}
        pictures = {
            f"profile of {figures.short(one['path'])}": figures.profile_picture(one, known.get(one["path"]))
            for one in profiles
        }
        caption = (
            "χ² against each parameter, all others refitted. Where it lies below the dotted line (3.84) is the 95 %"
            " interval; shaded: the interval of the table, line: the value. A parabola: the error says it all; a"
            " lopsided curve: it does not."
        )
        yield html.row(pictures, "three", caption, document["command"])


def _correlation(document: Document) -> Iterator[str]:
    """The correlation matrix as numbers, and a warning in words."""
    fit = document.get("fit")
    if not fit or not fit.get("correlation"):
        return
    names = [figures.short(one["path"]) for one in fit["parameters"]]
    matrix = fit["correlation"]
    strong = [(i, j) for i in range(len(names)) for j in range(i) if abs(matrix[i][j]) > STRONG]
    for i, j in strong:
        yield paragraph(
            f"{names[j]} and {names[i]} are correlated by {matrix[i][j]:+.3f}: the data hardly tell them apart, so"
            " neither value stands alone. An image at another distance or with other pairs separates them.",
            "note",
        )
    rows = [
        (f"{i + 1}  {name}", *(f"{value:+.2f}" if j <= i else "" for j, value in enumerate(matrix[i])))
        for i, name in enumerate(names)
    ]
    said = "" if strong else f" None is above {STRONG:g} in size."
    caption = f"Correlation of the errors of the fitted parameters.{said}"
    yield html.table(("", *(f"{i + 1}" for i in range(len(names)))), rows, caption)


def _errors(document: Document) -> Iterator[str]:
    """What the calibration gained in each shot, and what noise leaves."""
    errors, units = _errors_by_model(document), _units(document)
    if "after" not in errors:
        return
    caption = (
        "Rms error of each shot with the model before and after; upright line: its noise, below which no model comes"
        " but by fitting the noise."
    )
    pictures = {"error of each shot before and after": figures.error_picture(errors, units)}
    yield html.row(pictures, "two", caption, document["command"])
    nothing: Document = {"rms_error_percent": {}, "noise_percent": {}}
    both = errors.get("before", nothing), errors["after"]
    rows = [
        (name, *(_in(units.get(name, "%"), one[what].get(name)) for one in both for what in
                 ("rms_error_percent", "noise_percent"))) for name in errors["after"]["rms_error_percent"]
    ]  # fmt: skip
    yield html.table(("shot", "before", "noise", "after", "noise"), rows)


def _errors_by_model(document: Document) -> dict[str, Document]:
    """The errors of the shots, before and after."""
    return {one["model"]: one for one in document.get("errors") or ()}


def _units(document: Document) -> dict[str, str]:
    """What each shot's errors are told in."""
    return {shot["id"]: unit(shot) for shot in document.get("shots", ())}


def _in(unit: str, value: float | None) -> str:
    return NOTHING if value is None else f"{number(value)} {unit}"


def _with_error(one: Document | None) -> str:
    if one is None:
        return "not free"
    if one["unit"] in ("", "1") and 0.0 <= one["value"] <= 1.0:
        return f"{100.0 * one['value']:.2f} ± {100.0 * one['error']:.2f} %"
    return f"{number(one['value'], 4)} ± {number(one['error'], 2)} {one['unit']}"
