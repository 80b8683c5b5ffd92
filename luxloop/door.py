"""A designer's door to a run: begin it or go on with it, act in its lanes, put things on record, end it.

with Client(settings) as client, RunDoor.begin(client, plan) as door:
    step = door.act(Action(run=door.run, designer=door.designer, lane=0, number=0, design=design))

A controller that was killed and started again knows nothing of the run; it is asked to go on with it, reads the
journal back, and the action that was under way is asked again: the designer notices nothing.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from itertools import count
from types import TracebackType
from typing import Any
from uuid import uuid4

from luxloop.bus import Interrupt
from luxloop.bus.frame import Parcel
from luxloop.bus.keys import name_of
from luxloop.campaign import Action, Begin, Begun, End, Ended, Note, Plan, Step
from luxloop.client import AGAIN, Client
from luxloop.errors import RemoteError
from luxloop.failure import Failure, printable
from luxloop.messages import Nothing, Receipt
from luxloop.words import Words

LOST_S = 60.0
"""A controller or router that is away for longer is given up; one that is started again is back in a few seconds."""
UNHEARD = 25
"""How often in a row, 0.2 s apart, a question may reach nobody although the controller is there: a router that was
just started knows who is there before it knows who answers. Oftener, and this side is not permitted to ask."""
REOPENED = 10
"""How often a run is opened again for one question, before the controller is taken for one that cannot keep it."""


class RunDoor:
    """An open run. Thread-safe: lanes may act from several threads. Left by `with`, the run is ended."""

    def __init__(self, client: Client, begin: Begin) -> None:
        """Opens the run. Raises RemoteError refused where that cannot be; see `begin`."""
        self._client, self._begin = client, begin
        self.run, self.designer = begin.plan.run, begin.designer
        self._numbers = count()
        self.ended: Ended | None = None
        self.reason = "left early"
        self.on_lost: Callable[[float], None] = lambda _: None
        """Told for how long nothing was heard from the controller, now and then."""
        self.begun = self._opened(begin)

    @classmethod
    def begin(
        cls,
        client: Client,
        plan: Plan,
        facts: Mapping[str, Any] | None = None,
        attachments: Mapping[str, str] | None = None,
        *,
        resume: bool = False,
        root: str | None = None,
    ) -> RunDoor:
        """Open a new run, or with `resume` one that exists; `root` then says which journal is meant.

        Raises RemoteError refused where the id is taken, where the run to go on with is another one, in use or
        damaged, and where its folder cannot be written.
        """
        designer = f"{os.getpid()}-{uuid4().hex[:8]}"
        client.announce(designer)
        given = {"facts": dict(facts or {}), "attachments": dict(attachments or {})}
        return cls(client, Begin(plan=plan, designer=designer, resume=resume, root=root, **given))

    def act(self, action: Action, until: Interrupt | None = None) -> Step:
        """The step that comes of an action, once it is on the controller's disk. Asks again while it takes."""
        while True:
            parcel = self._asked("act", action, until)
            if not isinstance(parcel.message, Nothing):
                return parcel.expect(Step)

    def _asked(self, row: str, message: Words, until: Interrupt | None = None, patience_s: float = LOST_S) -> Parcel:
        """The answer to a question about the run, which is opened again where the controller has lost it."""
        for _ in range(REOPENED):
            try:
                return _asked(self._client, row, message, {"name": self.run}, until, self.on_lost, patience_s)
            except RemoteError as error:
                if error.failure.code != "not_found" or not patience_s:
                    raise
                self._open_again()
        raise RemoteError(self._gone("the controller opens it and loses it again"))

    def _opened(self, begin: Begin) -> Begun:
        """The run, once it is open. Asks again while its journal is read back, for an hour."""
        end_s, parcel = time.monotonic() + 60.0 * LOST_S, _asked(self._client, "begin", begin, {})
        while isinstance(parcel.message, Nothing) and time.monotonic() < end_s:
            parcel = _asked(self._client, "begin", begin, {})
        return parcel.expect(Begun)

    def _open_again(self) -> None:
        again = self._begin.model_copy(update={"resume": True, "root": None})
        try:
            self.begun = self._opened(again)
        except RemoteError as error:
            raise RemoteError(self._gone(error.failure.message)) from error

    def _gone(self, why: str) -> Failure:
        return Failure(
            code="worker_lost",
            message=f"the controller ended, and the run {self.run!r} with it ({why}); every step that was told is"
                    f" safe in {self.begun.folder}",
            mend="run it again" if self._begin.plan.kind == "validation" else f"luxloop campaign resume {self.run}",
        )  # fmt: skip

    def note(self, **what: Any) -> None:
        """Put something on record, a field of `Note` each; returns once it is on the controller's disk."""
        note = Note(run=self.run, designer=self.designer, number=next(self._numbers), **what)
        self._asked("note", note).expect(Receipt)

    def end(self, reason: str, patience_s: float = LOST_S, *, complete: bool = False) -> Ended:
        """Finish the journal; records and root, which should leave the machine. `complete`: nothing is left to do."""
        if self.ended is None:
            end = End(run=self.run, designer=self.designer, reason=reason, complete=complete)
            self.ended = self._asked("end", end, patience_s=patience_s).expect(Ended)
        return self.ended

    def __enter__(self) -> RunDoor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.ended is None:
            try:  # after an error nobody is waited for: the controller closes a run whose designer is silent
                if error is None:
                    self.end(self.reason)
                else:
                    self.end(printable(_why_left(error)), patience_s=0.0)
            except RemoteError:
                if error is None:
                    raise


def _why_left(error: BaseException) -> str:
    return "interrupted" if isinstance(error, KeyboardInterrupt) else f"{type(error).__name__}: {error}"[:1000]


def _asked(
    client: Client,
    row: str,
    message: Words,
    parts: dict[str, str],
    until: Interrupt | None = None,
    on_lost: Callable[[float], None] = lambda _: None,
    patience_s: float = LOST_S,
) -> Parcel:
    """The answer to a question that may be asked again; who is away for a moment is waited for."""
    lost_since_s: float | None = None
    unheard = 0
    while True:
        asked_s = time.monotonic()
        try:
            found = client.ask(row, message, parts, until)
        except RemoteError as error:
            refused = error.failure.code == "refused"
            unheard = unheard + 1 if refused and name_of(error.failure.where) == row else 0
            away = error.failure.code in AGAIN and not refused
            if not (away or 0 < unheard < UNHEARD) or (until and until.is_set()):
                raise
            lost_since_s = asked_s if lost_since_s is None else lost_since_s
            on_lost(time.monotonic() - lost_since_s)
            if time.monotonic() - lost_since_s > patience_s:
                raise
            time.sleep(0.2)
        else:
            return found
