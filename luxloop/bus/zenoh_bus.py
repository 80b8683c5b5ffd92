"""The bus over eclipse-zenoh: the only place that imports it.

What zenoh does not do, and is done here: say why there was no answer (it ends the iterator alike for a dead worker,
an exception in a callback, an ACL's refusal and nobody there), bound what arrives, and let a process end (a session
that is not closed keeps the interpreter alive). One session per process, opened after the process has started.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from types import TracebackType
from typing import Any

import zenoh

from luxloop.bus import Asked, Heard, Inbox, Interrupt, Presence, busy, too_large
from luxloop.bus.access import Role
from luxloop.bus.configuration import of_client, of_router
from luxloop.bus.frame import FRAME_BYTES
from luxloop.bus.identity import Identity, answering, refusal
from luxloop.bus.keys import KEYS, at, name_of
from luxloop.endpoint import listening
from luxloop.errors import RemoteError
from luxloop.failure import Code, Failure
from luxloop.process import orphaned
from luxloop.settings import Settings

PRESENT_S = 2.0


class ZenohBus:
    """A zenoh session as a `Bus`. `patient` waits for a router for ever (workers); else `no_router` in 3 s.

    With LUXLOOP_CERTS it shows the certificate of `role`; a router that does not take it is no reason to wait.
    """

    def __init__(self, settings: Settings, *, patient: bool = False, role: Role = "client") -> None:
        self._settings, self._identity = settings, Identity.of(settings, role)
        if patient:
            _wait_for_router(settings, self._identity)
        self._session = _open(of_client(settings, self._identity, patient=patient), settings, self._identity)
        self._kept: list[Any] = []
        self._closed = False

    def ask(self, key: str, frame: bytes, timeout_s: float, cancelled: Interrupt | None = None) -> bytes:
        token = zenoh.CancellationToken()
        begin = time.monotonic()
        try:
            replies = self._session.get(
                key,
                payload=frame,
                timeout=timeout_s,
                cancellation_token=token,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            with cancelled.ends(token.cancel) if cancelled is not None else nullcontext():
                reply = next(iter(replies), None)
        except zenoh.ZError as error:
            raise RemoteError(_closed(error)) from error
        if reply is not None and reply.ok is not None:
            return reply.ok.payload.to_bytes()
        if reply is not None and reply.err is not None:
            text = reply.err.payload.to_bytes()
            if text != b"Timeout":
                return text
        if cancelled is not None and cancelled.is_set():
            raise RemoteError(Failure(code="cancelled", message="the question was withdrawn", where=key))
        try:
            why = self._why_nothing(key, time.monotonic() - begin, timeout_s, timed_out=reply is not None)
        except zenoh.ZError as error:
            raise RemoteError(_closed(error)) from error
        raise RemoteError(why)

    def answer(self, key_expr: str, inbox: Inbox) -> None:
        def on_query(query: zenoh.Query) -> None:
            key = str(query.key_expr)
            data = query.payload.to_bytes() if query.payload is not None else b""
            answer = _answerer(query, key)
            if len(data) > FRAME_BYTES:
                answer(too_large(len(data), FRAME_BYTES, key))
            elif not inbox.offer(Asked(key, data, answer, query.drop)):
                answer(busy(key))

        self._kept.append(
            self._session.declare_queryable(key_expr, zenoh.handlers.Callback(on_query, indirect=False))
        )

    def publish(self, key: str, frame: bytes) -> None:
        self._session.put(key, frame, congestion_control=zenoh.CongestionControl.DROP)

    def subscribe(self, key_expr: str, inbox: Inbox) -> None:
        def on_sample(sample: zenoh.Sample) -> None:
            data = sample.payload.to_bytes()
            if len(data) <= FRAME_BYTES:
                inbox.offer(Heard(str(sample.key_expr), data))

        self._kept.append(
            self._session.declare_subscriber(key_expr, zenoh.handlers.Callback(on_sample, indirect=False))
        )

    def announce(self, key: str) -> None:
        self._kept.append(self._session.liveliness().declare_token(key))

    def present(self, key_expr: str) -> frozenset[str]:
        replies = list(self._session.liveliness().get(key_expr, timeout=PRESENT_S))
        if any(reply.ok is None for reply in replies):
            raise RemoteError(Failure(code="timed_out", message=f"no answer within {PRESENT_S:g} s", where=key_expr))
        if not self.connected():
            raise RemoteError(_unreachable(self._settings, self._identity))
        return frozenset(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    def watch(self, key_expr: str, inbox: Inbox) -> None:
        def on_change(sample: zenoh.Sample) -> None:
            inbox.offer(Presence(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

        self._kept.append(
            self._session.liveliness().declare_subscriber(
                key_expr, zenoh.handlers.Callback(on_change, indirect=False), history=True
            )
        )

    def connected(self) -> bool:
        """Whether a router is reached at this moment."""
        return bool(self._session.info.routers_zid())

    def close(self) -> None:
        """Close under a deadline: under packet loss zenoh's own close may block for 10 s."""
        if self._closed:
            return
        self._closed = True
        closer = threading.Thread(target=self._session.close, daemon=True)
        closer.start()
        closer.join(3.0)

    def __enter__(self) -> ZenohBus:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _why_nothing(self, key: str, took_s: float, limit_s: float, *, timed_out: bool) -> Failure:
        """The likeliest reason for silence: what liveliness and the clock say. The asker's hint, not a proof."""
        if timed_out:
            return Failure(code="timed_out", message=f"no answer within {limit_s:g} s", where=key)
        if not self.connected():
            return _unreachable(self._settings, self._identity)
        row = KEYS.get(name_of(key))
        role = row.answered_by if row else "anybody"
        held = role != "anybody" and self.present(at(self._settings.realm, "alive", role=role))
        code: Code = "no_controller" if role == "controller" else "not_found"
        if not held:
            may_not = "; is there one, luxloop doctor says what this certificate may see" if self._identity else ""
            return Failure(
                code=code,
                message=f"nobody answers at {key}",
                mend=f"start one: luxloop serve local{may_not}" if role == "controller" else "",
            )
        if took_s < 0.1:
            return Failure(
                code="refused",
                message=f"{role} is there, but the question did not reach it or was dropped",
                mend="check this role's permissions: luxloop doctor",
                where=key,
            )
        return Failure(code=code, message=f"{role} was lost after {took_s:.1f} s", mend="ask again", where=key)


