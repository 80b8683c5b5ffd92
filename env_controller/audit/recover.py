"""Saves what a damaged or unfinished journal still holds: all that was committed before it breaks off.

    recover(run, out)        # the segments of `run` are read, those in `out` are new; nothing of `run` is touched

What is written has the links and roots of what was read, as far as that goes, so a root that left the machine still
holds. The chain ends where a batch is missing or cannot be read: what lies behind it, in that file or in later ones,
cannot be shown to belong to what lies before and is not passed off as good. It stays in the original.
"""

from __future__ import annotations

import errno
import fcntl
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from env_controller.audit.checks import how_left, read_side_file
from luxloop.errors import InputError, LuxloopError
from luxloop.journal.chain import Mark
from luxloop.journal.reader import SegmentReader, left_over, number_of, segments_of
from luxloop.journal.scan import Commit, Scan
from luxloop.journal.segment import PATTERN, SIDE_FILE, SegmentFile, sync_folder, write_side_file

WHOLE, FAILED, LOSS, CHANGED = 0, 1, 3, 5
FINISHED = "finished"


@dataclass
class Part:
    """One segment: how many of its records were saved, up to which byte it was read, how many are behind that."""

    file: str
    records: int = 0
    read_bytes: int = 0
    left_bytes: int = 0
    found: str = ""


@dataclass
class Recovery:
    """What was saved where, how far the chain goes, what is lost, and what is not what was written."""

    folder: Path
    out: Path
    mark: Mark = field(default_factory=Mark)
    parts: list[Part] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    changed: list[str] = field(default_factory=list)
    segments: int = 0
    kept: Mark | None = None
    kept_met: bool = False
    kept_fault: str = ""
    replaced: bool = False

    @property
    def exit_code(self) -> int:
        """0 nothing was missing, 1 nothing saved, 3 saved with loss, 5 what was read is not what was written."""
        if self.changed:
            return CHANGED
        if not self.mark.records:
            return FAILED
        return LOSS if self.lost else WHOLE

    @property
    def sound(self) -> bool:
        """Whether nothing was wrong: all is saved, and every segment has its end."""
        return self.exit_code == WHOLE and all(part.found == FINISHED for part in self.parts)

    def document(self) -> dict[str, Any]:
        """As one object for machines."""
        return {
            "folder": str(self.folder),
            "out": str(self.out),
            "replaced": self.replaced,
            "exit": self.exit_code,
            "records": self.mark.records,
            "root": self.mark.root,
            "segments": [asdict(part) for part in self.parts],
            "lost": self.lost,
            "changed": self.changed,
        }


def recover(folder: Path, out: Path | None = None) -> Recovery:
    """Write what can be read of the run in `folder` into `out`, else into `<run>-recovered` beside it.

    Raises InputError where there is no journal, where it is being written (naming by whom), where a file is another
    program's, and where `out` holds something already; LuxloopError where `out` cannot be written: nothing is left.
    """
    out = out or folder.resolve().with_name(f"{folder.resolve().name}-recovered")
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise InputError("--out", str(out), "a folder that is empty or not there", "name another by --out")
    with alone(folder) as paths, whole_or_nothing(out, "make room there, or name another folder by --out"):
        return save(folder, out, paths)


@contextmanager
def alone(folder: Path) -> Iterator[list[Path]]:
    """The segments of a run that nobody else writes, or begins to write, while inside."""
    paths = segments_of(folder)
    if not paths:
        raise InputError("RUN", str(folder), "the folder of a run with its journal", f"there is no {PATTERN} in it")
    with held(paths[-1]) as nobody_else:
        if not nobody_else:
            raise InputError("RUN", str(folder), "a run that nobody writes", f"end {owner_of(paths[-1])} first")
        yield paths


@contextmanager
def held(path: Path) -> Iterator[bool]:
    """While inside, the segment seems to be written, so that nobody else goes on with the run; False where it is.

    Over a network a lock of one's own is only for files opened for writing, and another's may be told as a refusal.
    """
    with _for_writing(path) as file:
        yield _locked(file)


