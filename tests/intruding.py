"""What an intruder may try against a secured set, and what came of it: for tests, and for the table of intruders.

A try returns what happened, and raises `GotThroughError` where the intruder achieved something.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

import zenoh

from env_controller.certs import Authority, make, role_file
from luxloop import __version__
from luxloop.bus import Heard, Inbox
from luxloop.bus.access import Role
from luxloop.bus.frame import FRAME_BYTES, decode, encode
from luxloop.bus.keys import at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.campaign import End
from luxloop.endpoint import host_and_port
from luxloop.errors import LuxloopError, RemoteError
from luxloop.failure import Failure
from luxloop.messages import (
    Cancel,
    Describe,
    Done,
    Heartbeat,
    Hello,
    Outcome,
    Pull,
    StatusAsked,
    Submit,
    Task,
    Withdraw,
    WorkerStatus,
)
from luxloop.settings import Settings
from luxloop.words import Words
from tests.conftest import free_endpoint, wait_for
from tests.secured_set import DAY, SecuredSet, free_tls_endpoint, running_router

ASK_S = 2.0
WAIT_S = 0.4  # four heartbeats of the set
TASK = Task(kind="ray", inputs={"design": {}}, version=__version__)
SILENT = 10


class GotThroughError(AssertionError):
    """An intruder achieved something."""


@dataclass(frozen=True)
class Try:
    """Who tries what."""

    who: str
    what: str
    do: Callable[[SecuredSet], str]


def told(failure: Failure) -> str:
    """A failure without its mend: what the intruder is told."""
    return f"{failure.code}: {failure.message}"


# who gets no session


def session(settings: Settings, role: Role = "client") -> str:
    """Try to open one."""
    try:
        with ZenohBus(settings, role=role):
            raise GotThroughError("a session was opened")
    except RemoteError as error:
        return told(error.failure)


def no_certificate(lab: SecuredSet) -> str:
    """Know the CA, show nothing."""
    config = zenoh.Config()
    for path, value in {
        "mode": "client",
        "scouting/multicast/enabled": False,
        "transport/link/tls": {"root_ca_certificate": str(lab.certs / "ca.pem")},
        "connect": {"endpoints": [lab.settings.router], "timeout_ms": 400, "exit_on_failure": True},
    }.items():
        config.insert_json5(path, json.dumps(value))
    try:
        zenoh.open(config).close()
    except zenoh.ZError:
        return "no session"
    raise GotThroughError("a session was opened")


def of_another_set(lab: SecuredSet) -> str:
    """Come with a whole set of one's own; the CA has the same name."""
    other = lab.folder / "other-set"
    make(other, days=2, if_needed=True)
    return session(lab.with_certs(other))


def plain_to_tls(lab: SecuredSet) -> str:
    """Speak plain tcp."""
    endpoint = lab.settings.router.replace("tls/", "tcp/")
    return session(lab.settings.model_copy(update={"router": endpoint, "certs": None}))


def tls_to_plain(lab: SecuredSet) -> str:
    """An honest client comes to a router without certificates."""
    endpoint = free_endpoint()
    with running_router(lab.settings.model_copy(update={"router": endpoint, "certs": None})):
        return session(lab.settings.model_copy(update={"router": endpoint.replace("tcp/", "tls/")}))


def false_router(lab: SecuredSet) -> str:
    """Listen in the router's place with the key of a client: an honest client comes by."""
    folder, there = lab.folder / "false-router", {"router": free_tls_endpoint()}
    folder.mkdir(exist_ok=True)
    (folder / "ca.pem").write_bytes((lab.certs / "ca.pem").read_bytes())
    (folder / "router.pem").touch(mode=0o600)
    (folder / "router.pem").write_bytes(role_file(lab.certs, "client").read_bytes())
    with running_router(lab.with_certs(folder).model_copy(update=there)):
        return session(lab.settings.model_copy(update=there))


def garbage(lab: SecuredSet) -> str:
    """Send 1 MB of zeros to the port."""
    with socket.create_connection(host_and_port(lab.settings.router), 2.0) as plain:
        try:
            plain.sendall(bytes(1 << 20))
            plain.settimeout(2.0)
            answer = plain.recv(64)
        except OSError:
            answer = b""
    return "the connection is closed" + (" after a TLS alert" if answer[:1] == b"\x15" else "")


