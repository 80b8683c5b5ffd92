"""Both workers in this process, behind what a client offers: for tests of predictions without a set of processes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from containers.catalogue import Catalogue
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.worker import RayComputation
from containers.thin_film.worker import FilmComputation
from luxloop.client import Answer
from luxloop.computation import Progress
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure


class Workers:
    """Answers requests as the set would, and remembers them."""

    def __init__(self, folder: Path, effects: Path | None = None) -> None:
        self._film = FilmComputation.in_folder(folder, Catalogue(effects))
        self._ray = RayComputation(self._fetch, ExitSource(), catalogue=Catalogue(effects))
        self.asked: list[Any] = []
        self.lost: set[str] = set()
        """Hashes of tables that nobody has any more."""

    def run(self, request: Any, *, fresh: bool = False) -> Answer:
        """The answer to one request; RemoteError where it is refused."""
        self.asked.append(request)
        if fresh:
            self.lost.clear()
        worker = self._film if request.KIND == "film" else self._ray
        try:
            result, arrays = worker.compute(json.loads(request.model_dump_json()), Progress())
        except InputError as error:
            raise RemoteError(Failure.of(error)) from error
        return Answer(result, arrays, "here", 1, 0.0)

    def map(self, requests: Iterable[Any], **_: Any) -> Iterator[tuple[int, Answer | RemoteError]]:
        """The answers, last one first: order is not promised."""
        for number, request in reversed(list(enumerate(requests))):
            try:
                yield number, self.run(request)
            except RemoteError as error:
                yield number, error

    def of_kind(self, kind: str) -> list[Any]:
        """The requests of one kind."""
        return [request for request in self.asked if kind == request.KIND]

    def _fetch(self, sha256: str, size: int) -> bytes:
        found = None if sha256 in self.lost else self._film.blob(sha256)
        if found is None or len(found) != size:
            raise RemoteError(Failure(code="not_found", message=f"nobody holds {sha256}"))
        return found
