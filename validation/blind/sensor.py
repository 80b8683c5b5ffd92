"""What the sensor makes of light: expected signals, and raw numbers with their noise.

    light x exposure x gain + other light  --crosstalk, smear-->  --fields, gains-->  --bent, full wells, ripple-->
    + offsets of rows and columns = signal above black  --Poisson, full well, read noise, black, bits-->  raw image

Source of the noise: EMVA standard 1288, release 4.0, linear model. What is drawn for a camera is drawn from the
hidden seed alone; what is new in each image, from its number too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from validation.blind.kinds import acting
from validation.blind.words import Camera, Hidden, Real, within

Step = Callable[[Real, Camera, Hidden, int], Real]

TRANSFERS = 6
"""Pixels that a signal lags behind over; half of it each time."""
HOT, FLICKER_ROWS, RIPPLES, WELL = 6, 42.0, 4.0, 24.0


def signals_of(
    light: Sequence[Real], exposures_ms: Sequence[float], dn_per_ms: float, camera: Camera, hidden: Sequence[Hidden]
) -> list[Real]:
    """Expected signals in DN above black (row, column), one for each image; see `validation.blind.signals`."""
    there = acting(hidden)
    within("dn_per_ms", dn_per_ms, 1e-12, 1e12)
    if len(exposures_ms) != len(light):
        raise ValueError(f"exposures_ms: {len(exposures_ms)} for {len(light)} images: as many are needed")
    found = []
    for number, (image, exposure) in enumerate(zip(light, exposures_ms, strict=True)):
        within("exposures_ms", exposure, 1e-9, 1e9)
        if np.shape(image) != (camera.rows, camera.columns):
            raise ValueError(f"light: {np.shape(image)}: ({camera.rows}, {camera.columns}) is needed")
        signal = np.asarray(image, np.float64) * (exposure * dn_per_ms)
        for kind, step in STEPS.items():
            if kind in there:
                signal = step(signal, camera, there[kind], number)
        found.append(signal)
    return found


def recorded_of(
    signals: Sequence[Real], camera: Camera, hidden: Sequence[Hidden], seed: int
) -> list[NDArray[np.uint16]]:
    """Raw images (row, column) of one frame each; see `validation.blind.recorded`."""
    acting(hidden)
    within("seed", seed, 0, 2**63 - 1)
    return [_frame(signal, camera, np.random.default_rng((seed, 9, number))) for number, signal in enumerate(signals)]


def _frame(signal_dn: Real, camera: Camera, random: np.random.Generator) -> NDArray[np.uint16]:
    """One frame: what lies below black is an offset of the electronics and has no photons."""
    if np.ndim(signal_dn) != 2 or not np.isfinite(signal_dn).all():
        raise ValueError(f"signals: {np.shape(signal_dn)}: (row, column) of finite numbers are needed")
    electrons = np.minimum(random.poisson(np.maximum(signal_dn, 0.0) / camera.gain_dn_per_e), camera.full_well_e)
    dark = camera.gain_dn_per_e * camera.read_noise_e * random.standard_normal(signal_dn.shape)
    raw = camera.gain_dn_per_e * electrons + np.minimum(signal_dn, 0.0) + dark + camera.black_level_dn
    return np.clip(np.rint(raw), 0.0, camera.full_scale_dn).astype(np.uint16)


def drawn(hidden: Hidden, *more: int) -> np.random.Generator:
    """Random numbers of a hidden thing: of its seed, and of what they are for."""
    return np.random.default_rng((hidden.seed, 31, *more))


def _stray_daylight(signal: Real, camera: Camera, hidden: Hidden, _: int) -> Real:
    y, x = np.linspace(-1.0, 1.0, camera.rows), np.linspace(-1.0, 1.0, camera.columns)
    angle = 2.0 * np.pi * drawn(hidden).random()
    along = np.add.outer(np.sin(angle) * y, np.cos(angle) * x) / (abs(np.sin(angle)) + abs(np.cos(angle)))
    return np.asarray(signal + camera.room_dn * hidden.amount * (1.0 + np.sin(np.pi / 2.0 * along)))


def _smear(signal: Real, _: Camera, hidden: Hidden, __: int) -> Real:
    return np.asarray(signal + hidden.amount * signal.mean(axis=0))


def _one_way_crosstalk(signal: Real, _: Camera, hidden: Hidden, __: int) -> Real:
    share = 0.5 ** np.arange(1, TRANSFERS + 1)
    share *= hidden.amount / share.sum()
    found = (1.0 - hidden.amount) * signal
    for pixels, part in enumerate(share, 1):
        found[:, pixels:] += part * signal[:, :-pixels]
        found[:, :pixels] += part * signal[:, :1]  # as if the first column went on
    return found


def _interlace(signal: Real, _: Camera, hidden: Hidden, __: int) -> Real:
    found = np.array(signal)
    found[1::2] = ndimage.shift(signal, (0.0, hidden.amount), order=5, mode="mirror")[1::2]
    return found


def _tap_gain(signal: Real, camera: Camera, hidden: Hidden, _: int) -> Real:
    return np.asarray(signal * np.where(np.arange(camera.columns) < camera.columns // 2, 1.0, 1.0 + hidden.amount))


def _column_gains(signal: Real, camera: Camera, hidden: Hidden, _: int) -> Real:
    return np.asarray(signal * (1.0 + hidden.amount * drawn(hidden).standard_normal(camera.columns)))


def _flicker(signal: Real, camera: Camera, hidden: Hidden, number: int) -> Real:
    phase = 2.0 * np.pi * (np.arange(camera.rows) / FLICKER_ROWS + drawn(hidden, number).random())
    return np.asarray(signal * (1.0 + hidden.amount * np.sin(phase))[:, None])


def _bending_sensor(signal: Real, camera: Camera, hidden: Hidden, _: int) -> Real:
    share = np.maximum(signal, 0.0) / camera.room_dn
    return np.where(signal > 0.0, camera.room_dn * share ** (1.0 + hidden.amount), signal)


def _full_wells(signal: Real, camera: Camera, hidden: Hidden, _: int) -> Real:
    share = np.maximum(signal, 0.0) / camera.room_dn
    return np.asarray(signal * (1.0 + hidden.amount * share**WELL) ** (-1.0 / WELL))


def _adc_ripple(signal: Real, camera: Camera, hidden: Hidden, _: int) -> Real:
    return np.asarray(signal + hidden.amount * np.sin(2.0 * np.pi * RIPPLES * signal / camera.room_dn))


def _row_banding(signal: Real, camera: Camera, hidden: Hidden, number: int) -> Real:
    return np.asarray(signal + hidden.amount * drawn(hidden, number).standard_normal((camera.rows, 1)))


def _hot_columns(signal: Real, camera: Camera, hidden: Hidden, _: int) -> Real:
    found = np.array(signal)
    found[:, drawn(hidden).choice(camera.columns, min(HOT, camera.columns), replace=False)] += hidden.amount
    return found


def _black_sag(signal: Real, _: Camera, hidden: Hidden, __: int) -> Real:
    return np.asarray(signal - hidden.amount * signal.mean(axis=1, keepdims=True))


STEPS: dict[str, Step] = {
    "stray_daylight": _stray_daylight,
    "smear": _smear,
    "one_way_crosstalk": _one_way_crosstalk,
    "interlace": _interlace,
    "tap_gain": _tap_gain,
    "column_gains": _column_gains,
    "flicker": _flicker,
    "bending_sensor": _bending_sensor,
    "full_wells": _full_wells,
    "adc_ripple": _adc_ripple,
    "row_banding": _row_banding,
    "hot_columns": _hot_columns,
    "black_sag": _black_sag,
}
"""In the order in which they happen."""