def silent_connections(lab: SecuredSet) -> str:
    """Hold many connections open and say nothing: an honest client must still come in."""
    with ExitStack() as held:
        for _ in range(SILENT):
            held.enter_context(socket.create_connection(host_and_port(lab.settings.router), 2.0))
        begin_s = time.monotonic()
        with ZenohBus(lab.settings) as bus:
            bus.ask(at("luxloop", "status"), encode(StatusAsked()), ASK_S)
        took_s = time.monotonic() - begin_s
    time.sleep(0.12 * SILENT)  # the router pauses for 0.1 s after each of them: the next try is not to be disturbed
    if took_s > ASK_S:
        raise GotThroughError(f"an honest client waited for {took_s:.1f} s")
    return f"an honest client comes in beside {SILENT} of them"


# who has a session and asks what its role may not


def ask(settings: Settings, role: Role, row: str, message: Words | bytes, **parts: str) -> str:
    """Put a question; any answer of the controller's means that the router let it through."""
    frame = message if isinstance(message, bytes) else encode(message)
    with ZenohBus(settings, role=role) as bus:
        try:
            bus.ask(at("luxloop", row, **parts) if row != "**" else "**", frame, ASK_S)
        except RemoteError as error:
            return told(error.failure)
    raise GotThroughError(f"{row} was answered")


def asks(role: Role, row: str, message: Words, /, **parts: str) -> Callable[[SecuredSet], str]:
    """A try: `role`, with its true certificate, asks this."""
    return lambda lab: ask(lab.settings, role, row, message, **parts)


def tells(role: Role, row: str, kind: str, make_message: Callable[[str], Words]) -> Callable[[SecuredSet], str]:
    """A try: `role` publishes to, or in the name of, the worker of that kind; the controller's ears are ours."""

    def do(lab: SecuredSet) -> str:
        name, inbox = lab.worker(kind), Inbox()
        listener: Role = "controller" if row == "heartbeat" else "ray-tracing" if kind == "ray" else "thin-film"
        forged = encode(make_message(name))
        with ZenohBus(lab.settings, role=listener) as ears, ZenohBus(lab.settings, role=role) as bus:
            ears.subscribe(at("luxloop", row, kind=kind), inbox)
            time.sleep(WAIT_S / 2)  # until the router knows
            bus.publish(at("luxloop", row, kind=kind, worker=name), forged)
            end_s = time.monotonic() + WAIT_S
            while (left_s := end_s - time.monotonic()) > 0:
                event = inbox.take(left_s)
                if isinstance(event, Heard) and event.frame == forged:
                    raise GotThroughError("it was heard")
        return "nobody hears it"

    return do


def announces(role: Role, /, **parts: str) -> Callable[[SecuredSet], str]:
    """A try: `role` claims to be present as somebody else."""

    def do(lab: SecuredSet) -> str:
        key = at("luxloop", "alive", name="intruder", **parts)
        with ZenohBus(lab.settings, role=role) as bus, ZenohBus(lab.settings) as honest:
            bus.announce(key)
            time.sleep(WAIT_S)
            if key in honest.present(at("luxloop", "alive")):
                raise GotThroughError("it is seen")
        return "nobody sees it"

    return do


def answers(role: Role, row: str) -> Callable[[SecuredSet], str]:
    """A try: `role` offers to answer in the controller's place; an honest client asks."""

    def do(lab: SecuredSet) -> str:
        inbox = Inbox()
        with ZenohBus(lab.settings, role=role) as bus, ZenohBus(lab.settings) as honest:
            bus.answer(at("luxloop", row), inbox)
            time.sleep(WAIT_S / 2)
            honest.ask(at("luxloop", row), encode(StatusAsked()), ASK_S)
            if inbox.take(WAIT_S) is not None:
                raise GotThroughError("it was asked")
        return "it is never asked"

    return do


def listens(role: Role, key: str) -> Callable[[SecuredSet], str]:
    """A try: `role` listens to everything; heartbeats go by five times a second."""

    def do(lab: SecuredSet) -> str:
        inbox = Inbox()
        with ZenohBus(lab.settings, role=role) as bus:
            bus.subscribe(key, inbox)
            if inbox.take(2 * WAIT_S) is not None:
                raise GotThroughError("it heard something")
        return "it hears nothing"

    return do


def admin_space(lab: SecuredSet) -> str:
    """Ask the router itself who is connected."""
    with ZenohBus(lab.settings) as bus:
        own = str(bus._session.zid())  # a session answers about itself, without the router
        replies = [reply.ok for reply in bus._session.get("@/**", timeout=ASK_S) if reply.ok is not None]
        if any(not str(sample.key_expr).startswith(f"@/{own}/") for sample in replies):
            raise GotThroughError("the router told")
    return "the router does not answer"


