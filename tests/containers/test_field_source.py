"""Where the fields of anchors come from: the same bits from memory, a folder or Monte Carlo, and no run twice."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from containers import serve
from containers.ray_tracing import field_source, predictor
from containers.ray_tracing.array_store import ArrayStore
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.field import ModuleField
from containers.ray_tracing.field_source import FEWEST_STORED, FieldSource, code_key
from containers.ray_tracing.worker import RayComputation
from luxloop.computation import Progress
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


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A room of three files that stands in for `containers`."""
    folder = tmp_path / "room"
    (folder / "walks").mkdir(parents=True)
    for name, code in (("__init__.py", ""), ("a.py", "x = 1"), ("walks/b.py", "y = 2")):
        (folder / name).write_text(code)
    monkeypatch.setattr(field_source.containers, "__file__", str(folder / "__init__.py"))
    return folder


def test_what_other_code_has_made_is_not_taken(tmp_path: Path, room: Path) -> None:
    """A field says what its code does: who mends a walk sees the mend, who runs on with the old one keeps to it."""
    folder = tmp_path / "fields"
    before = FieldSource(folder)
    (room / "walks" / "b.py").write_text("y = 3")
    of(before)
    changed = FieldSource(folder)
    assert KEY not in changed
    assert of(changed)[1]
    assert len(list(folder.glob("*.fields"))) == 2
    (room / "walks" / "b.py").write_text("y = 2")
    assert not of(FieldSource(folder))[1]


def test_the_code_is_all_of_the_rooms_files_and_what_runs_it(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever file changes, or has another name, the key is another one; by other packages or processors too."""
    keys = [code_key()]
    (room / "walks" / "b.py").write_text("y = 3")
    keys.append(code_key())
    (room / "walks" / "b.py").rename(room / "walks" / "c.py")
    keys.append(code_key())
    monkeypatch.setattr(field_source, "version", lambda _: "9.9")
    keys.append(code_key())
    monkeypatch.setattr(field_source.binding, "get_host_cpu_name", lambda: "another")
    keys.append(code_key())
    assert len(set(keys)) == 5
    assert code_key() == keys[-1]


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


@pytest.mark.parametrize("odd", [
    {"coefficients": None}, {"tallied_variance": None}, {"x": None}, {"histories": None}, {"y": {"modes": 3}},
    {"coefficients": np.zeros((4, 3, 3))}, {"tallied_variance": np.zeros(4)},
    {"coefficients": np.full((4, 28, 28), np.nan)}, {"coefficients": np.zeros((4, 28, 28), np.float32)},
])  # fmt: skip
def test_a_file_that_holds_something_else_is_made_again(tmp_path: Path, odd: dict[str, Any]) -> None:
    """Hashed to its end, under the right name, and yet no field: nobody's request falls over it."""
    whole, source = field(), FieldSource(tmp_path)
    assert whole.tallied_variance is not None
    assert whole.coefficients.shape == (4, 28, 28)
    arrays = {"coefficients": whole.coefficients, "tallied_variance": whole.tallied_variance}
    header = {name: getattr(whole, name) for name in ("histories", "truncation", "per_m2")}
    parts: dict[str, Any] = {**arrays, **header, "x": vars(whole.x), "y": vars(whole.y)} | odd
    kept = {name: part for name, part in parts.items() if part is not None}
    ArrayStore(tmp_path, what="fields").put(
        source._stored(KEY),
        {name: part for name, part in kept.items() if name in arrays},
        {name: part for name, part in kept.items() if name not in arrays},
    )
    found, made = of(source)
    assert made
    assert same_field(found, whole)
    assert not of(FieldSource(tmp_path))[1]


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
    others = ({"exit_seed": "2"}, {"noise": False}, {"anchor": asked["anchor"] | {"stored_exits": True}})
    for number, other in enumerate(others):
        ask(request(shot(NINE), **asked | other), worker())
        assert len(runs) == 5 + number
    ask(request(shot(NINE), **asked | others[-1]), worker())  # the exits may be of other code
    assert len(runs) == 8


def test_what_is_known_is_read_before_what_is_made(tmp_path: Path) -> None:
    """A folder and a memory that hold one field lose it to the next one made."""
    known, new = shot(NINE), shot(NINE, design__distance_um=170.0)
    anchor, exits = {"histories": FEWEST_STORED}, ExitSource()
    ask(request(known, anchor=anchor), RayComputation(nobody, exits, fields=FieldSource(tmp_path)))
    (size,) = (path.stat().st_size for path in tmp_path.glob("*.fields"))
    tight, shares = FieldSource(tmp_path, int(1.5 * size)), list[float]()

    class Heard(Progress):
        """Progress as it is said, before it is bounded."""

        def report(self, ratio: float, note: str = "") -> None:
            shares.append(ratio)
            super().report(ratio, note)

    RayComputation(nobody, exits, fields=tight).compute(request(new, known, anchor=anchor), Heard())
    assert max(shares) <= 1.0
    assert len(list(tmp_path.glob("*.fields"))) == 1


def test_a_worker_that_is_served_has_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That of `luxloop serve ray-tracing`, beside the exits in the cache folder."""
    served: list[Any] = []
    monkeypatch.setenv("LUXLOOP_CACHE", str(tmp_path))
    monkeypatch.setattr(serve, "_serve", lambda _role, _settings, computation, *_: served.append(computation))
    serve.ray_tracing(quiet=True)
    (computation,) = served
    source = computation(SimpleNamespace())._predictor._fields
    of(source)
    assert [path.parent.name for path in tmp_path.rglob("*.fields")] == ["fields"]
