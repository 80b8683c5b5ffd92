"""The page of a comparison: how far each shot is from the model, where, and whether noise explains it.

    document and arrays of `luxloop compare` or `luxloop where` ──▶ one HTML file that loads nothing and runs nothing

Every figure's caption says what its error is and which command made it. The same document gives the same bytes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from viewer import comparison_curves as curves
from viewer import comparison_images as images
from viewer import comparison_tables as tables
from viewer import html
from viewer.comparison_tables import number, probability
from viewer.html import paragraph
from viewer.look import TEXT, save

Document = Mapping[str, Any]
Arrays = Mapping[str, NDArray[Any]]

UNFOLDED = 6  # images shown at once; of more, those with the largest z
QUANTITIES = {"R": "reflectance R", "T": "transmittance T", "psi": "psi (deg)", "delta": "delta (deg)"}
PAIRS = re.compile(r"(\d+(?:\.\d+)?) pairs?")


def draw(document: Document, arrays: Arrays, path: Path) -> None:
    """Write the page (.html) of a comparison, or the one picture that says most (.png, .svg, .pdf)."""
    if path.suffix.lower() in (".html", ".htm"):
        html.write(path, page_of(document, arrays))
    else:
        save(worst_shot(document, arrays), path)


def page_of(document: Document, arrays: Arrays) -> str:
    """The page of a comparison, as HTML."""
    parts = {
        "shots": ("Shots", list(tables.shots(document))),
        "images": ("Images", list(_images(document, arrays))),
        "regions": ("Where it fails", list(tables.regions(document))),
        "curves": ("Against distance and angle", list(_profiles(document))),
        "spectra": ("Spectra and far fields", list(_spectra(document, arrays))),
        "provenance": ("Provenance", [*tables.placing(document), *tables.provenance(document)]),
    }
    present = {name: (title, body) for name, (title, body) in parts.items() if body}
    body = [*_head(document), html.contents({name: title for name, (title, _) in present.items()})]
    body += [html.section(name, title, *inside) for name, (title, inside) in present.items()]
    return html.page(f"{document['dataset']['name']} against {document['model']['name']}", body)


def worst_shot(document: Document, arrays: Arrays) -> Figure:
    """The picture of the shot that is furthest from the model."""
    shot = furthest(document["shots"])[0]
    title = f"{document['sentence']}. Furthest: {shot['id']}, structure p {probability(shot)}"
    if shot["kind"] == "image":
        return images.worst(images.image_of(shot, arrays), title)
    with rc_context(TEXT):
        figure = Figure(figsize=(8.6, 5.4), layout="constrained")
        curves.curve_panes(figure, *_curve(shot, arrays))
        figure.suptitle(title, fontsize=10, x=0.01, ha="left")
        return figure


def furthest(shots: Sequence[Document]) -> list[Document]:
    """Shots by p, the least first, then by chi2; z is that of p, below 0 where a shot fits better than most would."""
    return sorted(shots, key=lambda one: (-(one.get("z") or 0.0), -(one.get("chi2_per_pixel") or 0.0)))


def _head(document: Document) -> Iterator[str]:
    """What was compared, what came of it, and whether to believe it."""
    model, structure = document["model"], document["structure"]
    yield html.heading(f"{document['dataset']['name']} against the model {model['name']}")
    yield paragraph(f"{document['sentence']}.".replace("..", "."), "lead")
    shots = document["shots"]
    rows = []
    rated = [shot for shot in shots if shot.get("rms_error_percent") is not None]
    if rated:
        far = max(rated, key=lambda one: one["rms_error_percent"] / (one.get("noise_percent") or 1.0))
        rows.append((
            tables.error(far, "rms_error"),
            f"rms error of {far['id']}, most above its noise of {tables.error(far, 'noise')}",
        ))  # fmt: skip
    chance = f"structure p: how often noise alone gives as much, of {structure['draws']:,} simulated repeats"
    rows.append((probability(structure), chance))
    if found := document.get("regions"):
        least = f"least likely to be noise: {found[0]['region']}, {found[0]['shot']}"
        rows.append((f"{number(found[0]['z'])} sigma", least))
    rows.append((f"{sum(shot['pixels'] for shot in shots):,}", f"points compared, in {len(shots)} shots"))
    yield html.highlights(rows)
    if not document["trusted"]:
        yield paragraph(f"The fit itself is not trustworthy: {document['reason']}. Mend this first.", "note")
    yield from tables.warnings(document)


def _images(document: Document, arrays: Arrays) -> Iterator[str]:
    """Each image as measured, as modelled, and the difference; of many the furthest are shown, the rest folded."""
    shots = [shot for shot in document["shots"] if f"{shot['id']}/z" in arrays and shot["kind"] == "image"]
    if not shots:
        return
    yield paragraph(
        "Residual: measured minus model in sigma of a pixel's noise, blue darker and red brighter than the model, one"
        f" scale of ±{curves.SCALE:g} for all. Below it, on the same pixels and scale, what noise alone looks like: a"
        " model that lacks nothing leaves such a map. Cuts go through the chips, where the model is brightest; their"
        " shaded range holds 95 % of noise. Grey: saturated or masked."
    )
    far = furthest(shots)[:UNFOLDED]
    for shot in shots:
        figure = _image(document, shot, arrays)
        title = f"{shot['id']}: {shot['sample']}"
        if any(shot is one for one in far):
            yield f"<h3>{html.escaped(title)}</h3>\n{figure}"
        else:
            yield html.folded(title, figure)


def _image(document: Document, shot: Document, arrays: Arrays) -> str:
    image = images.image_of(shot, arrays)
    side = images.joined(image)
    caption = (
        f"Rms error {tables.error(shot, 'rms_error')}, of which noise {tables.error(shot, 'noise')};"
        f" χ² per pixel {number(shot.get('chi2_per_pixel'))}; structure p {probability(shot)}."
    )
    if shot.get("worst_region"):
        caption += f" Worst: {shot['worst_region']}."
    if side > 1:
        caption += f" Drawn with {side} x {side} pixels joined; the sigma is that of the joined ones."
    return html.row(images.image_pictures(image), "three", caption, document["command"])


def _profiles(document: Document) -> Iterator[str]:
    """A picture per coordinate."""
    found: dict[str, list[Document]] = {}
    for one in document.get("profiles") or ():
        unit = one.get("value_unit")
        found.setdefault(one["against"] + (f", {unit}" if unit else ""), []).append(one)
    if not found:
        return
    groups = {shot["id"]: _setting(shot) if shot["kind"] == "image" else shot["id"] for shot in document["shots"]}
    pictures = {f"residual against {name}": curves.profile_picture(rows, groups) for name, rows in found.items()}
    caption = (
        "Mean residual against one coordinate at a time; one colour per DBR setting, or per curve. Bands: what noise"
        " gives in 95 % of cases, its own band for each curve; dots: where a curve leaves its band. A curve that"
        " stays inside is explained by noise; about one point in twenty leaves it by chance. Power against spatial"
        " frequency: 1 is noise."
    )
    yield html.row(pictures, "two", caption, document["command"])


def _spectra(document: Document, arrays: Arrays) -> Iterator[str]:
    """Each spectrum and far field with its residual, and the residual against optical thickness."""
    for shot in document["shots"]:
        name = shot["id"]
        if shot["kind"] == "image" or f"{name}/measured" not in arrays:
            continue
        pictures = {f"{name}, measured and model": curves.curve_picture(*_curve(shot, arrays))}
        lines = [one for one in document.get("fourier") or () if one["shot"] == name]
        if lines:
            pictures[f"{name}, residual against optical thickness"] = curves.fourier_picture(lines)
        caption = (
            f"Below: measured minus model in sigma of the measurement, as its file states it; the shaded range holds"
            f" 95 % of noise. χ² per point {number(shot.get('chi2_per_pixel'))}, p {probability(shot)}."
        )
        if lines:
            caption += " " + _fringes(lines)
        yield f"<h3>{html.escaped(name)}: {html.escaped(shot['sample'])}</h3>"
        yield html.row(pictures, "two", caption, document["command"])


def _fringes(lines: Sequence[Document]) -> str:
    """The strongest peak of a spectrum's residual against optical thickness, and whether noise gives as much."""
    strongest = max(lines, key=lambda one: one["peak"]["power"])
    peak = strongest["peak"]
    chance = "less than 1e-300" if peak["log_chance"] < -690.0 else f"{math.exp(peak['log_chance']):.2g}"
    return (
        f"Fringes equally spaced in 1/wavelength are a peak at their layer's optical thickness: strongest at"
        f" {peak['optical_thickness_um']:.3g} µm ({strongest['line']}), power {number(peak['power'])}; noise alone"
        f" has as much somewhere on this line with a chance of {chance}."
    )