# who uses its own keys and lies inside the message


def lies(row: str, make_message: Callable[[str], Words]) -> Callable[[SecuredSet], str]:
    """A try: the thin-film role speaks on a key of its own in the name of the ray worker: the controller must see."""

    def do(lab: SecuredSet) -> str:
        with ZenohBus(lab.settings, role="thin-film") as bus:
            frame = bus.ask(at("luxloop", row, kind="film"), encode(make_message(lab.worker("ray"))), ASK_S)
        failure = decode(frame).message
        if not isinstance(failure, Failure) or failure.code != "bad_input":
            raise GotThroughError(f"the controller took it: {failure}")
        return told(failure)

    return do


def buries(lab: SecuredSet) -> str:
    """The thin-film role announces the ray worker's name under its own kind, and leaves: is the ray worker struck?"""
    lab.client.run(Task(kind="ray", inputs={"design": {"distance_um": 1.0, "width_um": 1.0}}, version=__version__))
    before = ray_worker(lab)
    with ZenohBus(lab.settings, role="thin-film") as bus:
        bus.announce(at("luxloop", "alive", role="worker", kind="film", name=before.describe.worker))
        time.sleep(WAIT_S / 2)
    time.sleep(WAIT_S)
    if ray_worker(lab).finished < before.finished:  # it was struck, said hello again, and began at 0
        raise GotThroughError("the controller struck the ray worker off")
    return "the ray worker stays on the list"


def ray_worker(lab: SecuredSet) -> WorkerStatus:
    """The ray worker as the controller knows it."""
    return next(worker for worker in lab.client.status(5.0).workers if worker.describe.kind == "ray")


def malformed(frame: bytes, code: str) -> Callable[[SecuredSet], str]:
    """A try: an honest role sends what is no message; it must be answered as such."""

    def do(lab: SecuredSet) -> str:
        with ZenohBus(lab.settings) as bus:
            failure = decode(bus.ask(at("luxloop", "submit", kind="ray"), frame, 10.0)).expect(Failure)
        if failure.code != code:
            raise GotThroughError(f"{failure.code} where {code} was due")
        return told(failure)[:110]

    return do


def flood(lab: SecuredSet) -> str:
    """100 MB in one message."""
    with ZenohBus(lab.settings) as bus:
        try:
            failure = decode(bus.ask(at("luxloop", "submit", kind="ray"), bytes(100 << 20), 3.0)).message
        except LuxloopError:
            return "nothing is delivered, the sender is cut off"
    if not isinstance(failure, Failure):
        raise GotThroughError("it was taken")
    return told(failure)[:110]


def expires(lab: SecuredSet) -> str:
    """A session that was opened in time goes on after the certificate's end."""
    with ZenohBus(lab.papers("expiring", begin=-DAY, end=DAY * 3 / 86400)) as bus:
        bus.ask(at("luxloop", "status"), encode(StatusAsked()), ASK_S)
        wait_for(lambda: not bus.connected(), "the router to end the session")
        time.sleep(1.1)  # a certificate ends with its last second
        try:
            bus.ask(at("luxloop", "status"), encode(StatusAsked()), ASK_S)
        except RemoteError as error:
            return f"the session is ended; {told(error.failure)}"
    raise GotThroughError("it was answered")


def describe(kind: str, name: str = "intruder") -> Hello:
    """A worker's introduction."""
    return Hello(describe=Describe(worker=name, kind=kind, version=__version__, host="h", pid=1))


def result(name: str, kind: str) -> Done:
    """A false result."""
    return Done(worker=name, kind=kind, attempt=1, epoch="e", outcome=Outcome(task_id=TASK.id, result={}))


def beat(name: str) -> Heartbeat:
    """A false heartbeat."""
    return Heartbeat(worker=name, kind="ray", note="forged")


def stop_it(name: str) -> Cancel:
    """A false cancellation."""
    return Cancel(task_id=TASK.id, attempt=1)


