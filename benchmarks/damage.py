"""What damage does to a journal: cut at every 97th byte, then 1,000 single bits flipped, one at a time.

python benchmarks/damage.py [steps] [flips] [seed]

Cuts: `recover` must give back every step whose acknowledgement came before the cut, byte for byte, and nothing that
was not written. Flips, in a finished run: `verify` must find each one that touches content; where one passes, what it
touches is named. A flip is counted as touching content where a record, metadata or an attachment reads differently.
"""

from __future__ import annotations

import random
import struct
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from shutil import rmtree

from mcap.opcode import Opcode

from benchmarks.journal import METADATA, Maker
from env_controller.audit.checks import exit_code, verify
from env_controller.audit.recover import recover
from luxloop.errors import InputError, LuxloopError
from luxloop.journal.chain import Link
from luxloop.journal.journal import Journal
from luxloop.journal.scan import Scan
from luxloop.journal.topics import Record

STEPS, FLIPS, SEED = 12, 1_000, 1
STRIDE_BYTES = 97
MAGIC_BYTES = 8
ATTACHMENTS = {"model.toml": b"name = 'benchmark'\n" * 40}
FOREIGN, CHANGED = -1, 5
AS_TOLD, ONE_MORE = "every acknowledged step, no more", "and the next one, whole but not acknowledged"
LOST, FALSE = "an acknowledged step is lost", "a record that was never written"
NAMES = {
    FOREIGN: "refused: it names another program",
    CHANGED: "found: exit 5",
    3: "found: exit 3",
    0: "passed: exit 0",
}


