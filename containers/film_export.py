"""A film table as a file of another program, by the file's ending."""

from __future__ import annotations

from pathlib import Path

from containers.thin_film.exports import Exported, opticstudio, radiance_xml, speos
from containers.thin_film.scatter import AbcSpectrum
from containers.thin_film.surface import averaging_loss, film_bsdf
from containers.thin_film.table import FilmTable, Side
from luxloop.files import whole


def export_table(table: FilmTable, side: Side, file: Path, faces: AbcSpectrum | None = None) -> dict[str, float]:
    """Write a table for light from `side` in the format of the file's ending; what was lost, by name with its unit.

    `faces`, the power spectrum of rough faces, gives scattered light its directions in `.bsdf` and `.xml`; without it
    that light is left out there, and `scatter_ratio` says how much that is. The `.coated` format has no scatter.
    """
    exported = FORMATS[file.suffix.lower()](table, side, faces)
    with whole(file) as fresh:
        fresh.write_text(exported.text, encoding="utf-8")
    return dict(exported.lost)


def _speos(table: FilmTable, side: Side, faces: AbcSpectrum | None) -> Exported:  # noqa: ARG001  # it has no scatter
    return speos(table, side)


def _opticstudio(table: FilmTable, side: Side, faces: AbcSpectrum | None) -> Exported:
    return opticstudio(film_bsdf(table, side, faces), "BRDF", also_lost=averaging_loss(table, side, faces))


def _radiance(table: FilmTable, side: Side, faces: AbcSpectrum | None) -> Exported:
    return radiance_xml(film_bsdf(table, side, faces), also_lost=averaging_loss(table, side, faces))


FORMATS = {".coated": _speos, ".bsdf": _opticstudio, ".xml": _radiance}
