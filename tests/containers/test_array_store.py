"""Stored arrays: what is read is what was put, or nothing; no kill, damage, rival or full disk makes it otherwise."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from containers.ray_tracing.array_store import MAGIC, WRITING, ArrayStore
from luxloop.errors import InputError

ENDING = ".arrays"
HEADER = {"chip": "W 28 um", "seed": "7", "count": 5}
FILE_BYTES = 1_000_000


def key(number: int) -> str:
    """The key of some inputs."""
    return hashlib.sha256(f"inputs {number}".encode()).hexdigest()


def arrays(number: int = 0, count: int = 1000) -> dict[str, NDArray[Any]]:
    """Exits as a worker would compute them: a function of the inputs alone."""
    rng = np.random.default_rng(number)
    return {
        "position_um": rng.random((count, 3), np.float32),
        "weight": rng.random(count),
        "bottom_hits": rng.integers(0, 99, count, np.uint16),
    }


def large(number: int) -> dict[str, NDArray[Any]]:
    """One array of `FILE_BYTES`."""
    return {"x": np.full(FILE_BYTES // 8, float(number))}


def same(found: dict[str, NDArray[Any]] | None, put: dict[str, NDArray[Any]]) -> bool:
    """Whether names, order, dtypes, shapes and all bits are equal."""
    return found is not None and [(name, a.dtype, a.shape, a.tobytes()) for name, a in found.items()] == [
        (name, a.dtype, a.shape, a.tobytes()) for name, a in put.items()
    ]


def names(folder: Path, ending: str = ENDING) -> set[str]:
    """The keys of the files in a folder."""
    return {path.stem for path in folder.glob("*" + ending)}


# --- what is put is what is read


def test_another_process_would_read_what_was_put(tmp_path: Path) -> None:
    """A store opened afresh finds arrays and header bit for bit."""
    assert ArrayStore(tmp_path).put(key(1), arrays(1), HEADER)
    fresh = ArrayStore(tmp_path)
    assert same(fresh.get(key(1)), arrays(1))
    assert fresh.header(key(1)) == HEADER
    assert fresh.problem == ""


def test_an_absent_key_is_not_there(tmp_path: Path) -> None:
    """None for arrays and header, and no problem is noted."""
    store = ArrayStore(tmp_path)
    assert store.get(key(1)) is None
    assert store.header(key(1)) is None
    assert (store.problem, store.damaged) == ("", 0)


@settings(derandomize=True, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    hnp.arrays(
        st.sampled_from(["<f8", "<f4", ">f8", "<i8", "<u2", "|b1", "<f2", ">i4"]),
        hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    )
)
def test_any_numbers_in_any_shape_come_back(tmp_path: Path, array: NDArray[Any]) -> None:
    """Shapes with a zero, scalars, nan and big-endian input: same bits, little-endian."""
    store = ArrayStore(tmp_path)
    store.put(key(0), {"a": array, "b": array.T}, {})
    found = store.get(key(0))
    assert found is not None
    for name, put in (("a", array), ("b", array.T)):
        assert found[name].shape == put.shape
        assert found[name].tobytes() == put.astype(put.dtype.newbyteorder("<")).tobytes()
        assert found[name].dtype == put.dtype.newbyteorder("<")


def test_what_is_read_cannot_be_changed(tmp_path: Path) -> None:
    """Arrays are read-only views of the mapped file, aligned for vector instructions."""
    store = ArrayStore(tmp_path)
    store.put(key(1), arrays(1), HEADER)
    for array in (store.get(key(1)) or {}).values():
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
        assert array.ctypes.data % 64 == 0


def test_equal_inputs_make_equal_files(tmp_path: Path) -> None:
    """The file is a function of key, header and arrays: no clock, no process in it."""
    for name in ("a", "b"):
        ArrayStore(tmp_path / name).put(key(1), arrays(1), HEADER)
    (a,), (b,) = (list((tmp_path / name).iterdir()) for name in ("a", "b"))
    assert a.read_bytes() == b.read_bytes()


def test_the_hash_at_the_end_is_over_everything_before_it(tmp_path: Path) -> None:
    """Any tool can verify a file."""
    ArrayStore(tmp_path).put(key(1), arrays(1), HEADER)
    raw = (tmp_path / (key(1) + ENDING)).read_bytes()
    assert raw.startswith(MAGIC)
    assert hashlib.sha256(raw[:-32]).digest() == raw[-32:]


def test_arrays_outlive_their_file(tmp_path: Path) -> None:
    """What a worker holds stays right after another process evicted it."""
    store = ArrayStore(tmp_path)
    store.put(key(1), arrays(1), HEADER)
    found = store.get(key(1))
    (tmp_path / (key(1) + ENDING)).unlink()
    assert same(found, arrays(1))
    assert store.get(key(1)) is None


# --- damage


def flipped(offset: int) -> Callable[[bytes], bytes]:
    """One bit turned at an offset, negative from the end."""
    return lambda raw: bytes(byte ^ (k == offset % len(raw)) for k, byte in enumerate(raw))


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "magic": flipped(0),
    "version": flipped(7),
    "header length": flipped(8),
    "header length beyond the file": flipped(15),
    "header": flipped(20),
    "first array": flipped(1000),
    "last array": flipped(-40),
    "hash": flipped(-1),
    "cut in the hash": lambda raw: raw[:-1],
    "cut in an array": lambda raw: raw[: len(raw) // 2],
    "cut in the header": lambda raw: raw[:40],
    "cut in the magic": lambda raw: raw[:3],
    "empty": lambda _: b"",
    "longer": lambda raw: raw + b"\0",
    "zeroed, same length": lambda raw: bytes(len(raw)),
    "foreign text": lambda raw: b"W,T,pairs\n" * (len(raw) // 10),
    "foreign, but hashed": lambda _: b"x" * 100 + hashlib.sha256(b"x" * 100).digest(),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE.keys())
def test_a_damaged_file_is_removed_and_computed_again(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    """Whatever region is hit: no arrays, the file is gone, it is counted, and the next put is found."""
    ArrayStore(tmp_path).put(key(1), arrays(1), HEADER)
    path = tmp_path / (key(1) + ENDING)
    path.write_bytes(damage(path.read_bytes()))
    told: list[str] = []
    store = ArrayStore(tmp_path, warn=told.append)
    assert store.get(key(1)) is None
    assert not path.exists()
    assert store.damaged == 1
    assert told == [store.problem]
    assert store.put(key(1), arrays(1), HEADER)
    assert same(store.get(key(1)), arrays(1))


def test_a_file_under_another_key_is_not_taken(tmp_path: Path) -> None:
    """A renamed file is whole and still not what its name says."""
    store = ArrayStore(tmp_path)
    store.put(key(1), arrays(1), HEADER)
    (tmp_path / (key(1) + ENDING)).rename(tmp_path / (key(2) + ENDING))
    assert store.get(key(2)) is None
    assert store.damaged == 1


def test_a_file_replaced_after_it_was_verified_is_hashed_again(tmp_path: Path) -> None:
    """Verified is the file that was seen, not its name."""
    store = ArrayStore(tmp_path)
    store.put(key(1), arrays(1), HEADER)
    assert same(store.get(key(1)), arrays(1))
    path = tmp_path / (key(1) + ENDING)
    other = tmp_path / "other"
    other.write_bytes(flipped(-40)(path.read_bytes()))
    other.replace(path)
    assert store.get(key(1)) is None


# --- the bound


def test_the_least_recently_used_go_first(tmp_path: Path) -> None:
    """With room for three, a get saves the oldest from the fourth, and the next oldest goes."""
    store = ArrayStore(tmp_path, max_bytes=int(3.5 * FILE_BYTES))
    for number in range(3):
        store.put(key(number), large(number), {})
    assert store.get(key(0)) is not None
    store.put(key(3), large(3), {})
    assert names(tmp_path) == {key(0), key(2), key(3)}
    store.put(key(4), large(4), {})
    assert names(tmp_path) == {key(0), key(3), key(4)}


def test_a_set_that_was_evicted_comes_back_as_it_was(tmp_path: Path) -> None:
    """Put, evicted, put again: the same file, bit for bit."""
    store = ArrayStore(tmp_path, max_bytes=int(1.5 * FILE_BYTES))
    store.put(key(0), large(0), HEADER)
    first = (tmp_path / (key(0) + ENDING)).read_bytes()
    assert store.get(key(0)) is not None
    store.put(key(1), large(1), HEADER)
    assert not store._verified  # what is gone is not remembered for ever
    assert store.get(key(0)) is None
    assert store.get(key(1)) is not None
    (tmp_path / (key(1) + ENDING)).unlink()  # as another process does
    assert store.get(key(1)) is None
    assert not store._verified
    store.put(key(0), large(0), HEADER)
    assert (tmp_path / (key(0) + ENDING)).read_bytes() == first


def test_a_set_above_the_bound_is_not_kept_and_evicts_nothing(tmp_path: Path) -> None:
    """One large set does not sweep the store out."""
    store = ArrayStore(tmp_path, max_bytes=FILE_BYTES // 2)
    assert store.put(key(1), arrays(1), HEADER)
    assert not store.put(key(2), large(2), {})
    assert "may hold" in store.problem
    assert names(tmp_path) == {key(1)}


def test_a_smaller_bound_holds_from_the_start(tmp_path: Path) -> None:
    """A store opened with less room takes away what is too much; other files in the folder stay."""
    (tmp_path / "notes.txt").write_text("mine")
    for number in range(3):
        ArrayStore(tmp_path).put(key(number), large(number), {})
    ArrayStore(tmp_path, max_bytes=int(1.5 * FILE_BYTES))
    assert names(tmp_path) == {key(2)}
    assert (tmp_path / "notes.txt").read_text() == "mine"


# --- other processes


CHILD = """
import sys
from pathlib import Path
import numpy as np
from containers.ray_tracing.array_store import ArrayStore
from tests.containers.test_array_store import FILE_BYTES, key, large, same
folder, work = Path(sys.argv[1]), sys.argv[2]
"""


def child(folder: Path, work: str, code: str) -> subprocess.Popen[bytes]:
    """A real process that works on a store in `folder`."""
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    return subprocess.Popen([sys.executable, "-c", CHILD + code, str(folder), work], env=environment)


ENDLESS = """
store = ArrayStore(folder)
array = np.full(4_000_000, float(work))
number = 0
while True:
    store.put(key(number % 4), {"x": array}, {})
    number += 1
