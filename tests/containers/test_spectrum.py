"""`spectrum = sampled`: a wavelength per history, through real requests."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.ray_tracing.build import cell_of, scene_of
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.monte_carlo import BLOCK, MonteCarlo
from containers.ray_tracing.worker import RayComputation
from containers.stack import dbr_of
from containers.thin_film.angles import powers_at
from containers.thin_film.packing import pack
from containers.thin_film.table import FilmTable, film_table
from luxloop.computation import Progress
from luxloop.design import Design
from luxloop.film import Grid, Spectrum
from luxloop.model import Environment
from luxloop.ray import RayRequest
from luxloop.words import parse

GROUPS = 32
HISTORIES = 4 * GROUPS * BLOCK
DESIGN = {"distance_um": 180.0, "width_um": 28.0, "spacing_um": 500.0, "thickness_um": 35.0, "dbr_pairs": 6.5}
PAPER = {"active_layer_depth": 0.99, "chip_bottom": "mirror", "chip_absorption_per_cm": 200.0}
Answer = tuple[dict[str, Any], dict[str, NDArray[Any]]]


@cache
def film(pairs: float = 6.5, indices: str = "fixed") -> FilmTable:
    """The table of a DBR, as PC2 makes it."""
    environment = Environment.model_validate({"indices": indices})
    return film_table(dbr_of(environment, pairs), Spectrum(), Grid(wavelengths=11))


def answered(spectrum: str, threads: int | None = None, indices: str = "fixed", **changes: Any) -> Answer:
    """What the worker answers for S_b3 by 131,072 histories, its film fetched by hash."""
    raw = pack(*film(indices=indices).to_parts())
    asked = parse(
        RayRequest,
        {
            "environment": PAPER | {"spectrum": spectrum, "indices": indices},
            "design": DESIGN,
            "film": {"sha256": hashlib.sha256(raw).hexdigest(), "bytes": len(raw)},
            "histories": HISTORIES,
        }
        | changes,
    )
    computation = RayComputation(lambda *_: raw, ExitSource(threads=threads), threads)
    result, arrays = computation.compute(json.loads(asked.model_dump_json()), Progress())
    return result, dict(arrays)


def assert_same(one: Answer, other: Answer) -> None:
    """The same documents, and the same arrays bit for bit."""
    assert one[0] == other[0]
    assert one[1].keys() == other[1].keys()
    for name, array in one[1].items():
        np.testing.assert_array_equal(array, other[1][name])


@pytest.mark.parametrize("stored_exits", [False, True])
def test_a_wavelength_per_history_conserves_light_on_any_number_of_threads(stored_exits: bool) -> None:
    """The ledger is closed as far as weights are exact; one thread is two threads, rays and wavelengths too."""
    one, two = (
        answered("sampled", threads, stored_exits=stored_exits, far_field=True, exit_histories=1)
        for threads in (1, 2)
    )
    assert_same(one, two)
    assert abs(one[0]["ledger_defect"]) < 1e-12
    assert one[0]["warnings"] == []


@pytest.mark.parametrize("indices", ["fixed", "dispersive"])
def test_every_wavelength_of_the_table_is_traced_by_its_weight(indices: str) -> None:
    """Rays that leave a clear top-lit chip carry all lines that matter, about the peak, as wide as the line."""
    environment = {"spectrum": "sampled", "indices": indices}
    _, arrays = answered("sampled", indices=indices, environment=environment, exit_histories=HISTORIES)
    table = film(indices=indices)
    at = arrays["ray_wavelength_nm"].astype(float)
    flux = arrays["ray_flux_ratio"].astype(float)
    lines = table.wavelength_nm.astype(np.float32)
    expected = set(lines[table.weight > 1e-3].tolist())
    assert expected <= set(at.tolist()) <= set(lines.tolist())
    mean = np.average(at, weights=flux)
    spread = np.sqrt(np.average((at - mean) ** 2, weights=flux))
    assert mean == pytest.approx(445.0, abs=0.3)
    assert spread == pytest.approx(18.0 / np.sqrt(8.0 * np.log(2.0)), rel=0.03)


@pytest.mark.parametrize("indices", ["fixed", "dispersive"])
def test_each_wavelength_meets_its_own_film(indices: str) -> None:
    """R and T of face k are the table's stack at wavelength k; index and weight are those of the table."""
    table = film(indices=indices)
    environment = Environment.model_validate({"spectrum": "sampled", "indices": indices})
    design = parse(Design, DESIGN)
    made = scene_of(environment, design, table, cell_of(environment, design))
    np.testing.assert_array_equal(made.chip.index, table.n_inside)
    np.testing.assert_allclose(made.wavelength_weight, table.weight, rtol=1e-12)
    for side, face in (("inside", made.chip.top.inside), ("outside", made.chip.top.outside)):
        for wave, bsdf in enumerate(face):
            theta = bsdf.theta_in_rad[::25]  # type: ignore[attr-defined]  # a table's
            powers = powers_at(table, side, theta)  # type: ignore[arg-type]  # a side's name
            mirror, refracted = bsdf.deltas(theta)
            np.testing.assert_allclose(mirror, powers.R[wave].mean(axis=0), atol=1e-6)
            np.testing.assert_allclose(refracted, powers.T[wave].mean(axis=0), atol=1e-6)


