"""A measured polymer film on silicon: the error ladder, the noise of the data, and a layer that must be rejected."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.measured
BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "pnipam_ladder.py"


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    """The benchmark's models, data reader and fit, which these tests hold to the published figures."""
    spec = importlib.util.spec_from_file_location("pnipam_ladder", BENCHMARK)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # a dataclass looks its module up while it is made
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def measured(bench: Any) -> Any:
    """The film's psi and delta, 11 wavelengths x 7 angles x 4 zones."""
    file = bench.data_folder() / bench.DATA_FILE
    if not file.is_file():
        pytest.skip(f"no {bench.DATA_FILE} in $LUXLOOP_MEASURED_DATA or {bench.data_folder()}")
    return bench.read_measured(file)


@pytest.fixture(scope="module")
def short(measured: Any) -> Any:
    """The wavelengths that the silicon data of Aspnes reach, with which the published errors were found."""
    return measured.only(measured.wavelength_nm < 780.0)


@pytest.fixture(scope="module")
def rungs(bench: Any, short: Any) -> list[Any]:
    """All models fitted, silicon after Aspnes."""
    return list(bench.ladder(bench.silicon_aspnes, short))


def test_data_are_read_into_their_grid(measured: Any) -> None:
    """The first and last rows of the file lie where zone, wavelength and angle say."""
    assert measured.psi_deg.shape == measured.delta_deg.shape == (4, 11, 7)
    assert (measured.delta_deg[3, 0, 0], measured.psi_deg[3, 0, 0]) == (162.859, 41.174)
    np.testing.assert_array_equal(measured.aoi_deg, [40, 45, 50, 55, 60, 65, 70])


def test_errors_walk_the_published_ladder(rungs: list[Any]) -> None:
    """Bare silicon 251, SiO2 alone 1.69, polymer on native oxide 1.28 (1000 x rms of N, C, S)."""
    np.testing.assert_allclose([rung.error for rung in rungs[:3]], [251.4, 1.69, 1.28], rtol=3e-3)


def test_polymer_parameters_are_the_published_ones(rungs: list[Any]) -> None:
    """28.9 nm of n = 1.4528 + 0.0048 / um^2 on 1.5 nm of oxide."""
    apart = np.abs(rungs[2].parameters - [28.9, 1.4528, 0.0048])
    assert np.all(apart < [0.05, 1e-4, 5e-5])


def test_right_film_also_predicts_angles_that_it_was_not_fitted_to(rungs: list[Any]) -> None:
    """Left-out angles: polymer 1.39 against SiO2 1.72, so its two more parameters are no mere flexibility."""
    assert rungs[2].held_out < 0.85 * rungs[1].held_out
    assert rungs[2].held_out < 1.15 * rungs[2].error


def test_wrong_film_is_told_from_the_right_one_beyond_the_price(bench: Any, short: Any, rungs: list[Any]) -> None:
    """SiO2 -> polymer gains 47 in chi^2, five times the price of its parameters."""
    gain, price = bench.parameter_gain(rungs[1], rungs[2], short)
    assert gain > 4.0 * price


@pytest.mark.parametrize("source", ["aspnes", "franta"])
def test_rough_polymer_surface_is_rejected(bench: Any, short: Any, measured: Any, source: str) -> None:
    """A mixed polymer/air layer shrinks to 0 nm, gains no chi^2 and predicts left-out angles no better."""
    silicon, data = (bench.silicon_aspnes, short) if source == "aspnes" else (bench.material("Si").index, measured)
    smooth, rough = (bench.fit(model, silicon, data) for model in bench.MODELS[2:])
    gain, price = bench.parameter_gain(smooth, rough, data)
    assert rough.parameters[3] < 0.05
    assert gain < 0.01 * price
    assert rough.held_out > smooth.held_out * (1.0 - 1e-4)


def test_forced_roughness_raises_the_error(bench: Any, short: Any, rungs: list[Any]) -> None:
    """With 4 nm of mixed layer imposed on the fitted film the error rises well above that of the smooth film."""
    forced = np.append(rungs[2].parameters, 4.0)
    rough = bench.predict(bench.MODELS[3], forced, bench.silicon_aspnes, short)
    assert bench.rms_error(rough - short.ncs) > 1.5 * rungs[2].error


def test_residual_is_within_the_noise_of_the_zones(bench: Any, short: Any, rungs: list[Any]) -> None:
    """The polymer's error lies below the standard error of the mean of the zones, bare silicon's far above."""
    _, of_the_mean = bench.zone_noise(short)
    assert rungs[2].error < of_the_mean
    assert rungs[0].error > 100.0 * of_the_mean


def test_delta_of_the_model_has_the_sign_of_the_instrument(bench: Any, short: Any, rungs: list[Any]) -> None:
    """psi and delta themselves, not only N, C, S: within 0.25 and 0.6 deg of the mean of the zones everywhere."""
    ncs = bench.predict(bench.MODELS[2], rungs[2].parameters, bench.silicon_aspnes, short)
    psi, delta = bench.psi_delta_deg(ncs)
    assert np.abs(psi - short.psi_deg.mean(axis=0)).max() < 0.25
    assert np.abs(delta - short.delta_deg.mean(axis=0)).max() < 0.6