"""


def wait_for(condition: Callable[[], object]) -> None:
    """Until it is true; fails after a minute."""
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.0005)


def in_the_middle_of_a_write(folder: Path) -> bool:
    """Whether a file is begun and not whole."""
    sizes = []
    for path in folder.glob(WRITING + "*"):
        try:
            sizes.append(path.stat().st_size)
        except FileNotFoundError:  # renamed meanwhile
            continue
    return any(0 < size < 32_000_000 for size in sizes)


def test_a_killed_writer_leaves_nothing_half_done(tmp_path: Path) -> None:
    """SIGKILL in the middle of writes, three times: every visible file is whole, and the leftover is cleaned away."""
    leftovers = 0
    for attempt in range(3):
        process = child(tmp_path, str(attempt), ENDLESS)
        wait_for(lambda: names(tmp_path) and in_the_middle_of_a_write(tmp_path))
        process.send_signal(signal.SIGKILL)
        process.wait()
        leftovers += len(list(tmp_path.glob(WRITING + "*")))
        store = ArrayStore(tmp_path)
        assert list(tmp_path.glob(WRITING + "*")) == []
        for name in names(tmp_path):
            found = store.get(name)
            assert found is not None
            assert found["x"].shape == (4_000_000,)
            assert np.ptp(found["x"]) == 0.0
        assert store.damaged == 0
    assert leftovers > 0


def test_a_living_writer_is_left_alone(tmp_path: Path) -> None:
    """Opening a store takes away only files whose writer is dead: the lock tells."""
    store = ArrayStore(tmp_path)
    file, path = store._new_file()
    with file:
        ArrayStore(tmp_path)
        assert path.exists()
    ArrayStore(tmp_path)
    assert not path.exists()


RIVAL = """
store = ArrayStore(folder, max_bytes=int(4.5 * FILE_BYTES))
rng = np.random.default_rng(int(work))
for number in rng.integers(0, 8, 60).tolist():
    found = store.get(key(number))
    assert found is None or same(found, large(number)), number
    if found is None:
        assert store.put(key(number), large(number), {}), store.problem
