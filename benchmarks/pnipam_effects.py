"""Which effect of the catalogue a real film lacks: a polymer on silicon, modelled without its native oxide.

    python benchmarks/pnipam_effects.py [--data FOLDER]

The model is refitted (thickness, Cauchy's a and b) with each effect of measured films in turn, its parameter free;
data, silicon after Aspnes and the error are those of pnipam_ladder.py. Gain: what chi^2 of the base model falls by,
in units of its residual variance, on all angles; left out: the error on angles that were left out of the fit in turn.
The last rows hold the polymer's thickness at what the ladder finds, as if another instrument had measured it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.pnipam_ladder import (
    DATA_FILE,
    OXIDE_NM,
    Index,
    Measured,
    cauchy,
    data_folder,
    film_on,
    oxide,
    read_measured,
    rms_error,
    silicon_aspnes,
)
from containers.acting import NONE, Effects
from containers.catalogue import Catalogue
from containers.thin_film.film_measurement import RowsAt, measure_ncs
from luxloop.effect import AppliedEffect

Real = NDArray[np.float64]
Case = tuple[str, str, dict[str, float | str]]
"""An effect, the parameter that is free, and the others."""
CASES: tuple[Case, ...] = (
    ("film_missing_layer", "thickness_nm", {"material": "SiO2", "face": "inner"}),
    ("film_missing_layer", "thickness_nm", {"material": "organic", "face": "outer"}),
    ("film_interlayer", "thickness_nm", {"face": "inner"}),
    ("film_interlayer", "thickness_nm", {"face": "outer"}),
    ("film_dispersion", "rise", {}),
    ("film_absorption_tail", "extinction", {"urbach_ev": 0.4}),
)
"""Effects on what lies there: those whose rows need no stack in words."""


@dataclass(frozen=True)
class Setting:
    """What of the polymer is known: limits of its thickness and of Cauchy's a and b, and whether it has its oxide."""

    title: str
    with_oxide: bool
    least: tuple[float, float, float] = (5.0, 1.0, -0.1)
    most: tuple[float, float, float] = (60.0, 2.0, 0.1)


SETTINGS = (
    Setting("without the native oxide", with_oxide=False),
    Setting("with it", with_oxide=True),
    Setting("without, thickness 28.92 nm known", False, (28.919, 1.0, -0.1), (28.921, 2.0, 0.1)),
    Setting("without, thickness and index known", False, (28.919, 1.4527, 0.00479), (28.921, 1.4529, 0.00481)),
)


def rows_of(p: Real, with_oxide: bool, effects: Effects) -> RowsAt:
    """The polymer on silicon under effects; a missing layer is told in rows, for silicon has no name here."""
    layers: list[tuple[Index, float]] = [(oxide, OXIDE_NM)] if with_oxide else []
    plain = film_on(silicon_aspnes, [*layers, (cauchy(p[1], p[2]), p[0])])
    return lambda wave: effects.rows(plain(wave))


def predictor(case: Case | None, with_oxide: bool) -> Callable[[Real, Measured], Real]:
    """N, C, S of the parameters, the effect's own last."""

    def predict(p: Real, data: Measured) -> Real:
        if case is None:
            rows = rows_of(p, with_oxide, NONE)
        elif case[0] == "film_missing_layer":
            index = oxide if case[2]["material"] == "SiO2" else cauchy(1.5, 0.0)
            layers: list[tuple[Index, float]] = [(oxide, OXIDE_NM)] if with_oxide else []
            layers += [(cauchy(p[1], p[2]), p[0])]
            layers.insert(len(layers) - (case[2]["face"] == "inner"), (index, float(p[3])))
            rows = film_on(silicon_aspnes, layers)
        else:
            applied = AppliedEffect(name=case[0], parameters=case[2] | {case[1]: float(p[3])})
            rows = rows_of(p, with_oxide, Catalogue().effects([applied], "benchmark"))
        return measure_ncs(rows, data.wavelength_nm, data.aoi_deg)

    return predict


def fitted(
    predict: Callable[[Real, Measured], Real],
    data: Measured,
    setting: Setting,
    limits: list[tuple[float, float]],
    used: NDArray[np.bool_],
) -> Real:
    """Least squares over the angles `used`."""
    low, high = ([*of, *(one[side] for one in limits)] for side, of in enumerate((setting.least, setting.most)))
    start = np.array([30.0, 1.4528, 0.0048, *(0.02 * one[1] for one in limits)])
    start = np.clip(start, np.array(low) + 1e-9, np.array(high) - 1e-9)
    scale = [10.0, 0.1, 0.01, *(one[1] / 10.0 for one in limits)]
    residual = lambda p: (predict(p, data) - data.ncs)[:, :, used].ravel()  # noqa: E731
    return np.asarray(least_squares(residual, start, bounds=(low, high), x_scale=scale, xtol=1e-10, ftol=1e-12).x)


def row(setting: Setting, case: Case | None, data: Measured, base: float) -> float:
    """Print one model; its error."""
    limits = []
    if case is not None:
        (spec,) = (one for one in Catalogue().specs if one.name == case[0])
        limits = [(float(p.lower or 0.0), float(p.upper or 0.0)) for p in spec.parameters if p.name == case[1]]
    predict, angles = predictor(case, setting.with_oxide), data.aoi_deg.size
    best = fitted(predict, data, setting, limits, np.ones(angles, bool))
    error, apart = rms_error(predict(best, data) - data.ncs), []
    for angle in np.eye(angles, dtype=bool):
        p = fitted(predict, data, setting, limits, ~angle)
        apart.append((predict(p, data) - data.ncs)[:, :, angle])
    points = 2 * data.wavelength_nm.size * angles - best.size
    gain = points * (1.0 - (error / base) ** 2) if base else 0.0
    name = " ".join([case[0], *map(str, case[2].values())]) if case is not None else "nothing"
    value = f", {case[1]} = {best[3]:.3g}" if case is not None else ""
    fit = f"{best[0]:.2f} nm, n = {best[1]:.4f} + {best[2]:.4f} / um^2{value}"
    print(f"  {name:38} {error:7.3f} {rms_error(np.array(apart)):8.3f} {gain:7.1f}   {fit}")
    return error


def main() -> None:
    """Print a table for each setting."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder(), help="folder of " + DATA_FILE)
    data = read_measured(parser.parse_args().data / DATA_FILE)
    data = data.only(data.wavelength_nm < 780.0)
    for setting in SETTINGS:
        print(f"\npolymer on silicon {setting.title}")
        print(f"  {'added':38} {'error':>7} {'left out':>8} {'gain':>7}   fitted")
        base = row(setting, None, data, 0.0)
        for case in CASES:
            row(setting, case, data, base)


if __name__ == "__main__":
    main()
