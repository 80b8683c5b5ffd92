"""The bus's promises, once, against zenoh with a real router and against the in-process bus."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from luxloop.bus import Asked, Bus, Heard, Inbox, Interrupt, Presence, ask_for, busy, too_large
from luxloop.bus.frame import FRAME_BYTES, decode, encode
from luxloop.bus.keys import at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.errors import RemoteError
from luxloop.failure import Failure
from luxloop.messages import Nothing, StatusAsked
from luxloop.settings import Settings, as_environment
from tests.conftest import start, state_of, stop, wait_for
from tests.forks import Process

NewBus = Callable[[], Bus]
STATUS = at("luxloop", "status")
PING = encode(StatusAsked())


def serving(bus: Bus, key: str, work: Callable[[Asked], None], size: int = 64) -> Inbox:
    """Answer queries on `key` in a thread of our own with `work`."""
    inbox = Inbox(size)
    bus.answer(key, inbox)

    def loop() -> None:
        while True:
            event = inbox.take(0.2)
            if isinstance(event, Asked):
                work(event)

    threading.Thread(target=loop, daemon=True).start()
    time.sleep(0.05)  # let the declaration reach the router; an ask before it is a different test
    return inbox


def failure_of(ask: Callable[[], object]) -> Failure:
    """The typed failure that `ask` raises."""
    with pytest.raises(RemoteError) as caught:
        ask()
    return caught.value.failure


def test_a_question_gets_the_answer(new_bus: NewBus) -> None:
    """What one party answers is what the other gets, byte for byte."""
    server, client = new_bus(), new_bus()
    serving(server, STATUS, lambda asked: asked.answer(b"answer to " + asked.frame))
    assert client.ask(STATUS, b"question", 5.0) == b"answer to question"


def test_many_threads_may_ask_at_once(new_bus: NewBus) -> None:
    """Each of 8 threads gets the answers to its own 25 questions."""
    server, client = new_bus(), new_bus()
    serving(server, STATUS, lambda asked: asked.answer(asked.frame[::-1]))
    wrong: list[bytes] = []

    def asker(number: int) -> None:
        for i in range(25):
            text = f"{number}-{i}".encode()
            if client.ask(STATUS, text, 10.0) != text[::-1]:
                wrong.append(text)

    threads = [threading.Thread(target=asker, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert wrong == []


def test_a_failure_as_answer_is_raised_with_its_fields(new_bus: NewBus) -> None:
    """A typed failure crosses the bus and comes out as RemoteError with the same fields."""
    server, client = new_bus(), new_bus()
    sent = Failure(code="bad_input", message="no", field="thickness_nm", value="-1", allowed=">= 0", mend="mend it")
    serving(server, STATUS, lambda asked: asked.reply(sent))
    assert failure_of(lambda: ask_for(client, STATUS, StatusAsked(), 5.0)) == sent


def test_nobody_there_is_no_controller_at_once(new_bus: NewBus) -> None:
    """Nobody answering ends with the typed failure, not with an empty answer or, a minute later, a time-out."""
    client = new_bus()
    assert failure_of(lambda: client.ask(STATUS, PING, 60.0)).code == "no_controller"


def test_a_dropped_question_is_refused_not_empty(new_bus: NewBus) -> None:
    """A party that is alive and drops the question (a denial, an exception) shows as `refused`."""
    server, client = new_bus(), new_bus()
    server.announce(at("luxloop", "alive", role="controller", kind="controller", name="c1"))
    serving(server, STATUS, lambda asked: asked.drop())
    time.sleep(0.1)
    assert failure_of(lambda: client.ask(STATUS, PING, 5.0)).code == "refused"


def test_no_answer_in_time_is_timed_out(new_bus: NewBus) -> None:
    """A question that is kept and never answered ends by its limit, as `timed_out`."""
    server, client = new_bus(), new_bus()
    kept: list[Asked] = []
    serving(server, STATUS, kept.append)
    assert failure_of(lambda: client.ask(STATUS, PING, 0.4)).code == "timed_out"


def test_a_held_question_can_be_withdrawn(new_bus: NewBus) -> None:
    """Setting the event ends a held question as `cancelled`, long before its time limit."""
    server, client = new_bus(), new_bus()
    kept: list[Asked] = []
    serving(server, STATUS, kept.append)
    cancelled = Interrupt()
    threading.Timer(0.2, cancelled.set).start()
    begin = time.monotonic()
    assert failure_of(lambda: client.ask(STATUS, PING, 120.0, cancelled)).code == "cancelled"
    assert time.monotonic() - begin < 60.0


def test_the_death_of_the_answerer_ends_the_question(new_bus: NewBus) -> None:
    """When the party that holds a question goes, the asker is told that, and not at its time limit `timed_out`."""
    server, client = new_bus(), new_bus()
    kept: list[Asked] = []
    serving(server, STATUS, kept.append)
    threading.Timer(0.3, server.close).start()
    assert failure_of(lambda: client.ask(STATUS, PING, 60.0)).code in ("no_controller", "refused")


def test_a_full_inbox_answers_busy(new_bus: NewBus) -> None:
    """When nobody empties a bounded inbox, the question after the last place is answered `busy`, none is lost."""
    server, client = new_bus(), new_bus()
    inbox = Inbox(2)
    server.answer(STATUS, inbox)
    time.sleep(0.05)
    codes: list[str] = []
    askers = [
        threading.Thread(target=lambda: codes.append(failure_of(lambda: client.ask(STATUS, PING, 2.0)).code))
        for _ in range(2)
    ]
    for asker in askers:
        asker.start()
    wait_for(lambda: len(inbox) == 2, "the inbox to fill")
    assert decode(client.ask(STATUS, PING, 5.0)).expect(Failure).code == "busy"
    for asker in askers:
        asker.join(10)
    assert codes == ["timed_out", "timed_out"]


def test_thousands_of_unread_publications_do_not_block_the_bus(new_bus: NewBus) -> None:
    """A reader that never reads loses publications, counted; questions on the same session still get answers."""
    server, client = new_bus(), new_bus()
    full = Inbox(4)
    server.subscribe("luxloop/1/heartbeat/**", full)
    serving(server, STATUS, lambda asked: asked.answer(b"alive"))
    for _ in range(2000):
        client.publish("luxloop/1/heartbeat/film/w1", PING)
    assert client.ask(STATUS, PING, 10.0) == b"alive"
    assert len(full) == 4
    assert full.dropped > 1000


def test_publications_arrive_in_order(new_bus: NewBus) -> None:
    """A subscriber that keeps up gets what was published, in order."""
    server, client = new_bus(), new_bus()
    inbox = Inbox()
    server.subscribe("luxloop/1/heartbeat/**", inbox)
    time.sleep(0.1)
    for i in range(50):
        client.publish("luxloop/1/heartbeat/film/w1", str(i).encode())
    heard = [event.frame for event in (inbox.take(5.0) for _ in range(50)) if isinstance(event, Heard)]
    assert heard == [str(i).encode() for i in range(50)]


def test_presence_comes_and_goes(new_bus: NewBus) -> None:
    """A watcher sees tokens held before it came, new ones, and their end when the holder closes."""
    watcher, asker, early, late = new_bus(), new_bus(), new_bus(), new_bus()
    expr = at("luxloop", "alive", role="worker")
    keys = [at("luxloop", "alive", role="worker", kind="film", name=name) for name in ("w1", "w2")]
    early.announce(keys[0])
    wait_for(lambda: asker.present(expr) == {keys[0]}, "the first token")
    inbox = Inbox()
    watcher.watch(expr, inbox)
    late.announce(keys[1])
    seen = {event for event in (inbox.take(5.0), inbox.take(5.0)) if event is not None}
    assert seen == {Presence(keys[0], alive=True), Presence(keys[1], alive=True)}
    late.close()
    assert inbox.take(5.0) == Presence(keys[1], alive=False)
    assert asker.present(expr) == {keys[0]}


def test_who_is_there_is_not_said_where_the_router_does_not_answer(router: Process, settings: Settings) -> None:
    """Stopped or gone: a failure, not "nobody", which would close the runs of designers that wait."""
    token = at("luxloop", "alive", role="designer", kind="designer", name="d1")
    with ZenohBus(settings) as designer, ZenohBus(settings) as asker:
        designer.announce(token)
        wait_for(lambda: asker.present(token) == {token}, "the token")
        router.send_signal(signal.SIGSTOP)
        # on a busy machine a thread of it goes on for a moment, and answers
        wait_for(lambda: state_of(router.pid) == "T", "the router to stand still")
        try:
            assert failure_of(lambda: asker.present(token)).code == "timed_out"
        finally:
            router.send_signal(signal.SIGCONT)
        stop(router)
        wait_for(lambda: not asker.connected(), "the loss to be seen")
        assert failure_of(lambda: asker.present(token)).code == "no_router"


def test_presence_is_kept_when_the_inbox_is_full() -> None:
    """The loss of a worker is never among what a full inbox drops."""
    inbox = Inbox(1)
    assert inbox.offer(Heard("k", b""))
    assert not inbox.offer(Heard("k", b""))
    assert inbox.offer(Presence("k", alive=False))
    assert [inbox.take(0.1), inbox.take(0.1)] == [Heard("k", b""), Presence("k", alive=False)]


def test_what_a_bus_refuses_may_have_a_key_of_any_length() -> None:
    """`busy` and `too_large` name it as far as there is room."""
    for frame in (busy("k" * 5000), too_large(20, 16, "k" * 5000)):
        assert decode(frame).expect(Failure).where.startswith("kkk")


def test_a_too_large_request_is_answered_and_the_server_goes_on(new_bus: NewBus) -> None:
    """20 MB arrive at a party that takes 16: `too_large` with size and limit; the next question is answered."""
    server, client = new_bus(), new_bus()
    serving(server, STATUS, lambda asked: asked.answer(b"fine"))
    answer = decode(client.ask(STATUS, bytes(20 << 20), 20.0)).expect(Failure)
    assert answer.code == "too_large"
    assert str(FRAME_BYTES) in answer.allowed
    assert client.ask(STATUS, PING, 5.0) == b"fine"


def test_no_router_is_said_within_seconds(settings: Settings) -> None:
    """Without a router the session does not open, and the error names the endpoint and the mend."""
    failure = failure_of(lambda: ZenohBus(settings))
    assert failure.code == "no_router"
    assert settings.router in failure.message
    assert "luxloop serve" in failure.mend


def test_100_mb_to_a_zenoh_party_leave_it_alive(router: object, settings: Settings) -> None:
    """A hostile 100 MB message is not delivered, nothing crashes, and an honest question is answered after it."""
    with ZenohBus(settings) as server, ZenohBus(settings) as hostile, ZenohBus(settings) as client:
        serving(server, STATUS, lambda asked: asked.answer(b"fine"))
        failure_of(lambda: decode(hostile.ask(STATUS, bytes(100 << 20), 10.0)).expect(Nothing))
        assert client.ask(STATUS, PING, 10.0) == b"fine"


def test_everything_comes_back_after_a_router_restart(router: Process, settings: Settings) -> None:
    """Tokens and queryables of patient sessions work again after the router was killed and restarted."""
    token = at("luxloop", "alive", role="controller", kind="controller", name="c1")
    with ZenohBus(settings, patient=True) as server, ZenohBus(settings, patient=True) as client:
        server.announce(token)
        serving(server, STATUS, lambda asked: asked.answer(b"fine"))
        assert client.ask(STATUS, PING, 5.0) == b"fine"
        stop(router)
        wait_for(lambda: not client.connected(), "the loss to be seen")
        assert failure_of(lambda: client.ask(STATUS, PING, 5.0)).code == "no_router"
        again = start(settings, "-m", "luxloop", "serve", "router")
        try:
            wait_for(lambda: client.connected() and client.present(token), "the router to be back", 30.0)
            assert client.ask(STATUS, PING, 5.0) == b"fine"
        finally:
            stop(again)


@pytest.mark.parametrize("how", ["interrupted", "left behind"])
def test_a_worker_that_waits_for_a_router_can_be_ended(settings: Settings, how: str) -> None:
    """By Ctrl-C, and where who started it has gone: zenoh's own waiting knew of neither."""
    environment = as_environment(settings) | ({"LUXLOOP_WITH_PARENT": "1"} if how == "left behind" else {})
    code = (
        "from luxloop.bus.zenoh_bus import ZenohBus; from luxloop.settings import load_settings; import signal\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # children of a background shell ignore it
        "print('waits', flush=True)\nZenohBus(load_settings(), patient=True)\n"
    )
    argv, null = [sys.executable, "-c", code], subprocess.DEVNULL
    with subprocess.Popen(argv, env=environment, stdout=subprocess.PIPE, stderr=null) as waits:
        assert waits.stdout is not None
        assert waits.stdout.readline() == b"waits\n"
        time.sleep(0.5)
        if how == "interrupted":
            waits.send_signal(signal.SIGINT)
        try:
            assert waits.wait(10.0) != 0
        finally:
            waits.kill()


