"""Predictions through the controller: six images, a Jacobian of eight columns, an anchor; cold, and moved a little.

    python benchmarks/predictions.py

Single chips and modules of 5 x 5 with 0, 5.5 and 6.5 pairs, images of 128 x 128, real processes on loopback. Cold:
the worker has never seen these chips. Moved: the reflectance of the receiver, then that of the substrate too, is
another one at each request, as in a fit; the median of several. At the client, and of it in the worker.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from benchmarks.processes import THIN_FILM, Processes, percentile, table
from luxloop.client import Answer
from luxloop.design import Design
from luxloop.film import FilmTableRequest, Spectrum
from luxloop.model import Environment, Surface
from luxloop.model_file import find_model
from luxloop.ray import AnchorRequest, Camera, ChipArray, Film, PredictionRequest, ShotRequest

RAY_TRACING = ("-m", "luxloop", "serve", "ray-tracing", "--quiet")
MODEL = "clear_chip"
PAIRS = 0.0, 5.5, 6.5
ARRAYS = ChipArray(rows=1, columns=1, half_um=600.0), ChipArray(rows=5, columns=5)
COLUMNS = (
    "distance_um", "spacing_um", "width_um", "thickness_um", "substrate_reflectance", "substrate_sigma_rad",
    "receiver_reflectance", "absorption_per_um",
)  # fmt: skip
REPEATS = 7


class Bench:
    """The set, its films, and where theta is."""

    def __init__(self, processes: Processes) -> None:
        self._client, self._environment = processes.client, find_model(MODEL).environment
        self._films = {pairs: self._film(pairs) for pairs in PAIRS}
        self._moved = 0

    def _film(self, pairs: float) -> Film | None:
        if not pairs:
            return None
        line = Spectrum(peak_nm=self._environment.peak_nm, fwhm_nm=self._environment.fwhm_nm)
        result = self._client.run(
            FilmTableRequest(environment=self._environment, dbr_pairs=pairs, spectrum=line)
        ).result
        return Film(sha256=result["table_sha256"], bytes=result["table_bytes"])

    def shots(self, environment: Environment) -> tuple[ShotRequest, ...]:
        """Three films, singles and modules."""
        return tuple(
            ShotRequest(
                environment=environment,
                design=Design(distance_um=180.0, width_um=28.0, spacing_um=500.0, thickness_um=35.0, dbr_pairs=pairs),
                film=self._films[pairs],
                array=array,
                camera=Camera(psf_um=10.0),
            )
            for pairs in PAIRS
            for array in ARRAYS
        )

    def moved(self, *, substrate: bool) -> Environment:
        """The model with another receiver, and another substrate where that is wanted."""
        self._moved += 1
        by = 2e-4 * self._moved
        changes = {"receiver": Surface(scatter="lambertian", reflectance=0.35 + by)}
        if substrate:
            changes["substrate"] = self._environment.substrate.model_copy(update={"reflectance": 0.97 - by})
        return self._environment.model_copy(update=changes)

    def timed(self, environment: Environment | None = None, **changes: Any) -> tuple[float, Answer]:
        """Seconds of one request at the client, and its answer."""
        request = PredictionRequest(shots=self.shots(environment or self._environment), **changes)
        begin = time.perf_counter()
        answer = self._client.run(request)
        return time.perf_counter() - begin, answer

    def rows(self, what: str, repeats: int, **changes: Any) -> list[list[object]]:
        """Cold, then moved."""
        rows = [[f"{what}: cold", *_shown([self.timed(**changes)])]]
        for substrate, which in ((False, "receiver"), (True, "receiver and substrate")):
            took = [self.timed(self.moved(substrate=substrate), **changes) for _ in range(repeats)]
            rows.append([f"{what}: {which} moved", *_shown(took)])
        return rows

    def anchor(self, stored_exits: bool) -> AnchorRequest:
        """Monte Carlo at the model itself, a million histories a module."""
        return AnchorRequest(shots=self.shots(self._environment), histories=1_000_000, stored_exits=stored_exits)


def _shown(took: list[tuple[float, Answer]]) -> list[str]:
    """Median seconds at the client and in the worker, and the size of the answer."""
    client, worker = (percentile(some, 50) for some in ([s for s, _ in took], [a.compute_s for _, a in took]))
    size = sum(array.nbytes for array in took[0][1].arrays.values())
    return [f"{1e3 * client:.0f} ms", f"{1e3 * worker:.0f} ms", f"{size / 1e6:.1f} MB"]


SECTIONS: dict[str, Callable[[Bench], list[list[object]]]] = {
    "images": lambda bench: bench.rows("six images", REPEATS),
    "fewer exits": lambda bench: bench.rows("six images, 32,768 histories of exits", REPEATS, exit_histories=32_768),
    "columns": lambda bench: bench.rows("six images, eight columns", 3, columns=COLUMNS),
    "stored": lambda bench: bench.rows(
        "the same, anchored, stored exits", 3, columns=COLUMNS, anchor=bench.anchor(True)
    ),
    "anchored": lambda bench: bench.rows("six images, anchored, full histories", REPEATS, anchor=bench.anchor(False)),
}
"""Each in a set of its own, so that cold is cold."""


def main() -> None:
    """Print the table."""
    rows = []
    for section in SECTIONS.values():
        with Processes(THIN_FILM, RAY_TRACING) as processes:
            rows += section(Bench(processes))
    table(f"predictions over the bus, {MODEL}", rows, ["what", "at the client", "in the worker", "arrays"])


if __name__ == "__main__":
    main()
