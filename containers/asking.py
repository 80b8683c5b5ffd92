"""How the commands of this room ask the workers: with a status line and a bar on a terminal, for what takes long."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

from luxloop.errors import RemoteError

if TYPE_CHECKING:
    from luxloop.client import Answer, Client
    from luxloop.film import FilmTableRequest
    from luxloop.settings import Settings


@contextmanager
def connected(settings: Settings, show: bool) -> Iterator[Client]:
    """A client, once router and controller answer; a line on a terminal says so, for starting them takes a while."""
    from rich.console import Console

    from luxloop.client import Client

    waiting = Console(stderr=True).status("finding the workers, or starting some") if show else nullcontext()
    with ExitStack() as held:
        with waiting:
            client = held.enter_context(Client(settings))
        yield client


def answers(client: Client, requests: Sequence[Any], what: str, show: bool) -> Iterator[tuple[int, Answer]]:
    """(number, answer) of each request; raises the first failure. `show` draws a bar, for those that take long."""
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    under_way = client.map(requests)
    for number, answer in track(
        under_way, what, total=len(requests), console=console, transient=True, disable=not show
    ):
        if isinstance(answer, RemoteError):
            raise answer
        yield number, answer


def fetched(client: Client, request: FilmTableRequest, answer: Answer) -> tuple[Answer, bytes]:
    """The packed table of an answer; computed again, once, where nobody holds it any more."""
    try:
        return answer, _blob(client, answer)
    except RemoteError as error:
        if error.failure.code != "not_found":
            raise
    answer = client.run(request, fresh=True)
    return answer, _blob(client, answer)


def _blob(client: Client, answer: Answer) -> bytes:
    return client.fetch(str(answer.result["table_sha256"]), int(answer.result["table_bytes"]))
