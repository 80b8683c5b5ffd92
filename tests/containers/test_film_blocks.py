"""What a film measurement holds and works on at a time: its bits are the same, and it can be ended between."""

from __future__ import annotations

import numpy as np
import pytest

from containers.reporting import nothing
from containers.stack import dbr_of, resolve
from containers.thin_film import film_measurement
from containers.thin_film.film_measurement import measure
from containers.thin_film.incoherent import respond
from luxloop.model import Environment
from luxloop.stack import Layer, Medium, Stack
from tests.containers.test_film_measurement import AIR, AOI, GLASS, SILICON, slab


def test_light_keeps_nothing_but_itself() -> None:
    """As views of what was solved for, the 15 wavelengths of a line at a million places held 3 GB."""
    for stack in (slab(GLASS, 1e6), dbr_of(Environment(), 5.5)):
        light = respond(resolve(stack, [440.0, 450.0]), np.array([0.0, 0.5]))
        assert all(part.base is None for part in (light.R, light.T, light.ps))


@pytest.mark.parametrize("block", [1, 7, 64])
def test_what_is_worked_on_at_a_time_changes_no_bit(monkeypatch: pytest.MonkeyPatch, block: int) -> None:
    """Nor what is held of a line whose wavelengths are doubled: what is not held is computed again."""
    mirror = [Layer(medium=Medium(n=n), thickness_nm=126.0 / n) for n in (2.4, 1.46)] * 4
    cavity = *mirror, Layer(medium=Medium(n=1.46, k=1e-5), thickness_nm=5e3), *mirror[::-1]
    plate = Layer(medium=GLASS, thickness_nm=1e6, coherent=False)
    stack = Stack(inside=SILICON, layers=(plate, *cavity), outside=AIR)
    doubled: list[int] = []
    wave = np.linspace(500.0, 510.0, 9)
    refine = film_measurement._Line.refine
    monkeypatch.setattr(film_measurement._Line, "refine", lambda line: doubled.append(line.nodes) or refine(line))

    def found() -> list[bytes]:
        return [
            measure(stack, quantity, wave, AOI, bandwidth_nm=bandwidth_nm).tobytes()
            for bandwidth_nm in (0.0, 1.0)
            for quantity in ("R", "T", "psi")
        ]

    before = found()
    monkeypatch.setattr(film_measurement, "BLOCK", block)
    monkeypatch.setattr(film_measurement, "HELD_BYTES", 10_000)
    assert found() == before
    assert doubled


def test_a_measurement_is_ended_between_its_parts() -> None:
    """Whoever listens is called before each block of each wavelength of a line."""
    calls: list[int] = []
    stack = dbr_of(Environment(), 5.5)
    plain = measure(stack, "R", [445.0], [0.0], bandwidth_nm=5.0, report=nothing)
    assert measure(stack, "R", [445.0], [0.0], bandwidth_nm=5.0, report=lambda: calls.append(1)) == plain
    assert len(calls) >= 13