def run_router(settings: Settings, stop: threading.Event) -> None:
    """Be the router at `settings.router` until `stop` is set; with LUXLOOP_CERTS for known roles only.

    Raises RemoteError where it cannot listen there, InputError where its certificate cannot be used.
    """
    identity = Identity.of(settings, "router")
    zenoh.init_log_from_env_or("off")
    session = _open(of_router(settings, identity), settings, identity, as_router=True)
    try:
        stop.wait()
    finally:
        closer = threading.Thread(target=session.close, daemon=True)
        closer.start()
        closer.join(3.0)


def _wait_for_router(settings: Settings, identity: Identity | None) -> None:
    """Return once a router listens: zenoh's own waiting cannot be interrupted.

    Raises RemoteError where its certificate and ours do not fit together, or the process that started us has gone.
    """
    zenoh.init_log_from_env_or("off")  # RUST_LOG shows zenoh's side; of commands their answer is there
    while not answering(settings, identity):
        if orphaned():
            raise RemoteError(Failure(code="no_router", message="the process that started this one has gone"))
        time.sleep(0.2)
    if identity is not None and (failure := refusal(settings, identity)) is not None:
        raise RemoteError(failure)


def _open(
    told: dict[str, object], settings: Settings, identity: Identity | None, *, as_router: bool = False
) -> zenoh.Session:
    config = zenoh.Config()
    for path, value in told.items():
        config.insert_json5(path, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if as_router:
            raise RemoteError(
                Failure(
                    code="refused",
                    message=f"cannot listen at {settings.router}",  # zenoh's own text names its source files
                    mend="is the port taken? choose another with --router or LUXLOOP_ROUTER",
                )
            ) from error
        raise RemoteError(_unreachable(settings, identity, at_first=True)) from error


def _unreachable(settings: Settings, identity: Identity | None, *, at_first: bool = False) -> Failure:
    """Why there is no session: nobody listens, certificates do not fit, or (at first) it is no router of ours."""
    if not listening(settings.router):
        return _no_router(settings)
    return refusal(settings, identity) or (_stranger(settings) if at_first else _lost(settings))


def _no_router(settings: Settings) -> Failure:
    return Failure(
        code="no_router",
        message=f"no router at {settings.router}",
        mend="start one (luxloop serve local) or set LUXLOOP_ROUTER to where it is",
    )


def _lost(settings: Settings) -> Failure:
    mend = "wait: the session comes back by itself within seconds"
    return Failure(code="no_router", message=f"the session with the router at {settings.router} is lost", mend=mend)


def _closed(error: zenoh.ZError) -> Failure:
    return Failure(code="cancelled", message=f"this side has closed its session ({error})")


def _stranger(settings: Settings) -> Failure:
    return Failure(
        code="no_router",
        message=f"what listens at {settings.router} is no router of luxloop",
        mend="choose another endpoint with LUXLOOP_ROUTER, or end the program that has this port",
    )


def _answerer(query: zenoh.Query, key: str) -> Callable[[bytes], None]:
    """Answer once and let go of the query, or its asker waits for its time limit."""

    def answer(frame: bytes) -> None:
        try:
            query.reply(key.replace("*", "_"), frame)  # a reply has a key without wildcards
        except zenoh.ZError:
            pass  # the asker has gone, or has its answer
        finally:
            query.drop()

    return answer
