"""The error ladder of a measured film: a polymer brush on silicon, walked from wrong models to the right one.

    python benchmarks/pnipam_ladder.py [--data FOLDER] [--plot FILE]

Data: `pnipam_on_silicon.dat` (imaging ellipsometer, refnx/refellips demos, BSD 3-Clause), searched in `--data`,
$LUXLOOP_MEASURED_DATA, ../shared/data. The error is 1000 x the root mean square of the differences in N, C, S between
model and the mean of the four zones. The film is fitted by scipy; the model is `measure_ncs`.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from containers.materials import material
from containers.stack import StackRows
from containers.thin_film.ellipsometry import ncs_of_psi_delta, psi_delta_deg
from containers.thin_film.film_measurement import RowsAt, interlayer, measure_ncs

Real = NDArray[np.float64]
Index = Callable[[Real], NDArray[np.complex128]]
ROOT = Path(__file__).resolve().parents[1]
DATA_FILE = "pnipam_on_silicon.dat"
OXIDE_NM = 1.5
"""Native oxide under the polymer, not fitted: its thickness and the polymer's cannot be told apart."""


@dataclass(frozen=True)
class Measured:
    """psi and delta in degrees as (zone, wavelength, aoi), and their N, C, S averaged over the zones."""

    wavelength_nm: Real
    aoi_deg: Real
    psi_deg: Real
    delta_deg: Real

    @property
    def zones(self) -> Real:
        """N, C, S as (zone, 3, wavelength, aoi)."""
        return np.moveaxis(ncs_of_psi_delta(self.psi_deg, self.delta_deg), 1, 0)

    @property
    def ncs(self) -> Real:
        """N, C, S (3, wavelength, aoi) of the mean psi and delta."""
        return ncs_of_psi_delta(self.psi_deg.mean(axis=0), self.delta_deg.mean(axis=0))

    def only(self, wavelengths: NDArray[np.bool_]) -> Measured:
        """The same at some of the wavelengths."""
        return Measured(
            self.wavelength_nm[wavelengths],
            self.aoi_deg,
            self.psi_deg[:, wavelengths],
            self.delta_deg[:, wavelengths],
        )


@dataclass(frozen=True)
class Model:
    """A rung: how the stack follows from the free parameters, where they start, and the least they may be."""

    name: str
    rows_at: Callable[[Real, Index], RowsAt]
    start: tuple[float, ...] = ()
    least: tuple[float, ...] = ()
    words: str = ""


@dataclass(frozen=True)
class Fit:
    """Best parameters, the error with them, and the error on angles that were left out of the fit in turn."""

    model: Model
    parameters: Real
    error: float
    held_out: float


def data_folder() -> Path:
    """Where measured data lie: $LUXLOOP_MEASURED_DATA, default ../shared/data beside the repository."""
    return Path(os.environ.get("LUXLOOP_MEASURED_DATA") or ROOT.parent / "shared" / "data")


def read_measured(file: Path) -> Measured:
    """The table of the instrument as arrays; every zone, wavelength and angle must be there once."""
    table = np.loadtxt(file)[:, :6]
    wavelength, aoi, zone = (np.unique(table[:, column]) for column in (0, 2, 5))
    order = np.lexsort((table[:, 2], table[:, 0], table[:, 5]))
    shape = (zone.size, wavelength.size, aoi.size)
    if len(table) != np.prod(shape):
        raise ValueError(f"{file}: {len(table)} rows do not fill {shape} (zone, wavelength, aoi)")
    delta, psi = (table[order, column].reshape(shape) for column in (3, 4))
    return Measured(wavelength, aoi, psi, delta)


def silicon_aspnes(wavelength_nm: Real) -> NDArray[np.complex128]:
    """n + ik of silicon after Aspnes and Studna at the instrument's wavelengths below 780 nm."""
    rows = json.loads((ROOT / "tests" / "golden" / "silicon_aspnes.json").read_text(encoding="utf-8"))["rows"]
    nm, n, k = np.array(rows).T
    return np.asarray(np.interp(wavelength_nm, nm, n) + 1j * np.interp(wavelength_nm, nm, k))


def film_on(silicon: Index, layers: list[tuple[Index, float]]) -> RowsAt:
    """Rows of smooth layers (index, thickness in nm), from the silicon outwards, in air; the last is the film."""

    def rows(wavelength_nm: Real) -> StackRows:
        media: list[Index] = [silicon, *(index for index, _ in layers), air]
        return StackRows(
            wavelength_nm=wavelength_nm,
            index=np.stack([index(wavelength_nm) for index in media], axis=1),
            thickness_nm=np.array([thickness for _, thickness in layers]),
            roughness_nm=np.zeros(len(layers) + 1),
            coherent=np.ones(len(layers), bool),
            film=np.arange(len(layers)) == len(layers) - 1,
        )

    return rows