def _curve(shot: Document, arrays: Arrays) -> tuple[Any, ...]:
    """What `curve_panes` draws: x, measured, model, sigma, the name of each point's line, labels of the axes."""
    name = shot["id"]
    measured, model, sigma = (arrays[f"{name}/{part}"] for part in ("measured", "model", "sigma"))
    far_field = shot["kind"] == "far_field"
    x, apart = (arrays[f"{name}/{part}"] for part in (("theta_deg", "phi_deg") if far_field else
                                                      ("wavelength_nm", "aoi_deg")))  # fmt: skip
    lines = [f"{'phi ' if far_field else ''}{value:g}°" for value in apart]
    polarised = arrays.get(f"{name}/polarisation")
    if polarised is not None and len(set(polarised)) > 1:
        lines = [f"{line} {one}" for line, one in zip(lines, polarised, strict=True)]
    labels = (
        ("theta (deg)", "intensity (relative)")
        if far_field
        else ("wavelength (nm)", QUANTITIES.get(str(shot.get("quantity")), "measured value"))
    )
    return x, measured, np.asarray(model), sigma, lines, labels


def _setting(shot: Document) -> str:
    """The DBR setting of a shot, which gives its curves their colour; its sample where none is told."""
    pairs = shot.get("dbr_pairs")
    if pairs is None:
        found: Sequence[str] = PAIRS.findall(shot["sample"])
        pairs = float(found[0]) if found else 0.0 if "no DBR" in shot["sample"] else None
    if pairs is None:
        return str(shot["sample"])
    return f"{pairs:g} pairs" if pairs else "no DBR"
