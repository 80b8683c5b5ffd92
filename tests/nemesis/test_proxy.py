"""The proxy and the privileged faults do what the nemesis relies on."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from luxloop.endpoint import host_and_port
from tests.conftest import wait_for
from tests.nemesis.network import NotPermittedError, SmallDisk, Wire
from tests.nemesis.proxy import Proxy


@pytest.fixture
def echo() -> Iterator[str]:
    """The endpoint of a server that says everything again."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    end, _ = server.accept()
                except OSError:
                    return
                threading.Thread(target=say_again, args=(end,), daemon=True).start()

        def say_again(end: socket.socket) -> None:
            with end:
                try:
                    while data := end.recv(4096):
                        end.sendall(data)
                except ConnectionResetError:
                    return

        threading.Thread(target=serve, daemon=True).start()
        yield f"tcp/127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)


@pytest.fixture
def proxy(echo: str) -> Iterator[Proxy]:
    """A proxy before it."""
    made = Proxy(echo)
    yield made
    made.close()


@pytest.fixture
def end(proxy: Proxy) -> Iterator[socket.socket]:
    """A connection through it."""
    with socket.create_connection(host_and_port(proxy.endpoint), timeout=5.0) as made:
        yield made


def heard(end: socket.socket, size: int) -> bytes:
    """The next so many bytes."""
    data = b""
    while len(data) < size:
        data += end.recv(size - len(data))
    return data


def test_all_goes_through_in_order(proxy: Proxy, end: socket.socket) -> None:
    """Also when it is slow."""
    data = bytes(range(256)) * 64
    end.sendall(data)
    assert heard(end, len(data)) == data
    proxy.slow(1e6, 0.001)
    end.sendall(data)
    assert heard(end, len(data)) == data


def test_a_cut_link_holds_what_was_sent(proxy: Proxy, end: socket.socket) -> None:
    """Nothing comes until it is healed, and then all of it."""
    proxy.cut()
    end.sendall(b"anybody there?")
    end.settimeout(0.2)
    with pytest.raises(TimeoutError):
        end.recv(1)
    end.settimeout(5.0)
    proxy.heal()
    assert heard(end, 14) == b"anybody there?"


def test_a_reset_is_an_error_and_a_new_connection_works(proxy: Proxy, end: socket.socket) -> None:
    """As when a firewall forgets a connection."""
    end.sendall(b"hello")
    assert heard(end, 5) == b"hello"
    proxy.reset()
    end.settimeout(5.0)
    with pytest.raises(ConnectionResetError):
        end.recv(1)
    with socket.create_connection(host_and_port(proxy.endpoint), timeout=5.0) as again:
        again.sendall(b"hello")
        assert heard(again, 5) == b"hello"


def test_a_full_disk_takes_nothing_until_there_is_room(tmp_path: Path) -> None:
    """ENOSPC, and then it takes again."""
    try:
        with SmallDisk(tmp_path / "disk", size_mb=1) as disk:
            disk.fill()
            with pytest.raises(OSError, match="No space left"):
                (disk.folder / "more").write_bytes(bytes(10_000))
            disk.empty()
            assert (disk.folder / "more").write_bytes(bytes(10_000)) == 10_000
    except NotPermittedError as error:
        pytest.skip(str(error))


def test_a_pulled_wire_reaches_nobody() -> None:
    """From inside the namespace: a connection works, then it does not."""
    try:
        with Wire() as wire, socket.create_server((wire.host, 0)) as server:
            port = server.getsockname()[1]
            wait_for(lambda: reached(wire, port), "the wire to carry")
            wire.cut()
            assert not reached(wire, port)
            wire.heal()
            wait_for(lambda: reached(wire, port), "the wire to carry again")
    except NotPermittedError as error:
        pytest.skip(str(error))


def reached(wire: Wire, port: int) -> bool:
    """Whether a process inside can connect to this end."""
    code = f"import socket; socket.create_connection(({wire.host!r}, {port}), timeout=1.0)"
    done = subprocess.run([*wire.inside, sys.executable, "-c", code], capture_output=True, check=False)
    return done.returncode == 0
