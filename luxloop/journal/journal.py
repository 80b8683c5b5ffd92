"""The journal that a process writes through: a thread of its own makes batches of records durable.

    put(records, done) ──▶ bounded queue ──▶ writer thread: write all that waits, sync once ──▶ done(None) of each

A batch is in the journal whole or not at all, and `done(None)` is called once it is on the disk. What waits while
the disk is busy is committed together (group commit). The first failure is final: a disk that lost a write cannot be
trusted with the next, so this batch and all later ones are told the error; what was acknowledged before stays.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from luxloop.errors import LuxloopError, RemoteError
from luxloop.failure import Code, Failure
from luxloop.journal.chain import Mark
from luxloop.journal.reader import number_of, segments_of, tail_of
from luxloop.journal.segment import Segment, being_written, sync_folder
from luxloop.journal.topics import Record

log = logging.getLogger(__name__)

Done = Callable[[LuxloopError | None], None]
QUEUE_BYTES = 64 << 20
RECORD_BYTES = 100
"""What a record needs beside its data."""


class Journal:
    """The journal of a run in `folder`, open in a new segment. Leave it by `finish`, in any case by `close`.

    `metadata` are facts for people by name: `run` (`opening` makes it of a Begin) and `environment` at least;
    `attachments` are files by name.
    """

    def __init__(
        self,
        folder: Path,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Mapping[str, bytes],
        queue_bytes: int = QUEUE_BYTES,
        mark: Mark | None = None,
    ) -> None:
        """Makes the folder where it is not there, and commits metadata and attachments.

        `mark` is how far the chain has come, where that is known: else the last segment is read for it, a second for
        some thousands of steps.

        Raises RemoteError where the folder cannot be written, another process writes this run's journal, or what
        lies there is no journal of ours.
        """
        self.folder, self._queue_bytes = folder, queue_bytes
        try:
            for new in reversed([place for place in (folder, *folder.parents) if not place.exists()]):
                new.mkdir(exist_ok=True)
                sync_folder(new.parent)
            before = segments_of(folder)
            if before and being_written(before[-1]):
                raise _failure(f"{folder}: its journal is being written by another process", "end that one first")
            self.number = number_of(before[-1]) + 1 if before else 1
            path = folder / f"audit-{self.number:04}.mcap"
            self._segment = Segment(path, mark or tail_of(folder), metadata, attachments)
        except OSError as error:
            with suppress(OSError):  # an empty folder would look like a run
                folder.rmdir()
            raise _not_written(folder, error) from error
        self._waiting: list[tuple[Sequence[Record], Done]] = []
        self._waiting_bytes = 0
        self._changed, self._closing = threading.Condition(), False
        self._error: RemoteError | None = None
        self._thread = threading.Thread(target=self._write_all, name="journal", daemon=True)
        self._thread.start()

    def put(self, records: Sequence[Record], done: Done) -> None:
        """Have the records made durable together; `done` is then called once from the writer's thread.

        Raises RemoteError: `busy` where too much waits (try again later; nothing was taken), `refused` where the
        journal has failed or is closed. `done` is not called then.
        """
        size_bytes = sum(len(entry.data) + RECORD_BYTES for entry in records)
        with self._changed:
            if self._error is not None:
                raise self._error
            if self._closing:
                raise _failure(f"the journal in {self.folder} is closed", "open the run again")
            if self._waiting and self._waiting_bytes + size_bytes > self._queue_bytes:
                raise _failure("too much waits for the journal's disk", "try again later", "busy")
            self._waiting.append((records, done))
            self._waiting_bytes += size_bytes
            self._changed.notify()

    def finish(self) -> Mark:
        """Write what waits, the index and the root; records and root of the chain, which should leave the machine.

        Raises RemoteError where the journal has failed, or fails now.
        """
        self._end_thread()
        if self._error is not None:
            raise self._error
        try:
            return self._segment.finish()
        except OSError as error:
            self._error = _not_written(self.folder, error)
            raise self._error from error

    def close(self) -> None:
        """Write what waits and let go; the segment stays unfinished unless `finish` came before."""
        self._end_thread()
        self._segment.close()

    def _end_thread(self) -> None:
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()

    def _write_all(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closing)
                batches, self._waiting, self._waiting_bytes = self._waiting, [], 0
            if not batches:
                return
            error = self._error or self._commit(batches)
            for _, done in batches:
                _tell(done, error)

    def _commit(self, batches: list[tuple[Sequence[Record], Done]]) -> RemoteError | None:
        """What went wrong, None where all batches are durable."""
        try:
            for records, _ in batches:
                for entry in records:
                    self._segment.write(entry)
            self._segment.commit()
        except OSError as error:
            self._error = _not_written(self.folder, error)
        except Exception as error:
            log.exception("the journal in %s cannot go on", self.folder)
            self._error = RemoteError(Failure.of(error, "journal"))
        return self._error


def _tell(done: Done, error: RemoteError | None) -> None:
    """An asker that falls over its own acknowledgement does not stop the journal."""
    try:
        done(error)
    except Exception:
        log.exception("whoever waited for the journal failed when told")


def _failure(message: str, mend: str, code: Code = "refused") -> RemoteError:
    return RemoteError(Failure(code=code, message=message, mend=mend, where="journal"))


def _not_written(folder: Path, error: OSError) -> RemoteError:
    mend = "make room there or name another results folder; what was acknowledged is safe"
    return _failure(f"the journal in {folder} cannot be written: {error.strerror or error}", mend)