def test_what_zenoh_logs_does_not_stand_in_a_commands_answer(router: object, settings: Settings) -> None:
    """RUST_LOG is for processes that serve: zenoh writes to stdout, where `--json` has its one object."""
    code = "from luxloop.bus.zenoh_bus import ZenohBus; from luxloop.settings import load_settings\n"
    environment = as_environment(settings) | {"RUST_LOG": "debug"}
    argv = [sys.executable, "-c", code + "with ZenohBus(load_settings()): print('answer')"]
    assert subprocess.run(argv, env=environment, capture_output=True, check=True).stdout == b"answer\n"


def test_what_a_set_of_ones_own_prints_does_not_stand_in_a_commands_answer(
    settings: Settings, tmp_path: Path
) -> None:
    """A user's effect may: its workers write to stderr."""
    prints = tmp_path / "prints"
    prints.write_text("#!/bin/sh\necho noise\n")
    prints.chmod(0o700)
    code = (
        "import luxloop.client as client; from luxloop.errors import RemoteError; import sys\n"
        "from luxloop.settings import load_settings\n"
        "sys.executable = sys.argv[1]\n"
        "try: client.Client(load_settings())\n"
        "except RemoteError: print('answer')\n"
    )
    argv = [sys.executable, "-c", code, str(prints)]
    done = subprocess.run(argv, env=as_environment(settings), capture_output=True, check=True)
    assert (done.stdout, done.stderr) == (b"answer\n", b"noise\n")


def test_a_process_with_an_open_session_ends_when_it_raises(router: object, settings: Settings) -> None:
    """An uncaught exception inside `with` ends the interpreter: no callback keeps it alive."""
    code = (
        "from luxloop.bus.zenoh_bus import ZenohBus; from luxloop.bus import Inbox\n"
        "from luxloop.settings import Settings\n"
        "with ZenohBus(Settings()) as bus:\n"
        "    bus.answer('luxloop/1/status', Inbox()); bus.subscribe('luxloop/1/heartbeat/**', Inbox())\n"
        "    raise SystemExit(7)\n"
    )
    process = start(settings, "-c", code)
    try:
        assert process.wait(15) == 7
    finally:
        stop(process)
