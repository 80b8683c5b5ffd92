"""Makes one file with large chunks of the segments of a run that has ended; what its chain covers stays as it is.

    audit-0001.mcap  audit-0002.mcap  audit-0003.mcap    ──▶    audit-0001.mcap, and segments-before/ with the three

The openings of later starts (metadata, attachments) stay in their places, so every link and every root is the same:
a root that left the machine still holds. The new file is compared with the old ones, commit by commit, before any of
them is moved. A compaction that was interrupted is ended by the next one.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from filecmp import cmp
from itertools import zip_longest
from pathlib import Path
from shutil import copy2
from typing import Any

from env_controller.audit.checks import verify
from env_controller.audit.recover import held, owner_of
from luxloop.errors import InputError, LuxloopError
from luxloop.journal.chain import Mark
from luxloop.journal.reader import SegmentReader, left_over, segments_of, tail_of
from luxloop.journal.scan import Commit, Scan
from luxloop.journal.segment import PATTERN, SegmentFile, sync_folder

CHUNK_BYTES = 1 << 20
BEFORE = "segments-before"


@dataclass(frozen=True)
class Compacted:
    """What became of a run's segments: how many, bytes before and after, how far the chain goes."""

    folder: Path
    segments: int
    before_bytes: int
    after_bytes: int
    mark: Mark
    kept_in: Path | None

    def document(self) -> dict[str, Any]:
        """As one object for machines."""
        return {
            "folder": str(self.folder),
            "segments": self.segments,
            "before_bytes": self.before_bytes,
            "after_bytes": self.after_bytes,
            "records": self.mark.records,
            "root": self.mark.root,
            "kept_in": str(self.kept_in) if self.kept_in else None,
        }


def compact(folder: Path, *, remove: bool = False, progress: Callable[[int], object] = lambda _: None) -> Compacted:
    """Merge the segments of the run in `folder`; the old ones go to `segments-before/`, with `remove` away.

    `progress` is told the bytes read. Raises InputError where there is no journal, where it is being written, not
    finished or damaged, or where `segments-before/` holds segments already; LuxloopError where the new file is not
    the same, which then is not used, or cannot be written.
    """
    paths = segments_of(folder)
    if not paths:
        raise InputError("RUN", str(folder), "the folder of a run with its journal", f"there is no {PATTERN} in it")
    with held(paths[-1]) as alone:
        if not alone:
            raise InputError("RUN", str(folder), "a run that has ended", f"end {owner_of(paths[-1])} first")
        ended = _end_interrupted(folder, paths)
        if ended is not None:
            return ended
        _refuse(folder, paths, remove)
        fresh = folder / f".{paths[0].name}.new"
        fresh.unlink(missing_ok=True)
        try:
            mark = _merge(paths, fresh, progress)
            _compare(paths, fresh)
            before_bytes, after_bytes = sum(map(_size, paths)), _size(fresh)
            kept_in = None if remove else _keep(paths, folder / BEFORE)
            _swap(paths, fresh)
        except OSError as error:
            mend = "make room there, and once more: no record is lost"
            raise LuxloopError(f"cannot write in {folder}: {error.strerror or error}; {mend}") from error
        finally:
            fresh.unlink(missing_ok=True)
    return Compacted(folder, len(paths), before_bytes, after_bytes, mark, kept_in)


def _refuse(folder: Path, paths: list[Path], remove: bool) -> None:
    broken = [finding for finding in verify(folder, None, None).findings if finding.verdict == "broken"]
    if broken:
        seen = f"{broken[0].what}: {broken[0].found}"
        mend = f"luxloop audit verify {folder} says all, audit recover saves what holds"
        raise InputError("RUN", seen, "a run that is what was written", mend)
    if SegmentReader(paths[-1]).index is None:
        mend = f"luxloop campaign resume {folder.name}, or luxloop audit recover {folder}"
        raise InputError("RUN", f"{paths[-1].name} was not finished", "a run that has ended", mend)
    if not remove and not all(same(path, folder / path.name) for path in (folder / BEFORE).glob(PATTERN)):
        mend = "move that away, or use --remove"
        raise InputError("RUN", str(folder / BEFORE), "a folder without the segments of an earlier time", mend)


def _commits(paths: list[Path], progress: Callable[[int], object] = lambda _: None) -> Iterator[Commit]:
    """The commits of several segments."""
    behind = 0
    for path in paths:
        scan = Scan(path)
        for commit in scan:
            yield commit
            progress(behind + scan.read_bytes)
        behind += _size(path)


def _merge(paths: list[Path], fresh: Path, progress: Callable[[int], object]) -> Mark:
    """Write all commits into one new file; how far the chain has come."""
    mark, file = Mark(), SegmentFile(fresh, CHUNK_BYTES)
    try:
        for commit in _commits(paths, progress):
            for link in (*commit.links, commit.checkpoint):
                file.add(link)
            file.spill()
            mark = commit.mark
        file.finish(mark)
    finally:
        file.close()
    return mark


def _compare(paths: list[Path], fresh: Path) -> None:
    """Raise LuxloopError where the new file does not hold just what the old ones do, with a chain that holds."""
    scan, mark = Scan(fresh), Mark()
    for old, new in zip_longest(_commits(paths), scan):
        if old != new or new is None or mark.then(new.links) != new.mark:
            raise LuxloopError(f"{fresh} differs from the segments after {mark.records:,} records; it was not used")
        mark = new.mark
    if not scan.finished or scan.final != mark:
        raise LuxloopError(f"{fresh} is not as it was written ({scan.fault}); it was not used")


def _keep(paths: list[Path], folder: Path) -> Path:
    """The old segments under their names in `folder` too; a copy where the file system has no second names."""
    folder.mkdir(exist_ok=True)
    for path in paths:
        if (folder / path.name).exists():  # of a compaction that was interrupted, and the same: `_refuse` looked
            continue
        try:
            os.link(path, folder / path.name)
        except OSError:
            _copy(path, folder / path.name)
    sync_folder(folder)
    return folder


def _copy(path: Path, to: Path) -> None:
    """A copy that has its name only once it is whole and on the disk: a part of one is no earlier segment."""
    part = to.with_name(f".{to.name}.part")
    try:
        copy2(path, part)
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(to)
    finally:
        part.unlink(missing_ok=True)


def _swap(paths: list[Path], fresh: Path) -> None:
    """The new file in the first one's place, then the others away: at no time is a record missing in the folder."""
    fresh.replace(paths[0])
    sync_folder(fresh.parent)
    for path in paths[1:]:
        path.unlink()
    sync_folder(fresh.parent)


def _end_interrupted(folder: Path, paths: list[Path]) -> Compacted | None:
    """Take away the segments that the first one holds already; None where there are none.

    An earlier compaction was interrupted when it had put its file in the first one's place. A start since then wrote
    under the number behind theirs, and gets the next one.
    """
    left = left_over(paths)
    if not left:
        return None
    kept_in = folder / BEFORE if (folder / BEFORE).is_dir() else None
    before_bytes = sum(map(_size, [*kept_in.glob(PATTERN)] if kept_in else left))
    for path in left:
        path.unlink()
    for number, path in enumerate(segments_of(folder), 1):
        path.rename(path.with_name(f"audit-{number:04}.mcap"))
    sync_folder(folder)
    return Compacted(folder, len(left) + 1, before_bytes, _size(paths[0]), tail_of(folder), kept_in)


def same(path: Path, other: Path) -> bool:
    """Whether both are there and hold the same bytes."""
    return path.is_file() and other.is_file() and cmp(path, other, shallow=False)


def _size(path: Path) -> int:
    return path.stat().st_size
