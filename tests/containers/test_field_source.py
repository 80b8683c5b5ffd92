"""Where the fields of anchors come from: the same bits from memory, a folder or Monte Carlo, and no run twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from containers.ray_tracing import field_source, predictor
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.field import ModuleField
from containers.ray_tracing.field_source import FEWEST_STORED, FieldSource, code_key
from containers.ray_tracing.worker import RayComputation
from luxloop.words import sha256_of
from tests.containers.test_predictor import NINE, ask, nobody, request, same, shot

KEY = sha256_of("a module, its light, histories and seed")


def field(number: int = 1) -> ModuleField:
    """A small one, as a tally's bins give it."""
    bins = np.random.default_rng(number).random((4, 40, 40))
    return ModuleField.from_bins(bins, 1e6, (-500.0, 500.0, -500.0, 500.0), 160.0)


def same_field(one: ModuleField, other: ModuleField) -> bool:
    """Whether two fields are equal to the last bit."""
    assert one.tallied_variance is not None
    assert other.tallied_variance is not None
    arrays = (one.coefficients, other.coefficients), (one.tallied_variance, other.tallied_variance)
    numbers = [(f.x, f.y, f.histories, f.truncation, f.per_m2, type(f)) for f in (one, other)]
    return numbers[0] == numbers[1] and all(np.array_equal(a, b) for a, b in arrays)


def of(source: FieldSource, number: int = 1, histories: int = FEWEST_STORED) -> tuple[ModuleField, bool]:
    """The field under the key, and whether it was made for it."""
    made: list[int] = []

    def make() -> ModuleField:
        made.append(number)
        return field(number)

    return source.of(KEY, histories, make), bool(made)


def test_another_process_has_the_field_from_the_folder(tmp_path: Path) -> None:
    """To the last bit, as often as it is asked for; whether it has to be made is known before."""
    first, second = FieldSource(tmp_path), FieldSource(tmp_path)
    assert KEY not in first
    found, made = of(first)
    assert made
    assert KEY in second
    stored, made = of(second, number=2)
    assert not made
    assert same_field(found, stored)
    assert of(second)[0] is stored


def test_without_a_folder_it_is_kept_in_memory(tmp_path: Path) -> None:
    """And what took no time is not written into one."""
    source = FieldSource()
    found, _ = of(source)
    assert KEY in source
    assert of(source)[0] is found
    cheap = FieldSource(tmp_path)
    of(cheap, histories=FEWEST_STORED - 1)
    assert KEY in cheap
    assert list(tmp_path.iterdir()) == []


def test_what_other_code_has_made_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A field says what its code does: who mends a walk sees the mend."""
    of(FieldSource(tmp_path))
    monkeypatch.setattr(field_source, "code_key", lambda: "0" * 64)
    changed = FieldSource(tmp_path)
    assert KEY not in changed
    assert of(changed)[1]


def test_the_code_is_all_of_the_rooms_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Whatever file changes, or has another name, the key is another one."""
    for name, code in (("a.py", "x = 1"), ("walks/b.py", "y = 2")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(code)
    (tmp_path / "__init__.py").touch()
    monkeypatch.setattr(field_source.containers, "__file__", str(tmp_path / "__init__.py"))
    keys = [code_key.__wrapped__()]
    (tmp_path / "walks" / "b.py").write_text("y = 3")
    keys.append(code_key.__wrapped__())
    (tmp_path / "walks" / "b.py").rename(tmp_path / "walks" / "c.py")
    keys.append(code_key.__wrapped__())
    assert len(set(keys)) == 3
    assert code_key.__wrapped__() == keys[2]


def test_a_damaged_file_is_made_again(tmp_path: Path) -> None:
    """A bit that has turned, and a file cut short."""
    for damage in (lambda raw: raw[:-40] + bytes([raw[-40] ^ 1]) + raw[-39:], lambda raw: raw[: len(raw) // 2]):
        found, _ = of(FieldSource(tmp_path))
        (path,) = tmp_path.glob("*.fields")
        path.write_bytes(damage(path.read_bytes()))
        again, made = of(FieldSource(tmp_path))
        assert made
        assert same_field(found, again)
        assert not of(FieldSource(tmp_path), number=2)[1]
        path.unlink()


def test_a_folder_that_cannot_be_written_stands_in_nobodys_way(tmp_path: Path) -> None:
    """The field is made, and kept in memory."""
    (tmp_path / "file").touch()
    source = FieldSource(tmp_path / "file")
    found, made = of(source)
    assert made
    assert of(source)[0] is found


def test_a_second_worker_runs_no_monte_carlo_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What one process has run another has, to the last bit; what is not the same run is run."""
    asked: dict[str, Any] = {"anchor": {"histories": FEWEST_STORED, "seed": "3"}}
    exits, runs = ExitSource(), []
    field_of = predictor._Job._field

    def counted(*of_run: Any) -> ModuleField:
        runs.append(of_run)
        return field_of(*of_run)

    monkeypatch.setattr(predictor._Job, "_field", counted)

    def worker() -> RayComputation:
        return RayComputation(nobody, exits, fields=FieldSource(tmp_path))

    wanted = request(shot(NINE), **asked)
    found = ask(wanted, worker())
    assert len(runs) == 1
    same(ask(wanted, worker()), found)
    assert len(runs) == 1
    ask(request(shot(NINE, environment__chip_absorption_per_cm=210.0), **asked), worker())
    ask(request(shot(NINE), anchor={"histories": FEWEST_STORED, "seed": "4"}), worker())
    ask(request(shot(NINE), anchor={"histories": FEWEST_STORED + 100_000, "seed": "3"}), worker())
    assert len(runs) == 4