def main() -> None:
    """Print the tables."""
    steps, flips, seed = (
        int(given) for given in [*sys.argv[1:], *map(str, (STEPS, FLIPS, SEED)[len(sys.argv) - 1 :])]
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        written, flushed = write(folder / "run", steps)
        whole = (folder / "run" / "audit-0001.mcap").read_bytes()
        print(f"a journal of {steps} steps, {len(whole):,} bytes\n")
        cuts(folder / "cut", whole, written, flushed)
        bits(folder / "run", whole, random.Random(seed), flips, seed)


def write(folder: Path, steps: int) -> tuple[list[list[Record]], list[int]]:
    """The records of each step of a finished run, and the file's size when it was acknowledged."""
    journal, maker = Journal(folder, METADATA, ATTACHMENTS), Maker()
    written, flushed = [], []
    for number in range(steps):
        done = threading.Event()
        written.append(maker.records(number))
        journal.put(written[-1], lambda _, done=done: done.set())  # type: ignore[misc]
        done.wait()
        flushed.append((folder / "audit-0001.mcap").stat().st_size)
    journal.finish()
    journal.close()
    return written, flushed


def cuts(folder: Path, whole: bytes, written: list[list[Record]], flushed: list[int]) -> None:
    """Cut at every 97th byte: the steps that were acknowledged, and those that came back."""
    folder.mkdir()
    found: Counter[str] = Counter()
    codes: Counter[int] = Counter()
    began_s = time.perf_counter()
    for size in range(0, len(whole), STRIDE_BYTES):
        (folder / "audit-0001.mcap").write_bytes(whole[:size])
        saved = recover(folder, folder.parent / "saved")
        codes[saved.exit_code] += 1
        found[
            verdict_of(saved.out if saved.mark.records else None, written, sum(end <= size for end in flushed))
        ] += 1
        rmtree(saved.out, ignore_errors=True)
    wall_s = time.perf_counter() - began_s
    print(f"cut at every {STRIDE_BYTES}th byte: {sum(codes.values()):,} cuts, {wall_s:.1f} s")
    for what in (AS_TOLD, ONE_MORE, LOST, FALSE):
        print(f"  {what:<44}{found[what]:>8,}")
    print(f"  exit codes of recover: {', '.join(f'{code}: {count:,}' for code, count in sorted(codes.items()))}\n")


def verdict_of(saved: Path | None, written: list[list[Record]], acknowledged: int) -> str:
    """What came back, beside what was acknowledged before the cut."""
    records = [link for link in links(saved) if isinstance(link, Record)] if saved else []
    steps = len(records) // len(written[0])
    if records != [entry for of_step in written[:steps] for entry in of_step] or steps > acknowledged + 1:
        return FALSE
    return LOST if steps < acknowledged else AS_TOLD if steps == acknowledged else ONE_MORE


def bits(folder: Path, whole: bytes, draw: random.Random, flips: int, seed: int) -> None:
    """Flip a bit, verify; what was found, what passed, and what the flip had touched."""
    path = folder / "audit-0001.mcap"
    true, where = links(folder), regions(whole)
    found: dict[str, Counter[int]] = {}
    content: Counter[int] = Counter()
    false_saved, passed = 0, []
    began_s = time.perf_counter()
    for _ in range(flips):
        place, bit = draw.randrange(len(whole)), draw.randrange(8)
        damaged = bytearray(whole)
        damaged[place] ^= 1 << bit
        path.write_bytes(damaged)
        code = of_verify(folder)
        name = where(place)
        found.setdefault(name, Counter())[code] += 1
        content[code] += touched(folder, true)
        if code == 0:
            passed.append(f"byte {place:,} bit {bit} in {name}")
        false_saved += not saved_is_true(folder, true)
    wall_s = time.perf_counter() - began_s
    path.write_bytes(whole)
    codes = sorted({code for counts in found.values() for code in counts}, reverse=True)
    print(f"{flips:,} single bits flipped (seed {seed}): {wall_s:.1f} s")
    print(f"  {'in':<22}{'flips':>8}" + "".join(f"{NAMES.get(code, code):>36}" for code in codes))
    for name, counts in sorted(found.items(), key=lambda item: -item[1].total()):
        print(f"  {name:<22}{counts.total():>8,}" + "".join(f"{counts[code]:>36,}" for code in codes))
    total = sum(found.values(), Counter())
    print(f"  {'all':<22}{total.total():>8,}" + "".join(f"{total[code]:>36,}" for code in codes))
    print(
        f"  {'content read otherwise':<22}{content.total():>8,}" + "".join(f"{content[code]:>36,}" for code in codes)
    )
    print(f"  found: {100.0 * (flips - total[0]) / flips:.1f} % of all; of those that touch content "
          f"{100.0 * (1.0 - content[0] / max(content.total(), 1)):.1f} %")  # fmt: skip
    print(f"  recover gave back a record that was never written: {false_saved} times")
    for line in passed:
        print(f"  passed: {line}")


def of_verify(folder: Path) -> int:
    """The exit code of `audit verify`; -1 where the file is refused as another program's."""
    try:
        return exit_code(verify(folder, None, None))
    except InputError:
        return FOREIGN


def links(folder: Path) -> list[Link]:
    """All that the chain covers, as it reads."""
    return [link for commit in Scan(folder / "audit-0001.mcap") for link in commit.links]


def touched(folder: Path, true: list[Link]) -> bool:
    """Whether what the chain covers reads otherwise, or not to its end."""
    try:
        return links(folder) != true
    except LuxloopError:
        return True


def saved_is_true(folder: Path, true: list[Link]) -> bool:
    """Whether what `recover` gives back is how the run began."""
    try:
        saved = recover(folder, folder.parent / "saved")
    except InputError:
        return True
    found = links(saved.out) if saved.mark.records else []
    rmtree(saved.out, ignore_errors=True)
    return found == true[: len(found)]


def regions(whole: bytes) -> Callable[[int], str]:
    """A function that names what lies at a byte: the record's kind, and whether it is its head."""
    starts: list[tuple[int, str]] = [(0, "magic")]
    offset = MAGIC_BYTES
    while offset < len(whole) - MAGIC_BYTES:
        opcode, length = struct.unpack_from("<BQ", whole, offset)
        kind = Opcode(opcode).name.lower().replace("_", " ")
        starts.append((offset, kind))
        offset += 9 + length
    starts.append((offset, "magic"))
    return lambda place: next(kind for start, kind in reversed(starts) if start <= place)


if __name__ == "__main__":
    main()
