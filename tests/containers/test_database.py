"""The film database and its packed tables: what survives kills, damage and company, and what is refused."""

from __future__ import annotations

import contextlib
import hashlib
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as nst

from containers.thin_film import database as database_module
from containers.thin_film.database import PAGE_BYTES, SCHEMA, open_database
from containers.thin_film.packing import pack, unpack
from luxloop.errors import InputError


def key_of(number: int) -> str:
    """A request's key."""
    return hashlib.sha256(f"request {number}".encode()).hexdigest()


def table_of(number: int, size: int = 60_000) -> bytes:
    """The table of a request: anyone can compute it again."""
    return np.random.default_rng(number).bytes(size)


# Writes tables from a first number on and says so only after put returned.
WRITER = """
import sys
from pathlib import Path
from tests.containers.test_database import key_of, table_of
from containers.thin_film.database import open_database
first, count = int(sys.argv[2]), int(sys.argv[3])
with open_database(Path(sys.argv[1])) as database:
    print("open", flush=True)
    for number in range(first, first + count):
        database.put(key_of(number), table_of(number))
        print(number, flush=True)
"""


def writer(path: Path, first: int, count: int) -> subprocess.Popen[str]:
    """A process of its own that writes `count` tables."""
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", WRITER, str(path), str(first), str(count)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=root)


def healthy(path: Path) -> None:
    """SQLite finds its own file whole."""
    with contextlib.closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_what_is_put_is_got_by_key_and_by_hash(tmp_path: Path) -> None:
    """Also after the file was closed and opened again; an unknown key or hash is None."""
    path = tmp_path / "films.sqlite"
    with open_database(path) as database:
        sha256 = database.put(key_of(1), table_of(1))
        assert database.get(key_of(1)) == (sha256, table_of(1))
    with open_database(path) as database:
        assert sha256 == hashlib.sha256(table_of(1)).hexdigest()
        assert database.get(key_of(1)) == (sha256, table_of(1))
        assert database.blob(sha256) == table_of(1)
        assert database.get(key_of(2)) is None
        assert database.blob(key_of(2)) is None
        assert database.entries() == [(key_of(1), sha256, 60_000)]


def test_two_requests_with_one_table_share_its_bytes(tmp_path: Path) -> None:
    """A table is stored once, whatever number of keys lead to it; a key may later lead to another table."""
    with open_database(tmp_path / "films.sqlite", max_bytes=130_000) as database:
        for number in (1, 2, 3):
            database.put(key_of(number), table_of(7))
        assert {sha256 for _, sha256, _ in database.entries()} == {hashlib.sha256(table_of(7)).hexdigest()}
        database.put(key_of(2), table_of(8))
        assert database.get(key_of(2)) == (hashlib.sha256(table_of(8)).hexdigest(), table_of(8))
        assert len(database.entries()) == 3


def test_kill_9_in_the_middle_of_writes_loses_no_acknowledged_table(tmp_path: Path) -> None:
    """Six writers are killed at random moments: the file stays whole, every acknowledged table is there."""
    path, rng, acknowledged = tmp_path / "films.sqlite", random.Random(3), []
    for round_ in range(6):
        process = writer(path, 1000 * round_, 1000)
        assert process.stdout is not None
        assert process.stdout.readline() == "open\n"
        time.sleep(rng.uniform(0.0, 0.08))
        process.kill()
        process.wait()
        acknowledged += [int(line) for line in process.stdout.read().splitlines() if line]
        process.stdout.close()
    healthy(path)
    with open_database(path) as database:
        assert acknowledged
        for number in acknowledged:
            assert database.get(key_of(number)) == (hashlib.sha256(table_of(number)).hexdigest(), table_of(number))
        for key, sha256, _ in database.entries():
            held = database.get(key)
            assert held is not None
            assert hashlib.sha256(held[1]).hexdigest() == sha256
        assert database.corrupted == 0