def _locked(file: BinaryIO) -> bool:
    """Whether this process holds the file now, or nobody can, where the file system has no locks."""
    for lock in (fcntl.LOCK_EX, fcntl.LOCK_SH):
        try:
            fcntl.flock(file, lock | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            return False
        except OSError as error:
            if error.errno != errno.EBADF:
                return True  # else the lock is for files opened for writing, which this one may not be
        else:
            return True
    return True


def _for_writing(path: Path) -> BinaryIO:
    """A file opened to be changed, or to be read where it may not be; nothing of it is changed by that."""
    try:
        return path.open("r+b")
    except OSError:
        return path.open("rb")


@contextmanager
def whole_or_nothing(out: Path, mend: str) -> Iterator[None]:
    """Makes `out`; what was begun in it goes away where it does not come to its end."""
    there = out.is_dir()
    try:
        out.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException as error:
        with suppress(OSError):
            empty(out)
            if not there:
                out.rmdir()
        if isinstance(error, OSError):
            raise LuxloopError(f"cannot write {out}: {error.strerror or error}; {mend}") from error
        raise


def empty(folder: Path) -> None:
    """Remove all that lies in a folder."""
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def save(folder: Path, out: Path, paths: list[Path]) -> Recovery:
    """Write what can be read of these segments into `out`, which goes away where that is nothing."""
    recovery = Recovery(folder, out)
    _kept(recovery)
    _save_all(paths, recovery)
    if recovery.mark.records:
        write_side_file(out, recovery.mark)
    else:
        out.rmdir()
    return recovery


def owner_of(path: Path) -> str:
    """Who writes a segment, as far as its opening says."""
    facts: dict[str, str] = {}
    with suppress(LuxloopError):
        facts = dict(SegmentReader(path).opening[0]).get("environment", {})
    return f"the controller that writes it (process {facts.get('pid', '?')} on {facts.get('host', '?')})"


def _kept(recovery: Recovery) -> None:
    """The mark that the run's side file keeps."""
    try:
        recovery.kept = read_side_file(recovery.folder)
    except (OSError, ValueError) as error:
        recovery.kept_fault = f"{SIDE_FILE} cannot be read ({error}): whether a tail is missing is not known"


def _save_all(paths: list[Path], recovery: Recovery) -> None:
    """Segment after segment, for as long as each goes on where the chain has come to."""
    again = left_over(paths)
    for path in sorted(again):
        recovery.parts.append(Part(path.name, left_bytes=path.stat().st_size, found=how_left(path)))
    left = [path for path in paths if path not in again]
    for place in range(1, len(left) + 1):
        if recovery.lost or recovery.changed:
            break
        path = _next(left, recovery.mark)
        left.remove(path)
        part, scan, misnamed = Part(path.name), Scan(path), number_of(path) != place
        recovery.parts.append(part)
        if misnamed and _before(path) != recovery.mark:
            part.found = f"segment {place} is missing before it"
            recovery.lost.append(f"{path.name} and what follows: {part.found}")
        else:
            _save(scan, part, recovery)
        part.left_bytes = 0 if scan.finished else path.stat().st_size - part.read_bytes
        if not (recovery.lost or recovery.changed):
            _look_at_end(scan, part, recovery, last=not left)
            part.found += f"; its name was wrong: by its chain it is segment {place}" * misnamed
    for path in left:
        part = Part(path.name, left_bytes=path.stat().st_size, found="not joined to what was saved")
        recovery.parts.append(part)
    _compare_kept(recovery)


def _next(left: list[Path], mark: Mark) -> Path:
    """The first of the segments by name, unless only another one goes on at `mark`: names may be wrong."""
    if _before(left[0]) in (mark, None):
        return left[0]
    return next((path for path in left if _before(path) == mark), left[0])


def _before(path: Path) -> Mark | None:
    """Where a segment goes on, as it says itself; None where its beginning cannot be read."""
    scan = Scan(path)
    with suppress(LuxloopError, OSError):
        return scan.before if next(iter(scan), None) else None
    return None


def _readable(scan: Scan) -> Iterator[Commit]:
    """The commits of a segment; a disk that gives no more of it is damage as any other."""
    try:
        yield from scan
    except OSError as error:
        scan.fault = f"it cannot be read: {error.strerror or error}"


def _save(scan: Scan, part: Part, recovery: Recovery) -> None:
    """Write a segment anew as far as its chain holds."""
    file: SegmentFile | None = None
    path = recovery.out / f"audit-{recovery.segments + 1:04}.mcap"
    try:
        for commit in _readable(scan):
            if not _follows(scan, commit, part, recovery):
                break
            file = file or SegmentFile(path)
            for link in (*commit.links, commit.checkpoint):
                file.add(link)
            file.spill()
            part.records += len(commit.links)
            recovery.mark = commit.mark
            recovery.kept_met = recovery.kept_met or commit.mark == recovery.kept
        part.read_bytes = scan.read_bytes if file else 0
        if file is not None:
            file.finish(recovery.mark)
            sync_folder(recovery.out)
            recovery.segments += 1
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    finally:
        if file is not None:
            file.close()


def _follows(scan: Scan, commit: Commit, part: Part, recovery: Recovery) -> bool:
    """Whether a commit goes on where the chain has come to; if not, that is put down."""
    mark, before = recovery.mark, scan.before
    if not part.records and before != mark:
        part.found = f"goes on after {before.records:,} records, where {mark.records:,} were saved"
        if before.records > mark.records:
            lost = f"{before.records - mark.records:,} records after record {mark.records:,}"
            recovery.lost.append(f"{lost}, and {part.file} and what follows, which cannot be joined")
        else:
            recovery.changed.append(f"{part.file} {part.found}, or of another root")
        return False
    if mark.then(commit.links) == commit.mark:
        return True
    part.found = f"records {mark.records + 1:,} to {commit.mark.records:,} are not what was written"
    recovery.changed.append(f"{part.file}: {part.found}")
    return False


def _look_at_end(scan: Scan, part: Part, recovery: Recovery, *, last: bool) -> None:
    """How a segment ends whose commits were all saved; for one that is not the last, the next one says the rest."""
    complete = scan.final == recovery.mark
    if scan.finished:
        part.found = FINISHED
        if not complete:
            recovery.changed.append(f"{part.file}: ends after {recovery.mark.records:,} records, states another root")
        return
    part.found = f"damaged: {scan.fault}" if scan.fault else "not finished"
    if complete:
        part.found += "; no record is missing"
    elif last and (scan.fault or part.left_bytes):
        why = scan.fault or "a batch that was cut off, or never acknowledged"
        behind = f"{part.left_bytes:,} bytes behind record {recovery.mark.records:,}"
        recovery.lost.append(f"{part.file}: {behind}: {why}")


def _compare_kept(recovery: Recovery) -> None:
    """Whether the saved chain holds the mark that the side file keeps."""
    kept = recovery.kept
    recovery.lost += [recovery.kept_fault] * bool(recovery.kept_fault)
    if kept is None or recovery.kept_met:
        return
    if kept.records > recovery.mark.records:
        missing = f"{kept.records - recovery.mark.records:,} records after record {recovery.mark.records:,}"
        recovery.lost.append(f"{missing}, of the {kept.records:,} that {SIDE_FILE} states")
    else:
        recovery.changed.append(f"{SIDE_FILE} states another root after {kept.records:,} records")
