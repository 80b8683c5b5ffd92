"""A solved receiver as a result document and arrays: every number with its standard error, every array finite.

Illuminance is in lx by the environment's flux per chip; divided by `lx_per_unit` it is the field in its own unit.
Nothing here knows a clock or a thread: the same histories give the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.arrays import ENDS
from containers.ray_tracing.estimate import Estimate
from containers.ray_tracing.far_field import FarField, far_field
from containers.ray_tracing.field import CellField, Field
from containers.ray_tracing.light import light_of
from containers.ray_tracing.tally import OPTICAL_EVENTS, Tally
from containers.ray_tracing.uniformity import CUT_POINTS, Metrics, Region, array_region, cell_region, metrics_of
from containers.scene import Array, Scene
from luxloop.errors import InputError
from luxloop.model import Environment
from luxloop.photometry import illuminance_lx

Real = NDArray[np.float64]
Document = dict[str, Any]
Arrays = dict[str, NDArray[Any]]

SLAB_POINTS = 1 << 16
"""Points of the map that are worked out at once, for all groups."""


@dataclass(frozen=True)
class Solved:
    """What a tally says of a scene: the field on its receiver, and where it is judged."""

    scene: Scene
    tally: Tally | None
    """What full histories or landed exits left; None of the twin, which follows only part of the light."""
    field: Field
    region: Region

    @property
    def chips(self) -> float:
        """Nominal chips that shine: what the flux of one chip is to be multiplied by."""
        return float(self.scene.layout.power.sum()) if isinstance(self.scene.layout, Array) else 1.0

    @property
    def half_um(self) -> tuple[float, float]:
        """Half widths (x, y) of the cell, or of the module up to its edge."""
        layout = self.scene.layout
        return (layout.half_x_um, layout.half_y_um) if isinstance(layout, Array) else self.region.half_width_um


def solved(scene: Scene, tally: Tally) -> Solved:
    """The field of a tally. Raises InputError where its bins cannot tell it."""
    return Solved(scene, tally, light_of(tally, scene), region_of(scene))


def region_of(scene: Scene) -> Region:
    """Where the receiver of a scene is judged."""
    layout = scene.layout
    if isinstance(layout, Array):
        return array_region(layout.rows, layout.columns, layout.spacing_um, (layout.half_x_um, layout.half_y_um))
    return cell_region(layout.spacing_um)


def outcome(found: Solved, environment: Environment, map_bins: int) -> tuple[Document, Arrays]:
    """The numbers and the map of a solved receiver.

    Raises
    ------
    InputError : too few histories to say anything of the uniformity.
    """
    tally = found.tally
    efficiency = _mean_of(tally.ledger[:, ENDS.index("receiver")] / tally.histories) if tally is not None else None
    metrics = metrics_of(
        found.field,
        found.region,
        flux_per_chip_w=environment.flux_per_chip_w,
        peak_nm=environment.peak_nm,
        fwhm_nm=environment.fwhm_nm,
        optical_efficiency=efficiency,
    )
    irradiance = environment.flux_per_chip_w * found.field.per_m2
    lx = float(illuminance_lx(irradiance, environment.peak_nm, environment.fwhm_nm))
    half_x, half_y = found.half_um
    result = {
        "histories": tally.total_histories if tally is not None else found.field.histories,
        "groups": found.field.groups,
        "metrics": metrics_document(metrics),
        "region": metrics.region,
        **(_books(tally) if tally is not None else {}),
        "lx_per_unit": lx,
        "unit": "relative illuminance" if isinstance(found.field, CellField) else "1/mm2 per flux of a chip",
        "map": {"x_um": [-half_x, half_x], "y_um": [-half_y, half_y]},
        "cut": {"y_um": found.region.line_y_um, "window_um": [float(x) for x in found.region.line_um[[0, -1]]]},
    }
    return result, _map(found, map_bins, lx) | _cut(found, lx)


def _books(tally: Tally) -> Document:
    """Where the light ended, and how it came to the receiver."""
    return {
        "ledger": _by_name(ENDS, tally.ledger, tally.histories),
        "ledger_defect": tally.ledger_defect,
        "optical_events": _by_name(OPTICAL_EVENTS, tally.arrivals, tally.histories),
    }


def metrics_document(metrics: Metrics) -> Document:
    """Each metric with its standard error, the bias that was taken off, and the bound on what was truncated."""
    named = {one.name: getattr(metrics, one.name) for one in fields(metrics)}
    return {name: _plain(one) for name, one in named.items() if isinstance(one, Estimate)}


def far_fields(found: Solved, *, fold: bool) -> tuple[Document, Arrays]:
    """Far field of a chip (whole sphere) and of the module (upper half), in 1/sr per flux of one chip.

    The chip's is the light that leaves chips and has not yet been at the receiver, as often as it does; the module's
    is the light that comes to the receiver for the first time. `fold`: the scene has the symmetries of a square.
    """
    tally = found.tally
    if tally is None:
        raise InputError("far_field", True, "false with method = twin", "use monte_carlo")
    weights, upper = tally.directions * found.chips, tally.directions.shape[2] // 2
    both = {
        "chip": far_field(weights[:, 0], tally.histories, -1.0),
        "module": far_field(weights[:, 1, upper:], tally.histories, 0.0),
    }
    document: Document = {}
    arrays: Arrays = {}
    for name, one in both.items():
        far = one.folded() if fold else one
        document[name] = _far_document(far, found.chips)
        arrays |= _far_arrays(f"far_{name}", far)
    return document, arrays


def _far_document(far: FarField, chips: float) -> Document:
    flux, error = far.flux()
    return {"lowest_cos": far.lowest_cos, "flux_ratio": {"value": flux / chips, "standard_error": error / chips}}


def _far_arrays(name: str, far: FarField) -> Arrays:
    """The map of directions, and the curve against theta."""
    curve = far.curve()
    return {
        f"{name}_per_sr": far.intensity_per_sr,
        f"{name}_error_per_sr": far.standard_error_per_sr,
        f"{name}_curve_theta_rad": curve.theta_rad,
        f"{name}_curve_per_sr": curve.intensity_per_sr,
        f"{name}_curve_error_per_sr": curve.standard_error_per_sr,
    }


def _map(found: Solved, bins: int, lx: float) -> Arrays:
    """Illuminance at the centres of equal squares, `bins` along the longer side, and its standard error."""
    half_x, half_y = found.half_um
    columns, rows = (max(2, round(bins * half / max(half_x, half_y))) for half in (half_x, half_y))
    x_um, y_um = (half * ((np.arange(n) + 0.5) * 2.0 / n - 1.0) for half, n in ((half_x, columns), (half_y, rows)))
    means, errors = [], []
    for slab in np.array_split(y_um, max(1, rows * columns // SLAB_POINTS)):
        values = found.field.grid(x_um, slab)
        means.append(values.mean(axis=0))
        errors.append(values.std(axis=0, ddof=1) / np.sqrt(found.field.groups))
    return {
        "map_lx": np.float32(lx) * np.concatenate(means).astype(np.float32),
        "map_error_lx": np.float32(lx) * np.concatenate(errors).astype(np.float32),
    }


def _cut(found: Solved, lx: float) -> Arrays:
    """Illuminance along the line of Eq. 8, from edge to edge."""
    x_um = np.linspace(-found.half_um[0], found.half_um[0], CUT_POINTS)
    values = lx * found.field.line(x_um, found.region.line_y_um)
    error = values.std(axis=0, ddof=1) / np.sqrt(found.field.groups)
    return {"cut_x_um": x_um, "cut_lx": values.mean(axis=0), "cut_error_lx": error}


def _by_name(names: tuple[str, ...], weights: Real, histories: int) -> Document:
    """Shares of the emitted light by name, from weights (group, name)."""
    return {
        name: {key: value for key, value in _plain(_mean_of(column / histories)).items() if key in SHARE}
        for name, column in zip(names, weights.T, strict=True)
    }


SHARE = ("value", "standard_error")


def _mean_of(groups: Real) -> Estimate:
    """The mean over groups (group,) and its standard error."""
    return Estimate(float(groups.mean()), float(groups.std(ddof=1) / np.sqrt(groups.size)), 0.0, groups.size)


def _plain(one: Estimate) -> Mapping[str, float]:
    return {
        "value": one.value,
        "standard_error": one.standard_error,
        "bias": one.bias,
        "truncation": one.truncation,
    }
