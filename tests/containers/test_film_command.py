"""`luxloop film` inside one process: tables that have gone from their store, and what a person reads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from containers.asking import answers, fetched
from containers.film_text import as_text
from containers.thin_film.database import open_database
from containers.thin_film.packing import unpack
from containers.thin_film.table import FilmTable
from containers.thin_film.worker import DATABASE, FilmComputation
from luxloop.client import Answer
from luxloop.computation import Progress
from luxloop.errors import RemoteError
from luxloop.failure import Code, Failure
from luxloop.film import FilmTableRequest, Grid
from luxloop.model import Environment

REQUEST = FilmTableRequest(environment=Environment(), dbr_pairs=2.5, grid=Grid(wavelengths=3))


class Forgetful:
    """A client beside its worker; the blobs of answers that were not asked for afresh have gone."""

    def __init__(self, computation: FilmComputation, code: Code = "not_found", *, for_good: bool = False) -> None:
        self._computation = computation
        self._code, self._gone, self._for_good = code, True, for_good
        self.fresh = 0

    def run(self, request: FilmTableRequest, *, fresh: bool = False) -> Answer:
        """Compute it here."""
        self.fresh += fresh
        self._gone = self._for_good or not fresh
        result, arrays = self._computation.compute(request.model_dump(), Progress())
        return Answer(result, arrays, "here", 1, 0.0)

    def map(self, requests: Iterable[FilmTableRequest]) -> Iterator[tuple[int, Answer]]:
        """One after the other."""
        for number, request in enumerate(requests):
            yield number, self.run(request)

    def fetch(self, sha256: str, size: int) -> bytes:
        """The blob, or that nobody holds it."""
        packed = self._computation.blob(sha256)
        if self._gone or packed is None or len(packed) != size:
            raise RemoteError(Failure(code=self._code, message="nobody holds it"))
        return packed


@pytest.fixture
def computation(tmp_path: Path) -> Iterator[FilmComputation]:
    """The computation with a database of its own."""
    with open_database(tmp_path / DATABASE) as database:
        yield FilmComputation(database)


def ask(client: Any) -> tuple[Answer, bytes]:
    """The table of REQUEST, as the command asks for it."""
    ((_, first),) = answers(client, [REQUEST], "tables", show=False)
    return fetched(client, REQUEST, first)


def test_a_table_that_nobody_holds_any_more_is_computed_again(computation: FilmComputation) -> None:
    """Once, afresh; the table that comes is whole."""
    client = Forgetful(computation)
    answer, packed = ask(client)
    assert client.fresh == 1
    assert len(packed) == answer.result["table_bytes"]
    assert FilmTable.from_parts(*unpack(packed)).wavelength_nm.size == 3


@pytest.mark.parametrize(("code", "fresh"), [("not_found", 1), ("no_router", 0)])
def test_a_table_is_not_asked_for_again_and_again(computation: FilmComputation, code: Code, fresh: int) -> None:
    """A second `not_found`, and any other failure, is the asker's."""
    client = Forgetful(computation, code, for_good=True)
    with pytest.raises(RemoteError) as caught:
        ask(client)
    assert caught.value.failure.code == code
    assert client.fresh == fresh


def document(films: int) -> dict[str, Any]:
    """A result with so many mirrors at three angles; value = number of the film + row / 10."""
    return {
        "command": "film",
        "quantity": "R",
        "unit": "1",
        "side": "inside",
        "polarisation": "u",
        "against": "angle",
        "angle_deg": [0.0, 2.5, 80.0],
        "wavelength_nm": [445.0],
        "bandwidth_nm": 0.0,
        "model": {"name": "paper", "sha256": "0"},
        "films": [{"dbr_pairs": 0.5 * n, "values": [n + 0.1 * row for row in range(3)]} for n in range(films)],
    }


@pytest.mark.parametrize("columns", [None, 200, 60, 40, 10])
def test_a_narrow_terminal_gets_the_films_in_blocks(columns: int | None) -> None:
    """No row is longer than the terminal, if one film fits; every value has its title and its angle."""
    lines = as_text(document(11), columns).splitlines()[1:]
    if columns is not None:
        assert max(map(len, lines)) <= max(columns, 13 + 11)
    found: dict[tuple[str, str], str] = {}
    for line in lines:
        if "angle_deg" in line:
            titles = line.replace(" pairs", "").split()[1:]
        elif line:
            angle, *values = line.split()
            found |= {(title, angle): value for title, value in zip(titles, values, strict=True)}
    assert len(found) == 33
    assert found["2.5", "2.5"] == "5.10000"
    assert found["5", "80"] == "10.20000"
    assert (lines.count("") > 0) == (columns is not None and columns < 13 + 11 * 11)
