"""PC3's work: a request, the film table it names, the answer of `simulation`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from containers.acting import Effects
from containers.catalogue import Catalogue, told
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.field_source import FieldSource
from containers.ray_tracing.kept import Kept
from containers.ray_tracing.predictor import Predictor
from containers.ray_tracing.simulation import simulate
from containers.ray_tracing.twin.columns import CAMERA_COLUMNS, COLUMNS
from containers.reporting import Report
from containers.stack import dbr_of
from containers.thin_film.packing import unpack
from containers.thin_film.table import FilmTable, film_table
from luxloop.bus.frame import Array
from luxloop.camera import Camera
from luxloop.computation import Progress
from luxloop.design import Design
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.film import Grid, Spectrum
from luxloop.model import Environment, Surface
from luxloop.process import usable_cores
from luxloop.ray import KIND, ChipArray, EffectsRequest, Film, Module, PredictionRequest, RayRequest
from luxloop.words import parse

Fetch = Callable[[str, int], bytes]

HELD_FILM_BYTES = 128 << 20
"""Of film tables that are kept unpacked: some 200 kB each, up to 64 MB; the latest is kept in any case."""
MOST_THREADS = 1024


class RayComputation:
    """What makes a worker the ray-tracing worker.

    `fetch` brings a blob by hash and size, from the bus; `source` has the stored chip exits,
    `fields` what anchors have run.
    """

    kind = KIND

    def __init__(
        self,
        fetch: Fetch,
        source: ExitSource,
        threads: int | None = None,
        catalogue: Catalogue | None = None,
        fields: FieldSource | None = None,
    ) -> None:
        self._fetch, self._source, self._threads = fetch, source, threads
        self._catalogue = catalogue or Catalogue()
        self._predictor = Predictor(source, threads, fields)
        self._films = Kept[tuple[FilmTable, int]](HELD_FILM_BYTES, lambda one: one[1])

    def catalogue(self) -> dict[str, Any]:
        """What can be asked, and which effects are known."""
        return {
            "tasks": ["simulation", "prediction"],
            "methods": ["monte_carlo", "twin"],
            "columns": [*COLUMNS, *CAMERA_COLUMNS],
            **told(self._catalogue),
        }

    def blob(self, sha256: str) -> bytes | None:  # noqa: ARG002  # a worker's interface
        """None: what it sends lies in the store of what was sent."""
        return None

    def compute(self, inputs: dict[str, Any], progress: Progress) -> tuple[dict[str, Any], Mapping[str, Array]]:
        """The answer to a `RayRequest`, or to another one where `task` says so."""
        if inputs.get("task") == "effects":
            parse(EffectsRequest, inputs, "request for effects")
            self._catalogue.rescan(partial(progress.report, 0.0, "effects"))
            return told(self._catalogue), {}
        if "task" in inputs:
            return self._predict(inputs, progress)
        request = parse(RayRequest, inputs, "ray request")
        effects = self.effects(request, partial(progress.report, 0.0, "effects"))
        progress.report(0.0, str(request.design))
        film = None if request.film is None else self.film(request.film)
        return simulate(request, film, self._source, progress, self._threads, effects)

    def effects(self, module: Module, report: Report) -> Effects:
        """Those of a request, ready to act; RemoteError unknown_effect, InputError, and what the report raises."""
        return self._catalogue.effects(module.effects, "ray-tracing", report)

    def _predict(self, inputs: dict[str, Any], progress: Progress) -> tuple[dict[str, Any], Mapping[str, Array]]:
        request = parse(PredictionRequest, inputs, "prediction request")
        progress.report(0.0, "prediction")
        means = _Means(self, partial(progress.report, 0.0, "effects"))
        return self._predictor.answer(request, means, progress)

    def film(self, film: Film) -> FilmTable:
        """The table of that hash, of those held or from who has it; RemoteError not_found where nobody has."""
        return self._films.of(film.sha256, float(film.bytes), partial(self._unpacked, film))[0]

    def _unpacked(self, film: Film) -> tuple[FilmTable, int]:
        """The table and its size."""
        packed = self._fetched(film)
        return FilmTable.from_parts(*unpack(packed)), len(packed)

    def _fetched(self, film: Film) -> bytes:
        try:
            return self._fetch(film.sha256, film.bytes)
        except RemoteError as error:
            raise RemoteError(
                Failure(
                    code="not_found",
                    message=f"nobody holds the film table {film.sha256} ({error.failure.message})",
                    field="film",
                    value=film.sha256,
                    mend="ask the thin-film worker for the table again, then for this",
                )
            ) from error


@dataclass(frozen=True)
class _Means:
    """What a prediction names and does not bring, while somebody listens for a cancel."""

    computation: RayComputation
    report: Report

    def film(self, film: Film) -> FilmTable:
        """The table of that hash."""
        return self.computation.film(film)

    def effects(self, module: Module) -> Effects:
        """The effects of a module and its camera, ready to act."""
        return self.computation.effects(module, self.report)


def warm_up(source: ExitSource, threads: int | None = None) -> None:
    """Compile all kernels that a request can come to, or load what was compiled before.

    Kernels know no surface: Lambert's are used, of which no tables are made.
    """
    environment = Environment(substrate=Surface(scatter="lambertian", reflectance=0.5))
    design = Design(distance_um=100.0, width_um=50.0, spacing_um=300.0, thickness_um=20.0, dbr_pairs=0.5)
    line = Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm)
    film = film_table(dbr_of(environment, design.dbr_pairs), line, Grid(wavelengths=11, tolerance_ratio=1.0))
    cell = RayRequest(environment=environment, design=design, histories=1, exit_histories=1)
    camera = Camera(rows=8, columns=8, distortion=0.01, psf_um=8.0, glare=0.01)
    for changed in (
        {"far_field": True, "images": (camera,)},
        {"array": ChipArray(rows=1, columns=1, wall_reflectance=0.5)},
        {"stored_exits": True},
        {"method": "twin"},
    ):
        simulate(cell.model_copy(update=changed), film, source, Progress(), threads)


def wanted_threads() -> int:
    """Threads to compute on: LUXLOOP_THREADS, or as many as this process may use."""
    given = os.environ.get("LUXLOOP_THREADS", "")
    if not given:
        return usable_cores()
    if not given.isdecimal() or not 1 <= int(given) <= MOST_THREADS:
        allowed, mend = f"a whole number from 1 to {MOST_THREADS}", "leave it out to use all cores"
        raise InputError("LUXLOOP_THREADS", given, allowed, mend)
    return int(given)
