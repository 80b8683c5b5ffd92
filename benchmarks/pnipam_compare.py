"""A real measurement through the machinery of `compare`: a polymer brush on silicon, from wrong films to the right.

    python benchmarks/pnipam_compare.py [--data FOLDER]

psi and delta of the mean of four zones at seven angles (refnx/refellips demos, BSD 3-Clause; see pnipam_ladder.py for
where the file is looked for) as a data set of fourteen shots with four films; each film is fitted by the thin-film
worker through a real set of processes, and judged on angles that were left out of its fit.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from benchmarks.pnipam_ladder import DATA_FILE, Measured, data_folder, read_measured
from luxloop.client import Client
from luxloop.model_file import find_model
from luxloop.settings import load_settings
from validation.dataset.folder import read_dataset, write_sums
from validation.fit import CurveData, CurvesOf, Fit, fit
from validation.measured import MeasuredSpectrum
from validation.observed import Observed
from validation.prediction import Predictor
from validation.prediction.spectra import with_film_value

SIGMA_DEG = {"psi": 0.18, "delta": 0.13}
"""Spread of a zone about the mean of the zones."""
OXIDE = '{ material = "SiO2", thickness_nm = 1.5 }'
POLYMER = (
    "{ cauchy = [1.45, 0.005], thickness_nm = 30.0, free = { thickness_nm = [5.0, 80.0], a = [1.2, 1.8],"
    " b_um2 = [-0.05, 0.05] } }"
)
MIXED = "{ cauchy = [1.22, 0.0], thickness_nm = 2.0, free = { thickness_nm = [0.0, 20.0] } }"
FILMS = {
    "bare": "[]",
    "oxide": '[{ material = "SiO2", thickness_nm = 30.0, free = { thickness_nm = [0.0, 80.0] } }]',
    "polymer": f"[{POLYMER}, {OXIDE}]",
    "polymer-mixed": f"[{MIXED}, {POLYMER}, {OXIDE}]",
}
"""The light's side first; the last has a layer too many, half polymer and half air."""


def write(folder: Path, data: Measured, films: Mapping[str, str], sigma_deg: Mapping[str, float]) -> None:
    """The data set: films with their layers, each value with the same error."""
    first = next(iter(films))
    lines = ['schema = "luxloop-dataset/1"', 'name = "PNIPAM on silicon"', 'licence = "BSD-3-Clause"']
    for name, layers in films.items():
        lines += ["", "[[films]]", f'id = "{name}"', 'incident = "air"', 'exit = "Si"', f"layers = {layers}"]
    for place, angle in enumerate(data.aoi_deg):
        for quantity in ("psi", "delta"):
            values = getattr(data, f"{quantity}_deg").mean(axis=0)[:, place]
            file = f"{quantity}-{angle:g}.csv"
            rows = (f"{nm:g},{angle:g},,{value:.4f},{sigma_deg[quantity]:.4g}" for nm, value in
                    zip(data.wavelength_nm, values, strict=True))  # fmt: skip
            (folder / file).write_text("wavelength_nm,aoi_deg,polarisation,value,sigma\n" + "\n".join(rows) + "\n")
            lines += ["", "[[shots]]", f'id = "{quantity}-{angle:g}"', 'kind = "spectrum"', f'film = "{first}"',
                      f'quantity = "{quantity}"', f'file = "{file}"', "bandwidth_nm = 5.4"]  # fmt: skip
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n")
    write_sums(folder)


def fitted(observed: Observed, predictor: Predictor) -> Fit:
    """A film fitted to the shots."""
    found = {"others": observed.films, "start": observed.films_at, "predict_curves": CurvesOf(predictor)}
    return fit(find_model("paper"), (), predictor, free=(), curves=observed.curves, **found)


def spectrum_of(curve: CurveData) -> MeasuredSpectrum:
    """What a curve was made of."""
    assert isinstance(curve.source, MeasuredSpectrum)
    return curve.source


def left_out(observed: Observed, predictor: Predictor) -> float:
    """Chi2 per value on each angle, with the film fitted to the others."""
    chi2, count = 0.0, 0
    for angle in dict.fromkeys(one.id.split("-")[1] for one in observed.curves):
        own = [one for one in observed.curves if one.id.split("-")[1] == angle]
        others = [one for one in observed.curves if one not in own]
        found = fitted(replace(observed, curves=tuple(others)), predictor)
        film = spectrum_of(own[0]).film
        for parameter in observed.films:
            film = with_film_value(film, parameter.name, found.value(parameter.name))
        held = tuple(replace(one, source=replace(spectrum_of(one), film=film)) for one in own)
        there = fitted(replace(observed, curves=held, films=(), films_at={}), predictor)
        chi2, count = chi2 + there.chi2, count + there.residual.size
    return chi2 / count


def main() -> None:
    """Print the ladder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder(), help="folder of " + DATA_FILE)
    data = read_measured(parser.parse_args().data / DATA_FILE)
    with tempfile.TemporaryDirectory() as folder, Client(load_settings(), patience_s=300.0) as client:
        write(Path(folder), data, FILMS, SIGMA_DEG)
        dataset, predictor = read_dataset(folder), Predictor(client)
        print(f"{'film':14} {'free':>4} {'chi2/value':>11} {'left-out angles':>16}   fitted")
        for film in FILMS:
            observed = Observed.of(dataset, film=film)
            found = fitted(observed, predictor)
            values = ", ".join(
                f"{one.name.split('layers.')[1]} {found.value(one.name):.4g} +- {found.error(one.name):.1g}"
                for one in observed.films
            )
            apart = left_out(observed, predictor)
            row = f"{film:14} {len(observed.films):4d} {found.chi2 / found.residual.size:11.2f} {apart:16.2f}"
            print(f"{row}   {values}")


if __name__ == "__main__":
    main()
