"""How the commands of this room ask the workers: with a status line and a bar on a terminal, for what takes long."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING, Any

from luxloop.errors import LuxloopError, RemoteError

if TYPE_CHECKING:
    from luxloop.client import Answer, Client
    from luxloop.film import FilmTableRequest
    from luxloop.messages import Task
    from luxloop.settings import Settings

LOOK_S = 0.5  # how often a bar asks; workers tell once a second
PATIENCE_S = 300.0
"""That a task waits for a worker of its kind: one that starts for the first time compiles its kernels."""
STARTING = "no worker yet, one that starts for the first time compiles for a minute or two"


@contextmanager
def connected(settings: Settings, show: bool) -> Iterator[Client]:
    """A client, once router and controller answer; a line on a terminal says so, for starting them takes a while."""
    from rich.console import Console

    from luxloop.client import Client

    waiting = Console(stderr=True).status("finding the workers, or starting some") if show else nullcontext()
    with ExitStack() as held:
        with waiting:
            client = held.enter_context(Client(settings, patience_s=PATIENCE_S))
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


def watched(client: Client, request: Any, what: str, show: bool, limit_s: float) -> Answer:
    """The answer to one request that may take long; raises its failure. `show` draws how far its worker says it is.

    Left early (Ctrl-C), the request is withdrawn, so that its worker is free at once.
    """
    if not show:
        try:
            return client.run(request, limit_s=limit_s)
        except KeyboardInterrupt:
            with suppress(LuxloopError):
                client.withdraw(request)
            raise
    from luxloop.bus import Interrupt
    from luxloop.client import as_task

    task, left = as_task(request), Interrupt()
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(client.run, task, limit_s=limit_s, until=left)
        try:
            _draw(client, task, future, what)
        except BaseException:
            with suppress(LuxloopError):  # a controller that is not there forgets it by itself
                client.withdraw(task)
            raise
        finally:
            left.set()
        return future.result()


def _draw(client: Client, task: Task, future: Future[Answer], what: str) -> None:
    """A bar until the future is there; while nobody computes, what is waited for."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        row = bar.add_task(what, total=1.0)
        while not wait([future], LOOK_S).done:
            try:
                workers = client.status().workers
            except RemoteError:  # the answer will say what is wrong
                continue
            ratios = [worker.progress_ratio for worker in workers if worker.task_id == task.id]
            here = any(worker.describe.kind == task.kind for worker in workers)
            bar.update(row, completed=max(ratios, default=0.0), description=what if here else f"{what}: {STARTING}")


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
