"""PC2's work: film tables out of the database or computed, and film measurements."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from containers.acting import Effects
from containers.catalogue import Catalogue, told
from containers.effect import Reading
from containers.materials import list_materials, material
from containers.reporting import Report
from containers.stack import dbr_of, resolve
from containers.thin_film import warm_up
from containers.thin_film.database import FilmDatabase, open_database
from containers.thin_film.film_measurement import RowsAt, Spot, measure
from containers.thin_film.packing import pack, unpack
from containers.thin_film.table import VERSION, FilmTable, film_table
from luxloop.bus.frame import Array
from luxloop.computation import Progress
from luxloop.errors import InputError
from luxloop.film import FILM_REQUEST, KIND, FilmMeasurementRequest, FilmTableRequest
from luxloop.stack import Stack
from luxloop.words import as_input_error, sha256_of

DATABASE = "films.sqlite"


class FilmComputation:
    """What makes a worker the thin-film worker; `database` is its own file."""

    kind = KIND

    def __init__(self, database: FilmDatabase, catalogue: Catalogue | None = None) -> None:
        self._database, self._catalogue = database, catalogue or Catalogue()
        warm_up()

    @classmethod
    def in_folder(cls, folder: Path, catalogue: Catalogue | None = None) -> FilmComputation:
        """With the database in a folder, made where it is not there yet."""
        folder.mkdir(parents=True, exist_ok=True)
        return cls(open_database(folder / DATABASE), catalogue)

    def catalogue(self) -> dict[str, Any]:
        """What can be asked, which materials and effects are known."""
        return {"what": ["table", "measurement"], "materials": list(list_materials()), **told(self._catalogue)}

    def blob(self, sha256: str) -> bytes | None:
        """A packed table by its hash."""
        return self._database.blob(sha256)

    def compute(self, inputs: dict[str, Any], progress: Progress) -> tuple[dict[str, Any], Mapping[str, Array]]:
        """The answer to a `FilmTableRequest` or a `FilmMeasurementRequest`."""
        try:
            request = FILM_REQUEST.validate_python(inputs)
        except ValidationError as error:
            raise as_input_error(error, "film request") from error
        effects = self._catalogue.effects(request.effects, "thin-film", partial(progress.report, 0.0, "effects"))
        spot = spot_of(request, effects)
        report = partial(progress.report, 0.0, str(spot[0][1])[:100])
        report()
        if isinstance(request, FilmMeasurementRequest):
            result, arrays = _measure(request, spot, effects, report)
        elif len(spot) != 1 or (request.stack is not None and effects.makes_media):
            allowed = "effects from one stack to one stack: a table is of such a one"
            raise InputError("effects", [one.name for one in effects.all], allowed, "ask for a measurement")
        else:
            result, arrays = self._table(request, spot[0][1], report)
        idle = [] if request.dbr_pairs is None else effects.without_influence(request.dbr_pairs)
        if isinstance(request, FilmMeasurementRequest) and request.stack is not None:
            idle = effects.idle_on(request.stack, request.wavelength_nm)
        return (result | {"warnings": idle} if idle else result), arrays

    def _table(
        self, request: FilmTableRequest, stack: Stack, report: Report
    ) -> tuple[dict[str, Any], Mapping[str, Array]]:
        """By its key from the database; computed and kept where it is not there, or no longer what it was."""
        key = table_key(request, stack)
        held = self._database.get(key)
        if held is None:
            table = film_table(stack, request.spectrum, request.grid, report)
            packed = pack(*table.to_parts())
            sha256 = self._database.put(key, packed)
        else:
            sha256, packed = held
            table = FilmTable.from_parts(*unpack(packed))
        result = {"stack": str(stack), "table_sha256": sha256, "table_bytes": len(packed), "known": held is not None}
        return result | errors_of(table), averages(table)


def table_key(request: FilmTableRequest, stack: Stack) -> str:
    """SHA-256 of all that decides a table: the stack as it is computed, the data of its materials, line, grid, and
    the physics' version."""
    media = stack.inside, *(layer.medium for layer in stack.layers), stack.outside
    data = {name: material(name).sha256 for name in {one.material for one in media} if name is not None}
    return sha256_of(
        {
            "stack": stack.model_dump(mode="json"),
            "spectrum": request.spectrum.model_dump(mode="json"),
            "grid": request.grid.model_dump(mode="json"),
            "version": VERSION,
        }
        | ({"materials": data} if data else {})
    )


def errors_of(table: FilmTable) -> dict[str, float]:
    """How far a table is wrong, and how far it may be; above that it is not resolved."""
    return {
        "error_average_ratio": table.error_average_ratio,
        "error_single_ratio": table.error_single_ratio,
        "tolerance_ratio": table.grid.tolerance_ratio,
    }


def averages(table: FilmTable) -> dict[str, Array]:
    """What a table says of unpolarised light of the whole line: u (node,), R and T of both sides."""
    inside, outside = table.average("inside"), table.average("outside")
    return {"u": table.u, "R_inside": inside.R, "R_outside": outside.R, "T": outside.T}


def spot_of(request: FilmTableRequest | FilmMeasurementRequest, effects: Effects) -> tuple[tuple[float, Stack], ...]:
    """Shares of the spot that a request is about, and the stack at each of them, the effects applied."""
    if request.stack is not None:
        return effects.film(request.stack)
    if request.environment is None or request.dbr_pairs is None:  # refused when the request was read
        raise ValueError("a film request without a film")
    return ((1.0, effects.dbr(dbr_of(request.environment, request.dbr_pairs))),)


def _measure(
    request: FilmMeasurementRequest, spot: tuple[tuple[float, Stack], ...], effects: Effects, report: Report
) -> tuple[dict[str, Any], Mapping[str, Array]]:
    """What the instrument reads, its own effects last; InputError where there is nothing to read."""
    lies: Spot = spot
    if request.stack is not None and effects.makes_media:
        lies = tuple((share, _with_media(stack, effects)) for share, stack in spot)
    value = measure(
        lies,
        request.quantity,
        request.wavelength_nm,
        request.aoi_deg,
        request.polarisation,
        request.bandwidth_nm,
        request.from_side,
        report,
    )
    dark = np.argwhere(np.isnan(value))
    if dark.size:
        wavelength_nm, aoi_deg = request.wavelength_nm[dark[0, 0]], request.aoi_deg[dark[0, 1]]
        asked = f"{request.quantity} at {wavelength_nm:g} nm and {aoi_deg:g} deg"
        raise InputError("quantity", asked, "of light that is reflected: none is there", "leave that place out")
    reading = Reading(
        request.quantity, np.array(request.wavelength_nm), np.array(request.aoi_deg), request.polarisation
    )
    value = effects.curve(value, reading)
    return {"stack": str(spot[0][1]), "quantity": request.quantity}, {"value": value}


def _with_media(stack: Stack, effects: Effects) -> RowsAt:
    """The rows of a stack with the media that effects make."""
    return lambda wavelength_nm: effects.rows(resolve(stack, wavelength_nm))
