"""A designer's door to a run: begin it, act in its lanes, put things on record, end it.

with Client(settings) as client, RunDoor.begin(client, plan) as door:
    step = door.act(Action(run=door.run, designer=door.designer, lane=0, number=0, design=design))
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any
from uuid import uuid4

from luxloop.bus import Interrupt
from luxloop.bus.frame import Parcel
from luxloop.campaign import Action, AgentRecord, Begin, Begun, End, Ended, Note, Plan, Step
from luxloop.client import AGAIN, Client
from luxloop.errors import RemoteError
from luxloop.failure import Failure
from luxloop.messages import Nothing, Receipt
from luxloop.words import Words

LOST_S = 60.0
"""A controller or router that is away for longer is given up; one that is started again is back in a few seconds."""


class RunDoor:
    """An open run. Thread-safe: lanes may act from several threads. Left by `with`, the run is ended."""

    def __init__(self, client: Client, begun: Begun, designer: str) -> None:
        self._client, self.begun, self.designer = client, begun, designer
        self.run = begun.run
        self.ended: Ended | None = None
        self.reason = "left early"
        self.on_lost: Callable[[float], None] = lambda _: None
        """Told for how long nothing was heard from the controller, now and then."""

    @classmethod
    def begin(
        cls,
        client: Client,
        plan: Plan,
        facts: Mapping[str, Any] | None = None,
        attachments: Mapping[str, str] | None = None,
    ) -> RunDoor:
        """Open a run. Raises RemoteError refused where its id is taken, or its folder cannot be written."""
        designer = f"{os.getpid()}-{uuid4().hex[:8]}"
        begin = Begin(plan=plan, designer=designer, facts=dict(facts or {}), attachments=dict(attachments or {}))
        return cls(client, _asked(client, "begin", begin, {}).expect(Begun), designer)

    def act(self, action: Action, until: Interrupt | None = None) -> Step:
        """The step that comes of an action, once it is on the controller's disk. Asks again while it takes."""
        while True:
            try:
                parcel = _asked(self._client, "act", action, {"name": self.run}, until, self.on_lost)
            except RemoteError as error:
                if error.failure.code != "not_found":
                    raise
                raise RemoteError(self._gone()) from error
            if not isinstance(parcel.message, Nothing):
                return parcel.expect(Step)

    def _gone(self) -> Failure:
        return Failure(
            code="worker_lost",
            message=f"the controller ended, and the run {self.run!r} with it; every step that was told is safe in"
            f" {self.begun.folder}",
            mend=f"luxloop campaign report {self.begun.folder}; to go on, begin a run with another id",
        )

    def note(
        self, *, agent: AgentRecord | None = None, result: Mapping[str, Any] | None = None, log: str = ""
    ) -> None:
        """Put something on record; returns once it is on the controller's disk."""
        note = Note(
            run=self.run, designer=self.designer, agent=agent, result=dict(result) if result else None, log=log
        )
        _asked(self._client, "note", note, {"name": self.run}).expect(Receipt)

    def end(self, reason: str, patience_s: float = LOST_S) -> Ended:
        """Finish the journal; records and root, which should leave the machine."""
        if self.ended is None:
            end = End(run=self.run, designer=self.designer, reason=reason)
            self.ended = _asked(self._client, "end", end, {"name": self.run}, patience_s=patience_s).expect(Ended)
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
                    self.end(f"{type(error).__name__}: {error}"[:1000], patience_s=0.0)
            except RemoteError:
                if error is None:
                    raise


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
    while True:
        asked_s = time.monotonic()
        try:
            found = client.ask(row, message, parts, until)
        except RemoteError as error:
            if error.failure.code not in AGAIN or error.failure.code == "refused" or (until and until.is_set()):
                raise
            lost_since_s = asked_s if lost_since_s is None else lost_since_s
            on_lost(time.monotonic() - lost_since_s)
            if time.monotonic() - lost_since_s > patience_s:
                raise
            time.sleep(0.2)
        else:
            return found
