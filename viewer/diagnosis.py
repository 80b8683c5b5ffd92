"""The page of a diagnosis: the verdict, what is left without and with the effect, the rivals, what to measure.

document and arrays of `luxloop diagnose`  ──▶ one HTML file that loads nothing and runs nothing
document of `luxloop ladder`               ──▶ the errors of all versions, as a page or a picture
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewer import comparison_images as images
from viewer import diagnosis_figures as figures
from viewer import html
from viewer.comparison_tables import number, provenance, warnings
from viewer.html import NOTHING, paragraph
from viewer.look import save

Document = Mapping[str, Any]
Arrays = Mapping[str, NDArray[Any]]

RAREST = 1e-9
"""Smaller probabilities are told as smaller than this."""


def draw(document: Document, arrays: Arrays, path: Path) -> None:
    """Write the page (.html) of a diagnosis, or the one picture that says most (.png, .svg, .pdf)."""
    if path.suffix.lower() in (".html", ".htm"):
        html.write(path, page_of(document, arrays))
    else:
        save(figures.scores_figure(document), path)


def draw_ladder(document: Document, arrays: Arrays, path: Path) -> None:  # noqa: ARG001  # a view's arguments
    """Write the ladder as a page (.html) or a picture."""
    if path.suffix.lower() in (".html", ".htm"):
        body = [html.heading(f"The ladder of {document['model']['file']}"), *_ladder(document)]
        html.write(path, html.page(f"The ladder of {document['model']['file']}", body))
    else:
        save(figures.ladder_figure(document), path)


def page_of(document: Document, arrays: Arrays) -> str:
    """The page of a diagnosis, as HTML."""
    parts = {
        "effects": ("What explains it", list(_effects(document))),
        "images": ("What is left", list(_images(document, arrays))),
        "where": ("Where", list(_where(document))),
        "scores": ("All effects", list(_scores(document))),
        "parameters": ("What the effect does to the fit", list(_parameters(document))),
        "confounding": ("Which effects look alike", list(_confounding(document))),
        "next": ("What to measure next", list(_next(document))),
        "provenance": ("Provenance", list(provenance(document, "This diagnosis was made by:"))),
    }
    present = {name: (title, body) for name, (title, body) in parts.items() if body}
    body = [*_head(document), html.contents({name: title for name, (title, _) in present.items()})]
    body += [html.section(name, title, *inside) for name, (title, inside) in present.items()]
    return html.page(f"Diagnosis of {document['model']['name']} on {document['dataset']['name']}", body)


def _head(document: Document) -> Iterator[str]:
    yield html.heading(f"Diagnosis of {document['model']['name']} on {document['dataset']['name']}")
    yield paragraph(document["sentence"], "lead")
    yield from warnings(document)
    yield from (paragraph(one["words"], "note") for one in document.get("held", ()))
    structure = document["structure"]
    rows = [
        (structure["p_text"], "structure p: how often noise alone leaves as much, before any effect is added"),
        (
            _rare(document["scores_p"]),
            f"how often noise alone makes any of {document['known']} effects score as well",
        ),
    ]
    if document["set"]:
        best = next(one for one in document["effects"] if one["name"] == document["set"][0])
        if share := _share(best):
            rows.append((f"{share} %", f"of the structure is explained by {best['name']}"))
        if best["held_out_before"] is not None:
            fall = f"{number(best['held_out_before'])} → {number(best['held_out_after'])} %"
            rows.append((fall, "rms error in data that were left out of the fit"))
    yield html.highlights(rows)


def _effects(document: Document) -> Iterator[str]:
    if not document["effects"]:
        if document["limits"]:
            yield paragraph("An effect above these sizes would have been seen with 90 % power:")
            rows = [(one["name"], one["parameter"], number(one["value"]), one["unit"]) for one in document["limits"]]
            yield html.table(("effect", "parameter", "seen above", "unit"), rows, words=2, ending=1)
        return
    heads = ("effect", "size", "χ² drop", "explains (%)", "held-out error (%)", "ln evidence", "p left")
    yield html.table(
        heads,
        [_effect(one) for one in document["effects"]],
        "Added one at a time and fitted with the model's own parameters. Explains: of the contrasts that were loudest"
        " before. Held-out: all images of one sample left out in turn. P left: as the structure p, with the effect."
        " Implausible: driven beyond its range, or no gain. Follows the field: as a camera or an optic does, and"
        " chips by chance do not.",
        words=2,
    )


def _effect(one: Document) -> tuple[str, ...]:
    ((name, size),) = one["size"].items()
    held = NOTHING
    if one["held_out_before"] is not None:
        held = f"{number(one['held_out_before'])} → {number(one['held_out_after'])}"
    return (
        one["name"] + (f" ({one['why_not']})" if one["why_not"] else ""),
        f"{name} {_value(size['value'], size['error'])} {size['unit']}".rstrip()
        + _shape(one.get("shape", {}))
        + (", at the end of its range" if one.get("at_end") else ""),
        f"{one['chi2_drop']:.0f}",
        _share(one) or NOTHING,
        held,
        NOTHING if one["log_evidence"] is None else f"{one['log_evidence']:.0f}",
        f"{one['p_left']:.2g}",
    )


def _value(value: float, error: float | None, digits: int = 3) -> str:
    """With its error, where the data know it."""
    return f"{value:.{digits}g}" if error is None else f"{value:.{digits}g} ± {error:.2g}"


def _shape(shape: Document) -> str:
    """What only shapes an effect, after its size."""
    words = ", ".join(f"{name} {number(one, 4) if isinstance(one, float) else one}" for name, one in shape.items())
    return f" ({words})" if words else ""


def _share(one: Document) -> str:
    """Of the structure, in percent; empty where there is nothing to explain."""
    error = one["explained_share_error"]
    if error is None:
        return ""
    digits = (error < 0.0095) + (error < 0.00095)  # whole percents would say that it is known exactly
    return f"{100.0 * one['explained_share']:.{digits}f} ± {100.0 * error:.{digits}f}"


def _rare(p: float) -> str:
    """A probability; a far tail, which nobody can count, as a bound."""
    return f"{p:.2g}" if p >= RAREST else f"< {RAREST:g}"


def _images(document: Document, arrays: Arrays) -> Iterator[str]:
    """Measured, model, residual, noise alone, and the residual with the best effect added."""
    shots = [shot for shot in document["shots"] if f"{shot['id']}/z" in arrays]
    if not shots:
        return
    name = document["set"][0] if document["set"] else ""
    yield paragraph(
        "Residuals are measured minus model in sigma of a pixel's noise, one scale for all. Beside them, on the same"
        " pixels, what noise alone looks like: a model that lacks nothing leaves such a map."
    )
    for shot in shots:
        wanted = (images.MEASURED, images.MODEL, images.NOISE)
        pictures = images.image_pictures(images.image_of(shot, arrays), wanted)
        pictures |= dict(_residuals(shot, arrays, name))
        caption = f"{shot['id']}: {shot['dbr_pairs']:g} pairs."
        yield f"<h3>{html.escaped(shot['id'])}</h3>\n{html.row(pictures, 'three', caption, document['command'])}"


def _residuals(shot: Document, arrays: Arrays, name: str) -> Iterator[tuple[str, bytes]]:
    """Without and, where the verdict names one, with the best effect."""
    image, after = images.image_of(shot, arrays), f"{shot['id']}/z_with"
    without = f"residual without {name} (sigma)" if after in arrays else "residual (sigma)"
    yield without, figures.residual_picture(without, image, image.z)
    if after in arrays:
        title = f"residual with {name} (sigma)"
        yield title, figures.residual_picture(title, image, arrays[after])


def _where(document: Document) -> Iterator[str]:
    rows = [(one["region"], one["shot"], one["family"], f"{one['z']:+.1f}") for one in document["structure"]["where"]]
    caption = "The least like noise first."
    binned = [f"{one['id']} {one['binning']}" for one in document["shots"] if (one.get("binning") or 1) > 1]
    if binned:
        caption += f" Rows and columns are of binned pixels: of the camera's, {', '.join(binned)} a side."
    if rows:
        yield html.table(("where", "shot", "seen in", "sigma"), rows, caption, words=3)


def _scores(document: Document) -> Iterator[str]:
    if not document["scores"]:
        return
    caption = (
        "Each effect by itself, before it is added: sigma of it in the residual, after what the fit's own"
        " parameters can do is taken out; none of a sign that it cannot have. Orange: named by the verdict;"
        " blue: added and fitted; grey: not tried. The largest is not the verdict: somebody is always first."
    )
    yield html.figure(figures.scores_picture(document), "Scores of all effects", caption, document["command"])
    if document["untestable"]:
        yield paragraph(f"Not testable with these data: {', '.join(document['untestable'])}.")


def _parameters(document: Document) -> Iterator[str]:
    rows = []
    for one in document["parameters"]:
        prior = NOTHING if one["prior_mean"] is None else f"{one['prior_mean']:g} ± {one['prior_sd']:g}"
        after = NOTHING if one["with"] is None else _value(one["with"], one["with_error"], 4)
        held = " (at its limit)" if one["at_limit"] else ""
        rows.append((one["path"], _value(one["value"], one["error"], 4) + held, after, prior))
    if rows:
        heads = ("parameter", "without", "with the best effect", "handbook (prior)")
        caption = "A parameter that moves back to its handbook value is a strong argument for the effect."
        yield html.table(heads, rows, caption)


def _confounding(document: Document) -> Iterator[str]:
    found = document["confounding"]
    if len(found["names"]) < 2:
        return
    caption = (
        "Cosine between what two effects do to these data, after what the fit's own parameters can do is taken out."
        " Boxes: groups that are alike."
    )
    yield html.figure(figures.confounding_picture(document), "Cosines of all pairs", caption, document["command"])


def _next(document: Document) -> Iterator[str]:
    if not document["candidates"]:
        return
    caption = "Expected distance between the rivals in sigma if one more image were taken; dashed: now."
    yield html.figure(figures.candidates_picture(document), "Expected separation", caption, document["command"])
    best = document["next_measurement"]
    yield paragraph(f"Take {best['words']}, then fill this into dataset.toml:")
    yield html.code(best["stanza"])


def _ladder(document: Document) -> Iterator[str]:
    caption = (
        "Rms error in percent of the mean signal, or of the mean of a unit's curves, of each version of the model;"
        " the line is noise alone: the camera's and the prediction's own."
    )
    yield html.figure(figures.ladder_picture(document), "The ladder", caption)
    of_curves = {"curves_fitted_percent": "error of curves (%)", "curves_held_out_percent": "held out (%)",
                 "curves_noise_percent": "noise (%)"}  # fmt: skip
    beside = {name: of_curves[name] for name in of_curves if any(one.get(name) for one in document["rungs"])}
    names = ("fitted_percent", "held_out_percent", "noise_percent", *beside, "p")
    heads = ("version", "by", "error (%)", "held out (%)", "noise (%)", *beside.values(), "p of structure", "effects")
    rows = [
        (
            str(one["version"]),
            one["command"],
            *(_number(one.get(name)) for name in names),
            ", ".join(one["effects"]) or NOTHING,
        )
        for one in document["rungs"]
    ]
    yield html.table(heads, rows, words=2, ending=1)
    if document["parameters"]:
        versions = [f"version {one['version']}" for one in document["rungs"]]
        moved = [(one["path"], one["prior"] or NOTHING, *one["values"]) for one in document["parameters"]]
        yield html.table(("parameter", "handbook (prior)", *versions), moved, words=2)


def _number(value: float | None) -> str:
    return NOTHING if value is None or not np.isfinite(value) else f"{value:.3g}"