SUBMIT = Submit(task=TASK, asker="intruder")
END = End(run="r", designer="intruder", reason="because")
NO_SESSION = (
    Try("nobody", "no certificate", no_certificate),
    Try("nobody", "plain tcp to the TLS port", plain_to_tls),
    Try("nobody", "1 MB of zeros to the TLS port", garbage),
    Try("nobody", f"{SILENT} silent connections", silent_connections),
    Try("another lab", "its own set, CA of the same name", of_another_set),
    Try(
        "another lab",
        "our CA's certificate, a client's of another CA",
        lambda lab: session(lab.papers("other-ca", authority=Authority.new())),
    ),
    Try("client", "expired yesterday", lambda lab: session(lab.papers("expired", begin=-2 * DAY, end=-DAY))),
    Try("client", "valid from tomorrow", lambda lab: session(lab.papers("early", begin=DAY, end=2 * DAY))),
    Try("client", "certificate ends while connected", expires),
    Try("client", "its key in the router's place", false_router),
    Try("(a router)", "without certificates, our client comes", tls_to_plain),
)
NOT_PERMITTED = (
    Try(
        "guest",
        "CN of no role: asks status",
        lambda lab: ask(lab.papers("guest", role="guest"), "client", "status", StatusAsked()),
    ),
    Try("router", "asks status", asks("router", "status", StatusAsked())),
    Try("thin-film", "submits a task", asks("thin-film", "submit", SUBMIT, kind="ray")),
    Try("ray-tracing", "submits a task of its kind", asks("ray-tracing", "submit", SUBMIT, kind="ray")),
    Try("ray-tracing", "asks status", asks("ray-tracing", "status", StatusAsked())),
    Try("ray-tracing", "ends a run", asks("ray-tracing", "end", END, name="r")),
    Try("thin-film", "withdraws a task", asks("thin-film", "withdraw", Withdraw(task_id=TASK.id, asker="x"))),
    Try("thin-film", "hello as a ray worker", asks("thin-film", "hello", describe("ray"), kind="ray")),
    Try(
        "thin-film", "pulls ray tasks", asks("thin-film", "pull", Pull(worker="x", kind="ray", epoch="e"), kind="ray")
    ),
    Try("thin-film", "delivers done/ray", asks("thin-film", "done", result("x", "ray"), kind="ray")),
    Try("client", "hello as a worker", asks("client", "hello", describe("ray"), kind="ray")),
    Try("client", "pulls", asks("client", "pull", Pull(worker="x", kind="ray", epoch="e"), kind="ray")),
    Try("client", "delivers", asks("client", "done", result("x", "ray"), kind="ray")),
    Try("controller", "submits", asks("controller", "submit", SUBMIT, kind="ray")),
    Try("client", "asks everything (**)", asks("client", "**", StatusAsked())),
    Try("client", "asks the router who is there", admin_space),
    Try("thin-film", "beats for the ray worker", tells("thin-film", "heartbeat", "ray", beat)),
    Try("client", "beats for the ray worker", tells("client", "heartbeat", "ray", beat)),
    Try("client", "cancels at the ray worker", tells("client", "cancel", "ray", stop_it)),
    Try("thin-film", "cancels at the ray worker", tells("thin-film", "cancel", "ray", stop_it)),
    Try("client", "announces a controller", announces("client", role="controller", kind="controller")),
    Try("thin-film", "announces a controller", announces("thin-film", role="controller", kind="controller")),
    Try("thin-film", "announces a ray worker", announces("thin-film", role="worker", kind="ray")),
    Try("client", "answers status for the controller", answers("client", "status")),
    Try("ray-tracing", "answers status for the controller", answers("ray-tracing", "status")),
    Try("client", "listens to **", listens("client", "**")),
    Try("thin-film", "listens to heartbeats", listens("thin-film", at("luxloop", "heartbeat"))),
)
SEEN_BY_THE_CONTROLLER = (
    Try("thin-film", "hello/film, kind ray inside", lies("hello", lambda _: describe("ray"))),
    Try("thin-film", "hello/film in the ray worker's name", lies("hello", lambda name: describe("film", name))),
    Try(
        "thin-film",
        "pull/film in the ray worker's name",
        lies("pull", lambda name: Pull(worker=name, kind="film", epoch="e")),
    ),
    Try("thin-film", "done/film in the ray worker's name", lies("done", lambda name: result(name, "film"))),
    Try("thin-film", "buries the ray worker under its own kind", buries),
    Try("client", "garbage as a frame", malformed(b"garbage" * 10, "bad_input")),
    Try("client", "a frame cut short", malformed(encode(SUBMIT)[:60], "bad_input")),
    Try("client", f"{(FRAME_BYTES >> 20) + 4} MB in a frame", malformed(bytes(FRAME_BYTES + (4 << 20)), "too_large")),
    Try("client", "100 MB in a message", flood),
)
TRIES = (*NO_SESSION, *NOT_PERMITTED, *SEEN_BY_THE_CONTROLLER)