def test_one_encounter_is_the_average_of_its_wavelengths() -> None:
    """R of the averaged film = weighted mean of R of the sampled ones, at every angle from either side."""
    design, faces = parse(Design, DESIGN), []
    for spectrum in ("averaged", "sampled"):
        environment = Environment.model_validate({"spectrum": spectrum})
        made = scene_of(environment, design, film(), cell_of(environment, design))
        faces.append((made.chip.top, made.wavelength_weight))
    (averaged, _), (sampled, weight) = faces
    theta = np.linspace(0.0, np.pi / 2, 91)
    for mean, lines in ((averaged.inside, sampled.inside), (averaged.outside, sampled.outside)):
        each = np.array([bsdf.deltas(theta).mirror for bsdf in lines])
        assert np.ptp(each, axis=0).max() > 0.1
        np.testing.assert_allclose(weight @ each, mean[0].deltas(theta).mirror, atol=1e-12)


def test_a_film_that_does_not_depend_on_wavelength_is_the_bare_face() -> None:
    """The table of no layers: sampled = averaged = no film, history by history but for what its nodes cost."""
    design = parse(Design, DESIGN | {"dbr_pairs": 0.0})
    nothing = film_table(dbr_of(Environment(), 0.0), Spectrum(), Grid(wavelengths=11))
    ledgers = []
    for spectrum, table in (("averaged", None), ("averaged", nothing), ("sampled", nothing)):
        environment = Environment.model_validate({"spectrum": spectrum})
        made = scene_of(environment, design, table, cell_of(environment, design))
        tally = MonteCarlo(made, 1).run_to(4 * BLOCK)
        ledgers.append((tally.ledger / tally.histories, tally.arrivals / tally.histories))
    assert len(made.chip.index) == nothing.wavelength_nm.size
    for found in ledgers[1:]:
        for part, bare in zip(found, ledgers[0], strict=True):
            error = np.hypot(part.std(axis=0, ddof=1), bare.std(axis=0, ddof=1)) / np.sqrt(GROUPS)
            assert np.all(np.abs(part.mean(axis=0) - bare.mean(axis=0)) <= 4.0 * error + 1e-12)


def test_without_pairs_both_readings_are_one_request() -> None:
    """No film, one wavelength: the same bits."""
    options: dict[str, Any] = {"film": None, "design": DESIGN | {"dbr_pairs": 0.0}, "exit_histories": 1}
    averaged = answered("averaged", **options)
    assert_same(averaged, answered("sampled", **options))
    assert set(averaged[1]["ray_wavelength_nm"]) == {np.float32(445.0)}


def test_the_readings_differ_by_little_where_light_leaves_soon() -> None:
    """Same seed: other bits; means within 1 %, uniformities within 2 points; stored exits and twin agree."""
    averaged, sampled = answered("averaged")[0], answered("sampled")[0]
    assert averaged["metrics"] != sampled["metrics"]
    mean, U = "mean_illuminance_lx", "uniformity"
    assert sampled["metrics"][mean]["value"] == pytest.approx(averaged["metrics"][mean]["value"], rel=0.01)
    assert sampled["metrics"][U]["value"] == pytest.approx(averaged["metrics"][U]["value"], abs=0.02)
    for options in ({"stored_exits": True}, {"method": "twin"}):
        other = answered("sampled", **options)[0]["metrics"][mean]
        one = sampled["metrics"][mean]
        reach = 4.0 * np.hypot(one["standard_error"], other["standard_error"])
        assert abs(one["value"] - other["value"]) <= reach + 0.003 * one["value"], options