assert store.damaged == 0, store.problem
"""


def test_two_processes_share_a_folder(tmp_path: Path) -> None:
    """Both put, get and evict at once: each reads only what is right, and the bound holds in the end."""
    processes = [child(tmp_path, str(number), RIVAL) for number in range(2)]
    assert [process.wait() for process in processes] == [0, 0]
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 4.5 * FILE_BYTES
    assert list(tmp_path.glob(WRITING + "*")) == []


# --- a disk that cannot


FULL = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
store = ArrayStore(folder)
assert store.put(key(0), large(0), {})
resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_BYTES // 2, FILE_BYTES // 2))
assert not store.put(key(1), large(1), {})
assert "not kept" in store.problem, store.problem
assert same(store.get(key(0)), large(0))
assert store.get(key(1)) is None
"""


def test_a_write_that_fails_half_way_keeps_nothing(tmp_path: Path) -> None:
    """A real failing write (the size limit of a process): False, a problem, no leftover, the rest goes on."""
    assert child(tmp_path, "", FULL).wait() == 0
    assert names(tmp_path) == {key(0)}
    assert list(tmp_path.glob(WRITING + "*")) == []


def test_a_folder_that_cannot_be_made_stops_nobody(tmp_path: Path) -> None:
    """A file where the folder should be: put keeps nothing, get finds nothing, and the store says why."""
    (tmp_path / "file").write_text("")
    told: list[str] = []
    store = ArrayStore(tmp_path / "file" / "exits", warn=told.append)
    assert not store.put(key(1), arrays(1), HEADER)
    assert store.get(key(1)) is None
    assert len(told) >= 2
    assert "cannot be used" in told[0]


