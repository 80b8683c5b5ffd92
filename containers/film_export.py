"""A film table as a file of another program, by the file's ending."""

from __future__ import annotations

from pathlib import Path

from containers.thin_film.exports import Exported, opticstudio, radiance_xml, speos
from containers.thin_film.surface import averaging_loss, film_bsdf
from containers.thin_film.table import FilmTable, Side


def export_table(table: FilmTable, side: Side, file: Path) -> dict[str, float]:
    """Write a table in the format of the file's ending; what that format could not carry, with its size."""
    exported = FORMATS[file.suffix.lower()](table, side)
    file.write_text(exported.text, encoding="utf-8")
    return dict(exported.lost)


def _speos(table: FilmTable, side: Side) -> Exported:
    return speos(table, side)


def _opticstudio(table: FilmTable, side: Side) -> Exported:
    return opticstudio(film_bsdf(table, side), "BRDF", also_lost=averaging_loss(table, side))


def _radiance(table: FilmTable, side: Side) -> Exported:
    return radiance_xml(film_bsdf(table, side), also_lost=averaging_loss(table, side))


FORMATS = {".coated": _speos, ".bsdf": _opticstudio, ".xml": _radiance}