def cauchy(a: float, b_um2: float) -> Index:
    """n = a + b / wavelength^2, wavelength in um."""
    return lambda wavelength_nm: np.asarray(a + b_um2 * 1e6 / wavelength_nm**2, complex)


def air(wavelength_nm: Real) -> NDArray[np.complex128]:
    """n = 1."""
    return np.ones(wavelength_nm.shape, complex)


def oxide(wavelength_nm: Real) -> NDArray[np.complex128]:
    """Fused silica."""
    return material("SiO2").index(wavelength_nm)


def polymer(p: Real, silicon: Index) -> RowsAt:
    """Silicon, native oxide, polymer of thickness p[0] nm and Cauchy index p[1] + p[2] / um^2."""
    return film_on(silicon, [(oxide, OXIDE_NM), (cauchy(p[1], p[2]), p[0])])


MODELS = (
    Model("bare silicon", lambda _, si: film_on(si, [])),
    Model("SiO2 only", lambda p, si: film_on(si, [(oxide, p[0])]), (30.0,), (0.0,), "SiO2 {:.2f} nm"),
    Model(
        "polymer on native oxide",
        polymer,
        (30.0, 1.45, 0.005),
        (0.0, 1.0, -0.1),
        "polymer {:.2f} nm, n = {:.4f} + {:.4f} / um^2",
    ),
    Model(
        "... with rough polymer/air",
        lambda p, si: interlayer(polymer(p, si), 2, p[3]),
        (30.0, 1.45, 0.005, 1.0),
        (20.0, 1.0, -0.1, 0.0),
        "polymer {:.2f} nm, n = {:.4f} + {:.4f} / um^2, mixed layer {:.2f} nm",
    ),
)


def rms_error(difference: Real) -> float:
    """1000 x root mean square of differences in N, C, S."""
    return float(1000.0 * np.sqrt(np.mean(difference**2)))


def predict(model: Model, parameters: Real, silicon: Index, data: Measured, bandwidth_nm: float = 0.0) -> Real:
    """N, C, S (3, wavelength, aoi) of a model at the wavelengths and angles of the data."""
    return measure_ncs(model.rows_at(parameters, silicon), data.wavelength_nm, data.aoi_deg, bandwidth_nm)


def best(model: Model, silicon: Index, data: Measured, angles: NDArray[np.bool_], bandwidth_nm: float = 0.0) -> Real:
    """Parameters of least squares in N, C, S over some of the angles."""
    if not model.start:
        return np.zeros(0)

    def residual(parameters: Real) -> Real:
        return (predict(model, parameters, silicon, data, bandwidth_nm) - data.ncs)[:, :, angles].ravel()

    scale = np.array([10.0, 0.1, 0.01, 1.0])[: len(model.start)]
    tight = {"xtol": 1e-12, "ftol": 1e-12, "gtol": 1e-12}
    return np.asarray(least_squares(residual, model.start, x_scale=scale, bounds=(model.least, np.inf), **tight).x)


def fit(model: Model, silicon: Index, data: Measured, bandwidth_nm: float = 0.0) -> Fit:
    """The model fitted to all angles, and its error on each angle when fitted to the others."""
    everywhere = np.ones(data.aoi_deg.size, bool)
    parameters = best(model, silicon, data, everywhere, bandwidth_nm)
    difference = predict(model, parameters, silicon, data, bandwidth_nm) - data.ncs
    left_out = []
    for angle in np.eye(data.aoi_deg.size, dtype=bool):
        others = best(model, silicon, data, ~angle, bandwidth_nm)
        left_out.append((predict(model, others, silicon, data, bandwidth_nm) - data.ncs)[:, :, angle])
    return Fit(model, parameters, rms_error(difference), rms_error(np.array(left_out)))


def zone_noise(data: Measured) -> tuple[float, float]:
    """Spread of a zone about the mean of the zones, and the standard error of that mean if zones were independent."""
    spread = data.zones - data.zones.mean(axis=0)
    count = len(data.zones)
    return rms_error(spread), rms_error(spread) / np.sqrt(count - 1)


def parameter_gain(simple: Fit, larger: Fit, data: Measured) -> tuple[float, float]:
    """chi^2 gained by the larger model, in units of the simple one's residual variance, and what it has to gain.

    The price is ln(points) for each parameter more (Bayesian information criterion); each measurement gives two
    independent numbers.
    """
    points = 2 * data.wavelength_nm.size * data.aoi_deg.size
    freedom = points - simple.parameters.size
    gain = freedom * (1.0 - (larger.error / simple.error) ** 2)
    return gain, (larger.parameters.size - simple.parameters.size) * float(np.log(points))


