"""What a person sees while a campaign runs: one table on the terminal, renewed as steps come in."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from agent.in_words import line, plain
from agent.progress import FINALISTS, Progress
from luxloop.errors import LuxloopError

if TYPE_CHECKING:
    from rich.table import Table

    from luxloop.client import Client

RENEW_S = 0.25
ASK_S = 2.0  # how often the controller is asked for its workers


@contextmanager
def live(show: bool, title: str, evaluations: int, client: Client | None) -> Iterator[Callable[[Progress], None]]:
    """A function that is given the progress after each step; it draws where `show`.

    Without a client nothing is told of workers; where the planned `evaluations` are not known (0), no time left.
    """
    if not show:
        yield lambda _: None
        return
    from rich.console import Console
    from rich.live import Live

    view = View(title, evaluations, client)
    with Live(console=Console(stderr=True), auto_refresh=False, transient=True) as screen:

        def look(progress: Progress) -> None:
            if view.due():
                screen.update(view.table(progress), refresh=True)

        yield look


class View:
    """The table; it asks the controller, where there is one, for its workers now and then."""

    def __init__(self, title: str, evaluations: int, client: Client | None) -> None:
        self._title, self._evaluations, self._client = title, evaluations, client
        self._drawn_s, self._asked_s, self._workers = 0.0, 0.0, "?"

    def due(self) -> bool:
        """Whether it is time to draw again."""
        now_s = time.monotonic()
        if now_s - self._drawn_s < RENEW_S:
            return False
        self._drawn_s = now_s
        return True

    def table(self, seen: Progress) -> Table:
        """The rows a person wants: where it is, what is best, how fast, how long still."""
        from rich.progress_bar import ProgressBar
        from rich.table import Table

        table = Table.grid(padding=(0, 2))
        rate = seen.steps / seen.wall_s if seen.wall_s > 0.0 else 0.0
        left = max(self._evaluations - seen.evaluations, 0)
        per_evaluation_s = seen.wall_s / seen.evaluations if seen.evaluations else 0.0
        planned = self._evaluations or seen.evaluations
        table.add_row(self._title, ProgressBar(planned, min(seen.evaluations, planned), width=40))
        last = seen.last
        role = f": {last.role.replace('_', ' ')}" if last is not None and last.role is not None else ""
        table.add_row("stage", f"{seen.stage}, evaluated anew{role}" if seen.stage == FINALISTS else seen.stage)
        of = f" of {self._evaluations}" if self._evaluations else ""
        table.add_row("evaluations", f"{seen.evaluations}{of}, {seen.episodes} episodes")
        table.add_row("now", line(plain(seen.last)))
        table.add_row("best of the walk", line(plain(seen.best)))
        if seen.epsilon is not None:
            table.add_row("random moves", f"{100.0 * seen.epsilon:.0f} %")
        if self._client is not None:
            table.add_row("workers", self._busy(self._client))
        time_left = f", about {left * per_evaluation_s:.0f} s left" if self._evaluations else ""
        table.add_row("pace", f"{rate:.1f} steps/s{time_left}")
        return table

    def _busy(self, client: Client) -> str:
        if time.monotonic() - self._asked_s > ASK_S:
            self._asked_s = time.monotonic()
            try:
                status = client.status()
                workers = status.workers
                kinds = sorted({worker.describe.kind for worker in workers})
                of_kind = {kind: [one for one in workers if one.describe.kind == kind] for kind in kinds}
                self._workers = ", ".join(
                    f"{sum(bool(one.task_id) for one in ours)} of {len(ours)} {kind} busy"
                    for kind, ours in of_kind.items()
                ) + (f", {status.hedged} tasks given out twice" if status.hedged else "")
            except LuxloopError:
                self._workers = "the controller does not answer"
        return self._workers or "none yet: one that starts for the first time compiles for a minute"
