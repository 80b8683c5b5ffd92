"""The tables of a comparison: the shots, how their images lie, the ranked regions, where all of it came from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from viewer import html
from viewer.html import NOTHING, paragraph

Document = Mapping[str, Any]

REGIONS_SHOWN = 20
COUNTS = "binning", "saturated", "masked"


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many digits that count; a dash where there is none."""
    return NOTHING if value is None else f"{value:,.{digits}g}"


def error(shot: Document, name: str, digits: str = ",.3g") -> str:
    """A shot's `rms_error` or `noise` with its unit: of psi and delta degrees, of all else percent of the mean."""
    value = shot.get(name if unit(shot) == "deg" else f"{name}_percent")
    return NOTHING if value is None else f"{value:{digits}} {unit(shot)}"


def unit(shot: Document) -> str:
    """What a shot's errors are told in."""
    return "deg" if shot.get("unit") == "deg" else "%"


def probability(one: Document) -> str:
    """The p of a shot or of a whole comparison, as it was told."""
    return str(one.get("p_text") or number(one.get("p"), 2))


def shots(document: Document) -> Iterator[str]:
    """A row per shot: how far the model is off, what noise explains, and how likely noise alone gives as much."""
    told = any("differs" in shot for shot in document["shots"])
    rows = []
    for shot in document["shots"]:
        row = [
            shot["id"],
            shot["sample"],
            *(error(shot, name, ".2f") for name in ("rms_error", "noise")),
        ]
        row += [number(shot.get(name)) for name in ("mse", "mse_dn2", "chi2_per_pixel")]
        row += [number(shot.get("z")), probability(shot), shot.get("worst_region") or NOTHING]
        rows.append(row[:2] + ([("yes" if shot.get("differs") else "no")] if told else []) + row[2:])
    heads = [
        "shot",
        "sample",
        "rms error",
        "noise",
        "MSE",
        "MSE, DN²",
        "χ² / pixel",
        "z",
        "structure p",
        "worst",
    ]
    if told:
        heads.insert(2, "differs")
    caption = (
        "Rms error and noise: root mean square over the used pixels, the second what noise alone is expected to give;"
        " in percent of the mean signal, of psi and delta in degrees."
        " MSE (Eq. 1): images scaled to the measured maximum, 0 to 1. Structure p: how often noise alone, with the"
        " fit repeated, gives as large a standardised contrast somewhere in the shot; z: that p as a normal"
        " distribution's sigma, so no larger than the draws can tell. χ² / pixel is 1 where only noise is left; it is"
        " too blunt to vote."
    )
    yield html.table(heads, rows, caption, words=3 if told else 2, ending=1)


def placing(document: Document) -> Iterator[str]:
    """What was fitted to each image before anything was compared."""
    images = [shot for shot in document["shots"] if shot["kind"] == "image"]
    if not images:
        return
    rows = []
    for shot in images:
        shift = shot.get("shift_um") or (None, None)
        rows.append((
            shot["id"], number(shot.get("gain_dn_mm2"), 4), number(shot.get("offset_dn")),
            *(_fixed(part, 2) for part in shift), _fixed(shot.get("rotation_deg"), 3),
            f"{shot['pixels']:,}", number(shot.get("pixel_um")),
            *(NOTHING if shot.get(name) is None else f"{shot[name]:,}" for name in COUNTS),
        ))  # fmt: skip
    heads = ("shot", "gain, DN mm²", "offset, DN", "shift x, µm", "shift y, µm", "rotation, °", "pixels", "pixel, µm",
             "binned", "saturated", "masked")  # fmt: skip
    caption = (
        "Fitted to each image, so that no difference is blamed on the model that a moved or brighter camera explains."
        " Pixels: as compared; each is as many of the camera's a side as stand under binned. Saturated and masked"
        " ones are raw pixels and are in no figure."
    )
    yield "<h3>Where each image lies</h3>"
    yield html.table(heads, rows, caption)


def regions(document: Document) -> Iterator[str]:
    """Where the model fails, the least likely first."""
    found: Sequence[Document] = document.get("regions") or ()
    if not found:
        yield paragraph("No region stands out.")
        return
    rows = [
        (f"{i}", one["shot"], one["region"], one["family"], number(one["z"]))
        for i, one in enumerate(found[:REGIONS_SHOWN], 1)
    ]
    caption = (
        "Sums of residuals over a region, standardised by what noise, the fitted camera and the model's own error"
        " give: z is in sigma, its error is 1. The least likely come first; of many regions the largest z is large by"
        " chance too, so families of few regions may stand before larger ones, and structure p is what counts."
        " Rows and columns are of the images as compared: their size in camera pixels stands under Provenance."
    )
    if len(found) > REGIONS_SHOWN:
        caption += f" The first {REGIONS_SHOWN} of {len(found)}."
    yield html.table(("", "shot", "region", "family", "z"), rows, caption, words=4)


def warnings(document: Document) -> Iterator[str]:
    """What is said beside a verdict; documents of earlier versions have none."""
    yield from (paragraph(f"Warning: {warning}.", "note") for warning in document.get("warnings", ()))


def provenance(document: Document, title: str = "This comparison was made by:") -> Iterator[str]:
    """What made a page can be checked and made again."""
    model, dataset, solver = document["model"], document["dataset"], document["solver"]
    rows = [
        ("data set", f"{dataset['name']} ({dataset['path']})"),
        ("data set, SHA-256", dataset["sha256"]),
        ("model", f"{model['name']} ({model['file']})"),
        ("model, SHA-256", model["sha256"]),
        ("solver", solver_in_words(solver)),
        ("seed", f"{solver['seed']}"),
    ]
    yield html.facts(rows)
    yield paragraph(title)
    made_by = document.get("made_by") or ()
    yield html.code("\n".join([*(f"{one}" for one in made_by if one != document["command"]), document["command"]]))


def solver_in_words(solver: Document) -> str:
    """How the model's images were computed."""
    if solver["method"] == "twin":
        return "twin (deterministic, no ray was traced)"
    if solver["method"] == "anchored":
        return f"anchored twin: Monte Carlo, {solver['histories']:,} histories, followed by the twin"
    return f"{solver['method']}, {solver['histories']:,} histories"


def _fixed(value: float | None, digits: int) -> str:
    return NOTHING if value is None else f"{value:+.{digits}f}"
