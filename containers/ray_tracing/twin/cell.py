"""The deterministic twin of the Monte Carlo solver: the same scene, smooth in every parameter, in milliseconds.

    stored exits --landed once, frozen numbers--> direct light --round trips reckoned--> all light

Direct light is traced (`direct`), so that neighbours, substrate and re-entry of direct light are what they are; what
the receiver sends back is reckoned (`closure`), and what chips do to it is measured by a few frozen rays (`shadow`).
The exits' own sampling error passes through: groups stay groups, and the fields carry their spread as any others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.exits import Exits
from containers.ray_tracing.field import Axis, CellField
from containers.ray_tracing.packing import emission_arrays
from containers.ray_tracing.tally import Box
from containers.ray_tracing.twin.closure import Leak, round_trip
from containers.ray_tracing.twin.direct import direct_light, lambertian_part, open_way
from containers.ray_tracing.twin.direct_kernel import ARRIVES, INSIDE, SEEN_MORE
from containers.ray_tracing.twin.shadow import correction, low_axis, periods_seen
from containers.scene import Cell, Receiver, Scene
from luxloop.errors import InputError

Real = NDArray[np.float64]

SEED = 20261121
"""Of all frozen random numbers."""


def cell_field(
    scene: Scene,
    exits: Exits,
    *,
    blocks: int | None = None,
    shadow: bool = True,
    seed: int = SEED,
    threads: int | None = None,
) -> CellField:
    """The field of a cell that repeats: relative illuminance, as `CellField.from_bins` gives it.

    Parameters
    ----------
    exits : of the scene's chip (with weights where they are another's). blocks : how many of their blocks to use.
    shadow : whether chips stand in the way of what the receiver sends back. seed : of all frozen random numbers.

    Raises
    ------
    InputError : a layout that does not repeat, or a substrate or receiver that the twin does not know.

    Notes
    -----
    (1 - rho_r (T + dT)) E = E0, E0 direct light and what of it comes up out of the substrate, T diagonal in the waves
    of the cell and dT between its lowest; the higher ones lose to the chips what the mean does. What is recorded
    differs from what arrives by response and plate.
    """
    if not isinstance(scene.layout, Cell):
        raise InputError("layout", type(scene.layout).__name__, "a cell that repeats", "use twin.module")
    spacing, receiver = scene.layout.spacing_um, scene.receiver
    way, emission = open_way(scene, Box.of(scene)), emission_arrays(scene)
    tally = direct_light(way, emission, exits, seed, blocks=blocks, threads=threads)

    layers = [tally.cell_field(layer, spacing, scene.height_um) for layer in range(tally.bins.shape[1])]
    arrives = layers[ARRIVES]
    window = cloud_window(arrives.x, tally.box.step_um), cloud_window(arrives.y, tally.box.step_um)
    cloud = 1.0 / np.multiply.outer(window[1], window[0])
    k = np.sqrt(np.add.outer(arrives.y.wavenumber_per_um**2, arrives.x.wavenumber_per_um**2))
    kept, _ = lambertian_part(receiver.bsdf)
    x, leak = k * scene.distance_um, Leak.of(scene)
    T = round_trip(scene.substrate, receiver, x, leak)
    low = low_axis(arrives.x, periods_seen(scene)), low_axis(arrives.y, periods_seen(scene))
    dT = correction(way, emission, *low, seed=seed, threads=threads) if shadow else None
    direct = np.stack([one.coefficients for one in layers], axis=1) * cloud
    if leak.share:
        up, seen = leak.comes_up(x, scene.substrate, receiver)
        direct = direct[:, :INSIDE] + direct[:, INSIDE, None] * np.stack([up, seen - up])
    total = _all_light(direct[:, ARRIVES], kept, T, dT, arrives)
    if direct.shape[1] > 1:
        more = round_trip(scene.substrate, receiver, x, leak, recorded=True) - T
        total = total + direct[:, SEEN_MORE] + kept * more * total
    return replace(arrives, coefficients=total * plate(receiver, k))


def cloud_window(axis: Axis, step_um: float) -> Real:
    """What sharing arrivals among neighbouring bins takes off each function of an axis, beside the bins' window."""
    return np.asarray(np.sinc(axis.wavenumber_per_um * step_um / (2.0 * np.pi)))


def plate(receiver: Receiver, k_per_um: Real) -> Real:
    """Transform of the spread in the receiver's plate: (1 - a) + a exp(-k^2 sd^2 / 2)."""
    a = receiver.spread_share
    return np.asarray(1.0 - a + a * np.exp(-0.5 * (k_per_um * receiver.spread_um) ** 2))


def _all_light(direct: Real, kept: float, T: Real, dT: Real | None, field: CellField) -> Real:
    """Coefficients (group, y, x) of all light from those of direct light."""
    if dT is None:
        return np.asarray(direct / (1.0 - kept * T))
    total = direct / (1.0 - kept * T * (1.0 + dT[0, 0] / max(T[0, 0], 1e-12)))
    row, column = np.ix_(_low(field.y, dT), _low(field.x, dT))
    matrix = np.eye(dT.shape[0]) - kept * (np.diag(T[row, column].ravel()) + dT)
    block = direct[:, row, column]
    total[:, row, column] = np.linalg.solve(matrix, block.reshape(len(direct), -1).T).T.reshape(block.shape)
    return np.asarray(total)


def _low(axis: Axis, dT: Real) -> NDArray[np.intp]:
    """Numbers of those functions of an axis that a correction is about."""
    count = round(len(dT) ** 0.5)
    modes = count // 2 if axis.kind == "periodic" else count - 1
    return np.flatnonzero(axis.wavenumber_per_um < axis.wavenumber_per_um[1] * (modes + 0.5))