def test_kill_9_while_the_file_is_made_leaves_one_that_opens(tmp_path: Path) -> None:
    """A process killed before or while it makes the tables leaves nothing that is taken for another program's."""
    for delay_ms in range(0, 400, 80):
        path = tmp_path / f"{delay_ms}.sqlite"
        process = writer(path, 0, 1)
        time.sleep(delay_ms / 1000)
        process.kill()
        process.communicate()
        with open_database(path) as database:
            assert database.put(key_of(0), table_of(0))


def test_a_new_file_that_another_process_is_about_to_write_is_waited_for(tmp_path: Path) -> None:
    """SQLite does not wait there, and a worker that started beside another one ended: "database is locked"."""
    path = tmp_path / "films.sqlite"
    other = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    other.execute("BEGIN IMMEDIATE")
    end = threading.Timer(0.3, other.execute, ("ROLLBACK",))
    end.start()
    with open_database(path) as database:
        assert database.put(key_of(0), table_of(0))
    end.join()
    other.close()
    healthy(path)


def test_two_processes_write_the_same_and_different_keys(tmp_path: Path) -> None:
    """Three writers open a new file at once, two on the same keys: all tables are there, none damaged."""
    path = tmp_path / "films.sqlite"
    writers = [writer(path, first, 40) for first in (0, 0, 20)]
    outputs = [process.communicate(timeout=60)[0].split() for process in writers]
    assert [process.returncode for process in writers] == [0, 0, 0]
    assert all(len(output) == 41 for output in outputs)
    healthy(path)
    with open_database(path) as database:
        assert len(database.entries()) == 60
        for number in range(60):
            assert database.get(key_of(number)) == (hashlib.sha256(table_of(number)).hexdigest(), table_of(number))