READ_ONLY = """
import os
if os.geteuid() == 0:
    os.setuid(65534)  # nothing is read-only to root
store = ArrayStore(folder)
assert same(store.get(key(0)), large(0)), store.problem
assert not store.put(key(1), large(1), {})
assert "not kept" in store.problem, store.problem
"""


def test_a_read_only_store_is_read() -> None:
    """What is there is found though its use cannot be noted; what is new is not kept."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ArrayStore(folder).put(key(0), large(0), {})
        folder.chmod(0o555)
        process = child(folder, "", READ_ONLY)
        assert process.wait() == 0
        assert names(folder) == {key(0)}
        folder.chmod(0o755)


# --- bad input


@pytest.mark.parametrize("bad", ["", "abc", "A" * 64, "../" + "a" * 61, "g" * 64])
def test_a_key_is_a_hash(tmp_path: Path, bad: str) -> None:
    """Nothing else names a file."""
    with pytest.raises(InputError, match="SHA-256"):
        ArrayStore(tmp_path).put(bad, arrays(), HEADER)
    with pytest.raises(InputError, match="SHA-256"):
        ArrayStore(tmp_path).get(bad)


@pytest.mark.parametrize(
    ("put", "header", "field"),
    [
        ({"a": np.array([object()])}, {}, r"arrays\.a"),
        ({"a": np.array(["word"])}, {}, r"arrays\.a"),
        ({"a": np.array([1j])}, {}, r"arrays\.a"),
        ({}, {"when": object()}, "header"),
        ({}, {"x": float("nan")}, "header"),
        ({}, {"x": "y" * (1 << 20)}, "header"),
    ],
)
def test_what_has_no_place_in_a_file_is_refused(tmp_path: Path, put: Any, header: Any, field: str) -> None:
    """Objects, words, complex numbers, headers that are no JSON or too long; nothing is written."""
    with pytest.raises(InputError, match=field):
        ArrayStore(tmp_path).put(key(1), put, header)
    assert list(tmp_path.iterdir()) == []


def test_a_bound_is_above_zero(tmp_path: Path) -> None:
    """A store of no bytes is a mistake."""
    with pytest.raises(InputError, match="max_bytes"):
        ArrayStore(tmp_path, max_bytes=0)