def ladder(silicon: Index, data: Measured, bandwidth_nm: float = 0.0) -> list[Fit]:
    """All rungs."""
    return [fit(model, silicon, data, bandwidth_nm) for model in MODELS]


def print_ladder(title: str, silicon: Index, data: Measured, bandwidth_nm: float = 0.0) -> list[Fit]:
    """The table of one choice of silicon and wavelengths."""
    fits = ladder(silicon, data, bandwidth_nm)
    print(f"\n{title}")
    print(f"  {'model':28} {'free':>4} {'error':>8} {'left-out angle':>14}   fitted")
    for one in fits:
        values = one.model.words.format(*one.parameters)
        print(f"  {one.model.name:28} {one.parameters.size:4d} {one.error:8.3f} {one.held_out:14.3f}   {values}")
    spread, mean = zone_noise(data)
    print(f"  zone noise: {spread:.3f} of one zone about the mean, {mean:.3f} of the mean if zones are independent")
    for simple, larger in ((fits[1], fits[2]), (fits[2], fits[3])):
        gain, price = parameter_gain(simple, larger, data)
        verdict = "accepted" if gain > price else "rejected"
        step = f"{simple.model.name} -> {larger.model.name}"
        print(f"  {step}: chi2 gain {round(gain, 2) + 0.0:.2f}, price {price:.2f}: {verdict}")
    return fits


def plot(file: Path, data: Measured, silicon: Index, fits: list[Fit]) -> None:
    """psi and delta against wavelength at every angle: zones as points, three models as lines."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11, 8), sharex=True, layout="constrained")
    colours = plt.get_cmap("viridis")(np.linspace(0, 0.9, data.aoi_deg.size))
    for fit_, style, width in zip(fits[:3], (":", "--", "-"), (1.0, 1.0, 1.3), strict=True):
        curves = psi_delta_deg(predict(fit_.model, fit_.parameters, silicon, data))
        for row, (curve, measured) in enumerate(zip(curves, (data.psi_deg, data.delta_deg), strict=True)):
            for a, colour in enumerate(colours):
                axes[row, 0].plot(data.wavelength_nm, curve[:, a], style, color=colour, lw=width)
                if fit_ is not fits[0]:
                    rest = measured[:, :, a].mean(axis=0) - curve[:, a]
                    axes[row, 1].plot(data.wavelength_nm, rest, style, color=colour, lw=width)
    for row, (name, measured) in enumerate((("psi", data.psi_deg), ("delta", data.delta_deg))):
        for a, colour in enumerate(colours):
            for zone in measured:
                axes[row, 0].plot(data.wavelength_nm, zone[:, a], ".", color=colour, ms=3)
            axes[row, 0].plot([], [], color=colour, label=f"{data.aoi_deg[a]:g} deg")
        axes[row, 0].set_ylabel(f"{name} (deg)")
        axes[row, 1].set_ylabel(f"{name}: mean of zones - model (deg)")
        axes[row, 1].axhline(0.0, color="0.7", lw=0.8)
        axes[1, row].set_xlabel("wavelength (nm)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=7)
    axes[0, 0].set_title("points: four zones; dotted: bare silicon", fontsize=10)
    axes[0, 1].set_title("dashed: SiO2 only; solid: polymer on native oxide", fontsize=10)
    figure.savefig(file, dpi=130)


def main() -> None:
    """Print the ladder for two sources of silicon data."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder(), help="folder of " + DATA_FILE)
    parser.add_argument("--plot", type=Path, help="picture of data and models (png, pdf, svg)")
    arguments = parser.parse_args()
    data = read_measured(arguments.data / DATA_FILE)
    short = data.only(data.wavelength_nm < 780.0)
    fits = print_ladder("silicon after Aspnes, 380 to 779 nm (his table ends at 827 nm)", silicon_aspnes, short)
    franta: Index = material("Si").index
    print_ladder("silicon after Franta (material Si), 380 to 779 nm", franta, short)
    print_ladder("silicon after Franta, 380 to 950 nm", franta, data)
    print_ladder("silicon after Franta, 380 to 950 nm, instrument line of 5.4 nm", franta, data, 5.4)
    if arguments.plot:
        plot(arguments.plot, short, silicon_aspnes, fits)
        print(f"\npicture: {arguments.plot}")


if __name__ == "__main__":
    main()