def test_threads_share_one_database(tmp_path: Path) -> None:
    """Four threads read and write through one object; each reads back what it wrote."""
    wrong: list[int] = []
    with open_database(tmp_path / "films.sqlite") as database:

        def work(first: int) -> None:
            for number in range(first, first + 15):
                database.put(key_of(number), table_of(number))
                held = database.get(key_of(number))
                if held is None or held[1] != table_of(number):
                    wrong.append(number)

        threads = [threading.Thread(target=work, args=(100 * k,)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert wrong == []
        assert len(database.entries()) == 60


def test_the_least_recently_used_tables_go_first(tmp_path: Path) -> None:
    """With room for three, reading the oldest saves it and the second goes; the bound holds."""
    with open_database(tmp_path / "films.sqlite", max_bytes=200_000) as database:
        for number in (1, 2, 3):
            database.put(key_of(number), table_of(number))
        assert database.get(key_of(1)) is not None
        database.put(key_of(4), table_of(4))
        assert {key for key, _, _ in database.entries()} == {key_of(1), key_of(3), key_of(4)}
        assert sum(size for _, _, size in database.entries()) <= 200_000
        assert database.corrupted == 0


def test_the_file_stays_bounded(tmp_path: Path) -> None:
    """Writing thirty times the bound leaves a file (with its log) below twice the bound plus 8 MB."""
    with open_database(tmp_path / "films.sqlite", max_bytes=2_000_000) as database:
        for number in range(300):
            database.put(key_of(number), table_of(number, 200_000))
        assert sum(file.stat().st_size for file in tmp_path.iterdir()) < 2 * 2_000_000 + (8 << 20)


def test_a_corrupted_entry_is_dropped_reported_and_replaced(tmp_path: Path) -> None:
    """One bit of a stored table is flipped on disk: get says None, counts it, and the new table takes its place."""
    path = tmp_path / "films.sqlite"
    with open_database(path) as database:
        database.put(key_of(1), table_of(1))
        database.put(key_of(2), table_of(2))
    raw = bytearray(path.read_bytes())
    place = raw.index(table_of(1)[20_000:20_100])
    raw[place] ^= 1
    path.write_bytes(raw)
    with open_database(path) as database:
        assert database.get(key_of(1)) is None
        assert database.corrupted == 1
        assert [key for key, _, _ in database.entries()] == [key_of(2)]
        database.put(key_of(1), table_of(1))
        assert database.get(key_of(1)) == (hashlib.sha256(table_of(1)).hexdigest(), table_of(1))


def test_damage_anywhere_never_gives_wrong_bytes_and_heals(tmp_path: Path) -> None:
    """With random bytes of the file overwritten, each entry is right or missing, or the file is refused; what is
    missing is put anew and is there then, whatever page was damaged: else each design with that film would fail."""
    path, rng, missing = tmp_path / "films.sqlite", random.Random(5), 0
    with open_database(path) as database:
        for number in range(20):
            database.put(key_of(number), table_of(number))
    whole = path.read_bytes()
    for _ in range(30):
        raw = bytearray(whole)
        for _ in range(40):
            raw[rng.randrange(len(raw))] = rng.randrange(256)
        path.write_bytes(raw)
        with contextlib.suppress(InputError), open_database(path) as database:
            for number in range(20):
                right = (hashlib.sha256(table_of(number)).hexdigest(), table_of(number))
                held = database.get(key_of(number))
                missing += held is None
                assert held in (None, right)
                database.put(key_of(number), table_of(number))
                assert database.get(key_of(number)) == right
                assert database.blob(right[0]) == right[1]
    assert missing > 0


def damaged_page(path: Path) -> None:
    """A file of six tables, the fourth of which goes on at a page that is not there."""
    with open_database(path) as database:
        for number in range(6):
            database.put(key_of(number), table_of(number))
    raw = bytearray(path.read_bytes())
    page = raw.index(table_of(3)[20_000:20_100]) // PAGE_BYTES * PAGE_BYTES
    raw[page : page + 4] = b"\xff\xff\xff\x0f"  # a page of overflow begins with the number of the next
    path.write_bytes(raw)


def test_a_file_with_a_damaged_page_is_begun_anew(tmp_path: Path) -> None:
    """SQLite can neither read nor drop that table: what is asked for is put again, and the file is whole. Another
    process that has it open goes on in the new one."""
    path = tmp_path / "films.sqlite"
    damaged_page(path)
    with open_database(path) as database, open_database(path) as other:
        assert other.get(key_of(5)) is not None
        assert database.get(key_of(3)) is None
        assert database.corrupted == 1
        assert database.entries() == other.entries() == []
        for number in range(6):
            other.put(key_of(number), table_of(number))
            assert database.get(key_of(number)) == (hashlib.sha256(table_of(number)).hexdigest(), table_of(number))
        assert (database.corrupted, other.corrupted) == (1, 0)
    healthy(path)


def test_a_damaged_file_that_another_process_writes_is_waited_for_no_longer_than_usual(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error is SQLite's own of a file that is in use; the next request finds it free, and begins it anew."""
    path = tmp_path / "films.sqlite"
    damaged_page(path)
    monkeypatch.setattr(database_module, "BUSY_S", 0.2)
    with open_database(path) as database, contextlib.closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(sqlite3.OperationalError, match="locked"):
            database.get(key_of(3))
        other.execute("ROLLBACK")
        assert database.get(key_of(3)) is None
        assert database.put(key_of(3), table_of(3))
    healthy(path)


def test_a_damaged_key_leads_to_no_other_table(tmp_path: Path) -> None:
    """Where the tree of keys is out of order a search may end beside what it looks for: no table is handed out under
    another's key, whatever bit of it was flipped, and each can be put again."""
    path, rng, missing = tmp_path / "films.sqlite", random.Random(2), 0
    with open_database(path) as database:
        for number in range(24):
            database.put(key_of(number), table_of(number, 400))
    whole = path.read_bytes()
    keys = [place for number in range(24) for place in places_of(whole, key_of(number).encode())]
    for _ in range(60):
        raw = bytearray(whole)
        raw[rng.choice(keys) + rng.randrange(-4, 64)] ^= 1 << rng.randrange(8)
        path.write_bytes(raw)
        with open_database(path) as database:
            for number in range(24):
                right = (hashlib.sha256(table_of(number, 400)).hexdigest(), table_of(number, 400))
                held = database.get(key_of(number))
                missing += held is None
                assert held in (None, right)
                if held is None:
                    database.put(key_of(number), table_of(number, 400))
                    assert database.get(key_of(number)) == right
    assert missing > 0


def places_of(raw: bytes, part: bytes) -> Iterator[int]:
    """Where a part begins in the bytes of a file."""
    place = raw.find(part)
    while place >= 0:
        yield place
        place = raw.find(part, place + 1)


def test_a_damaged_schema_is_refused_with_the_mend(tmp_path: Path) -> None:
    """A name of a column, or bytes that are no text, in what SQLite keeps of the tables."""
    path = tmp_path / "films.sqlite"
    open_database(path).close()
    whole = path.read_bytes()
    for wrong in (b"packes", b"pack\xff\xff"):
        path.write_bytes(whole.replace(b"packed", wrong))
        with pytest.raises(InputError, match=r"malformed.*move it away"):
            open_database(path)


def test_a_file_that_is_not_sqlite_is_refused_and_left_alone(tmp_path: Path) -> None:
    """The error names the file and the mend; the file is as it was."""
    path = tmp_path / "films.sqlite"
    path.write_bytes(b"not a database at all" * 1000)
    with pytest.raises(InputError, match=r"film database: got .*allowed: a SQLite file.*move it away") as caught:
        open_database(path)
    assert caught.value.value == str(path)
    assert path.read_bytes() == b"not a database at all" * 1000


def test_another_programs_database_is_refused_and_left_alone(tmp_path: Path) -> None:
    """A SQLite file with other tables is not written to, not even its journal mode."""
    path = tmp_path / "films.sqlite"
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE accounts (name TEXT)")
    before = path.read_bytes()
    with pytest.raises(InputError, match="another program"):
        open_database(path)
    assert path.read_bytes() == before


def test_a_database_of_a_newer_schema_is_refused(tmp_path: Path) -> None:
    """A file that a later release wrote is named with its schema and ours."""
    path = tmp_path / "films.sqlite"
    open_database(path).close()
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA user_version = {SCHEMA + 1}")
    with pytest.raises(InputError, match=rf"got 'schema {SCHEMA + 1}, .*allowed: schema {SCHEMA}"):
        open_database(path)


def test_a_folder_in_place_of_the_file_or_a_missing_folder_is_refused(tmp_path: Path) -> None:
    """Both are errors at the border that say what to choose instead."""
    (tmp_path / "films.sqlite").mkdir()
    for path in (tmp_path / "films.sqlite", tmp_path / "nowhere" / "films.sqlite"):
        with pytest.raises(InputError, match="folder you may write"):
            open_database(path)


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user of this machine can enter."""
    folder = Path(tempfile.mkdtemp(prefix="luxloop-test-"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def test_a_read_only_file_is_refused_when_it_is_opened(open_folder: Path) -> None:
    """A user without the right to write is told at once, not with the first table (root drops its rights first)."""
    path = open_folder / "films.sqlite"
    open_database(path).close()
    path.chmod(0o444)
    open_folder.chmod(0o555)
    script = """
import os, sys
from pathlib import Path
from containers.thin_film.database import open_database
from luxloop.errors import InputError
if os.geteuid() == 0:
    os.setuid(65534)
try:
    open_database(Path(sys.argv[1]))
except InputError as error:
    print(error)
"""
    command = [sys.executable, "-c", script, str(path)]
    answer = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=True)
    open_folder.chmod(0o755)
    assert "film database" in answer.stdout
    assert "readonly database" in answer.stdout or "unable to open" in answer.stdout
    assert "you may write" in answer.stdout


def test_a_database_that_sqlite_calls_read_only_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a read-only mount, where even root may not write: SQLite's own word is passed on."""
    path, connect = tmp_path / "films.sqlite", sqlite3.connect
    open_database(path).close()

    def read_only(database: Path, **options: object) -> sqlite3.Connection:
        return connect(f"file:{database}?mode=ro", uri=True, **options)  # type: ignore[call-overload]  # as handed on

    monkeypatch.setattr(sqlite3, "connect", read_only)
    with pytest.raises(InputError, match="attempt to write a readonly database; choose a file and folder you may"):
        open_database(path)


def test_bad_keys_and_too_large_tables_are_refused(tmp_path: Path) -> None:
    """Keys are SHA-256 in hex, a table fits the bound, the bound is above 0."""
    with pytest.raises(InputError, match="max_bytes"):
        open_database(tmp_path / "films.sqlite", max_bytes=0)
    with open_database(tmp_path / "films.sqlite", max_bytes=50_000) as database:
        with pytest.raises(InputError, match="table: got '60000 bytes'"):
            database.put(key_of(1), table_of(1))
        for key in ("", "xyz", key_of(1).upper(), key_of(1) + "0"):
            with pytest.raises(InputError, match="64 lower-case hex"):
                database.put(key, b"x")
            with pytest.raises(InputError, match="64 lower-case hex"):
                database.get(key)
        assert database.entries() == []


ARRAYS = st.dictionaries(
    st.text(min_size=1, max_size=8),
    st.sampled_from(["<f8", "<f4"]).flatmap(lambda kind: nst.arrays(kind, nst.array_shapes(max_dims=4, max_side=4))),
    max_size=4,
)
HEADERS = st.dictionaries(
    st.text(max_size=5), st.one_of(st.integers(-(2**50), 2**50), st.text(max_size=9)), max_size=4
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(header=HEADERS, arrays=ARRAYS)
def test_packing_and_unpacking_change_nothing(header: dict[str, object], arrays: dict[str, np.ndarray]) -> None:
    """Header and arrays come back bit for bit, with type and shape; the order of the dicts does not matter."""
    packed = pack(header, arrays)
    again, found = unpack(packed)
    assert again == header
    assert set(found) == set(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype
        assert found[name].shape == array.shape
        assert found[name].tobytes() == np.ascontiguousarray(array).tobytes()
    assert pack(dict(reversed(header.items())), dict(reversed(arrays.items()))) == packed


def test_big_endian_and_strided_arrays_pack_to_the_same_bytes() -> None:
    """The address depends on the numbers, not on how this machine holds them."""
    array = np.arange(12.0).reshape(3, 4)
    assert pack({}, {"a": array.astype(">f8")}) == pack({}, {"a": array}) == pack({}, {"a": np.asfortranarray(array)})


@settings(max_examples=150, deadline=None, derandomize=True)
@given(data=st.data())
def test_damaged_packed_bytes_are_refused_or_still_well_formed(data: st.DataObject) -> None:
    """Cut, lengthened or overwritten bytes raise InputError or unpack to arrays: never any other exception."""
    packed = bytearray(pack({"stack": "GaN | air"}, {"u": np.arange(5.0), "T": np.ones((2, 3), np.float32)}))
    for _ in range(data.draw(st.integers(1, 4))):
        packed[data.draw(st.integers(0, len(packed) - 1))] = data.draw(st.integers(0, 255))
    cut = bytes(packed[: data.draw(st.integers(0, len(packed)))])
    with contextlib.suppress(InputError):
        header, arrays = unpack(cut)
        assert isinstance(header, dict)
        assert all(isinstance(array, np.ndarray) for array in arrays.values())


def test_truncated_lengthened_and_strange_bytes_are_refused() -> None:
    """Each way of being no table gives an InputError; unknown types cannot be packed."""
    packed = pack({"a": 1}, {"u": np.arange(5.0)})
    for wrong in (b"", b"LXF1", packed[:-1], packed + b"\0", b"XXXX" + packed[4:], packed[:20], b"\0" * 100):
        with pytest.raises(InputError, match="table"):
            unpack(wrong)
    deep = b'{"arrays":[["u","<f8",[' + b"1," * 80 + b'1]]],"header":{}}'
    with pytest.raises(InputError, match="up to 8 axes"):
        unpack(b"LXF1" + len(deep).to_bytes(4, "little") + deep + b"\0" * 8)
    with pytest.raises(InputError, match="u: got"):
        pack({}, {"u": np.arange(3)})


def test_a_packed_table_is_read_only_and_aligned() -> None:
    """Arrays are views of the bytes: nobody can change what the hash stands for, and kernels find them aligned."""
    _, arrays = unpack(pack({"name": "odd length"}, {"a": np.ones(3, np.float32), "b": np.ones(2), "c": np.ones(1)}))
    assert all(array.flags.aligned and not array.flags.writeable for array in arrays.values())
