"""Workers that say hello again, as after a link that was cut: nothing that is on its way to them is lost."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from luxloop.bus.frame import encode
from luxloop.bus.keys import at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.client import Answer
from luxloop.messages import Introduce
from luxloop.settings import Settings
from tests.env_controller.test_set import Set, task


@pytest.fixture
def processes(settings: Settings) -> Iterator[Set]:
    """A running set with no worker yet."""
    running = Set(settings)
    yield running
    running.close()


def test_a_call_to_introduce_itself_costs_a_worker_no_lease(processes: Set) -> None:
    """Told again and again to say hello while tasks come and go: no lease is taken for lost on its way."""
    processes.add_worker()
    processes.ready(1)
    (worker,) = (one.describe.worker for one in processes.client.status().workers)
    key = at(processes.settings.realm, "cancel", kind="sleepy", worker=worker)
    done = threading.Event()

    def call() -> None:
        with ZenohBus(processes.settings) as bus:
            while not done.wait(0.002):
                bus.publish(key, encode(Introduce()))

    calling = threading.Thread(target=call)
    calling.start()
    try:
        wanted = (task("nothing", number=number) for number in range(200))
        answers = [answer for _, answer in processes.client.map(wanted, lanes=1)]
    finally:
        done.set()
        calling.join()
    assert all(isinstance(answer, Answer) for answer in answers)
    assert processes.client.status().requeued == 0
