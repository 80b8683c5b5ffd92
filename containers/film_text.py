"""What a person reads of `luxloop film`: a caption, the values, then tables and files."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

FIRST_COLUMN = 13  # characters


def as_text(document: dict[str, Any], columns: int | None) -> str:
    """What a person reads: the values in as many blocks as `columns` characters ask for, then tables and files."""
    lines = [_caption(document), *_blocks(document, columns)]
    lines += [f"WARNING: {warning}" for warning in document.get("warnings", ())]
    for film in document["films"]:
        if "table" in film:
            table = film["table"]
            lines.append(
                f"table of {film['dbr_pairs']:>4g} pairs: {table['sha256'][:16]}, {table['bytes'] / 1e3:.0f} kB, "
                f"{table['wavelengths']} wavelengths x s, p x {table['nodes']} nodes, "
                f"{'from the database' if table['known'] else 'computed'}, "
                f"within {table['largest_difference']:.1e} of the values above"
            )
            lines.append(_error(table))
    if "export" in document:
        from containers.thin_film.exports.exported import lost_words

        lines.append(f"exported: {document['export']['file']}")
        lines.append("    what its format cannot carry errs by up to (ratio of the power, where no unit follows)")
        lines.append(f"    {lost_words(document['export']['lost'])}")
    if "plot" in document:
        lines.append(f"picture: {document['plot']}")
    return "\n".join(lines)


def _error(table: dict[str, Any]) -> str:
    """How far a table is wrong."""
    average, single = (f"{table[f'error_{name}_ratio']:.1e}" for name in ("average", "single"))
    if table["resolved"]:
        return f"    interpolation errs by up to {average} (line average), {single} (one wavelength)"
    return f"    WARNING: not resolved, it errs by {average} (line average) or more: do not trace with it"


def _blocks(document: dict[str, Any], columns: int | None) -> Iterator[str]:
    """One row per angle or wavelength, one column per film; beside each other those that fit, the others below."""
    name = "angle_deg" if document["against"] == "angle" else "wavelength_nm"
    films = document["films"]
    titles = [f"{film['dbr_pairs']:g} pairs" if "dbr_pairs" in film else "value" for film in films]
    width = max(9, *(len(title) + 2 for title in titles))
    digits = 3 if document["unit"] == "deg" else 5
    together = len(films) if columns is None else max(1, (columns - FIRST_COLUMN) // width)
    for start in range(0, len(films), together):
        shown = slice(start, start + together)
        yield from [""] * (start > 0)
        yield f"{name:>{FIRST_COLUMN}}" + "".join(f"{title:>{width}}" for title in titles[shown])
        for row, at in enumerate(document[name]):
            cells = "".join(f"{film['values'][row]:>{width}.{digits}f}" for film in films[shown])
            yield f"{at:>{FIRST_COLUMN}g}" + cells


def _caption(document: dict[str, Any]) -> str:
    kinds = {"s": "s-polarised light", "p": "p-polarised light", "u": "unpolarised light"}
    light = "light" if document["unit"] == "deg" else kinds[document["polarisation"]]
    at = document["wavelength_nm"][0] if document["against"] == "angle" else document["angle_deg"][0]
    at_text = f"at {at:g} nm" if document["against"] == "angle" else f"at {at:g} deg"
    line = f", averaged over a line of {document['bandwidth_nm']:g} nm FWHM" if document["bandwidth_nm"] else ""
    film = document["films"][0].get("stack")
    what = film or f"DBR of the model {document['model']['name']!r}"
    unit = " in deg" if document["unit"] == "deg" else ""
    return f"{document['quantity']}{unit} of {what}, {light} from the {document['side']}, {at_text}{line}"
