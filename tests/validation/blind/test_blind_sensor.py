"""The blind truth's sensor: expected signals with what is hidden in them, and raw numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.validation.blind.truths import CAMERA
from validation.blind import KINDS, Hidden, recorded, signals

LIGHT = [np.add.outer(np.linspace(0.1, 1.0, 24), np.linspace(0.0, 0.5, 24) ** 2) for _ in range(2)]
SENSOR = [name for name, kind in KINDS.items() if kind.place == "camera"]
WIDE = replace(CAMERA, rows=200, columns=200)


def test_signals_are_light_times_exposure_times_gain() -> None:
    """With all kinds off, bit for bit."""
    off = [Hidden(name, KINDS[name].off, 5) for name in SENSOR]
    for hidden in ([], off):
        first, second = signals(LIGHT, [2.0, 3.0], 800.0, CAMERA, hidden)
        np.testing.assert_array_equal(first, LIGHT[0] * (2.0 * 800.0))
        np.testing.assert_array_equal(second, LIGHT[1] * (3.0 * 800.0))


@pytest.mark.parametrize("name", SENSOR)
def test_what_is_hidden_changes_signals(name: str) -> None:
    """By 1 DN at least somewhere at the most, by a hundredth of that or so at a hundredth; a seed repeats it."""
    kind = KINDS[name]
    plain = signals(LIGHT, [2.0, 2.0], 1500.0, CAMERA)
    full, again, little = (
        signals(LIGHT, [2.0, 2.0], 1500.0, CAMERA, [Hidden(name, share * kind.most, 3)]) for share in (1.0, 1.0, 0.01)
    )
    change = max(float(np.abs(one - other).max()) for one, other in zip(full, plain, strict=True))
    small = max(float(np.abs(one - other).max()) for one, other in zip(little, plain, strict=True))
    assert change > 1.0
    assert 0.0 < small < 0.05 * change
    np.testing.assert_array_equal(full, again)


def test_rows_and_columns_go_where_they_should() -> None:
    """Columns are alike in all images and rows are not; smear goes along columns, crosstalk to the right."""
    even = [np.ones((24, 24))] * 2
    first, second = signals(even, [1.0, 1.0], 1000.0, CAMERA, [Hidden("column_gains", 0.02, 3)])
    np.testing.assert_array_equal(first, second)
    assert np.ptp(first, axis=0).max() == 0.0
    first, second = signals(even, [1.0, 1.0], 1000.0, CAMERA, [Hidden("row_banding", 20.0, 3)])
    assert np.ptp(first, axis=1).max() == 0.0
    assert np.abs(first - second).max() > 5.0
    spot = np.zeros((24, 24))
    spot[5, 12] = 1.0
    (smeared,) = signals([spot], [1.0], 1000.0, CAMERA, [Hidden("smear", 0.02)])
    np.testing.assert_allclose(smeared[:, 12] - 1000.0 * spot[:, 12], 20.0 / 24.0)
    (lagged,) = signals([spot], [1.0], 1000.0, CAMERA, [Hidden("one_way_crosstalk", 0.2)])
    assert lagged[5, 13] > lagged[5, 14] > 0.0
    assert lagged[5, 11] == 0.0
    assert lagged.sum() == pytest.approx(1000.0)


def test_raw_numbers_have_the_noise_of_emva_1288() -> None:
    """Mean s + black, variance K s + (K read)^2 + 1/12; twice the same for a seed, another for another image."""
    level = [np.full((200, 200), 1500.0)] * 2
    first, second = recorded(level, WIDE, [], seed=4)
    assert first.dtype == np.uint16
    assert first.mean() == pytest.approx(1564.0, abs=0.7)
    assert first.var() == pytest.approx(0.38 * 1500.0 + (0.38 * 6.0) ** 2 + 1.0 / 12.0, rel=0.03)
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(first, recorded(level, WIDE, [], seed=4)[0])


def test_raw_numbers_end_at_full_well_and_full_scale() -> None:
    """10,000 electrons at 0.38 DN each; 4,095 at most, 0 at least."""
    bright, dark = recorded([np.full((200, 200), 9e3), np.full((200, 200), -500.0)], WIDE, [], seed=1)
    assert bright.mean() == pytest.approx(3864.0, abs=1.0)
    assert dark.max() == 0
    higher = replace(WIDE, full_well_e=1e6)
    assert recorded([np.full((200, 200), 9e3)], higher, [], seed=1)[0].min() == 4095


def test_bad_signals_are_refused() -> None:
    """Another size, another count of exposures, no gain, no finite numbers."""
    with pytest.raises(ValueError, match="light"):
        signals([np.ones((3, 24))], [1.0], 1.0, CAMERA)
    with pytest.raises(ValueError, match="exposures_ms"):
        signals(LIGHT, [1.0], 1.0, CAMERA)
    with pytest.raises(ValueError, match="dn_per_ms"):
        signals(LIGHT, [1.0, 1.0], 0.0, CAMERA)
    with pytest.raises(ValueError, match="signals"):
        recorded([np.full((4, 4), np.nan)], CAMERA, [], seed=1)
