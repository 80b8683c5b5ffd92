"""Processes forked from one that has imported everything: real ones, without a second of imports each.

A test process starts its own such server when it first needs it; the server ends with it. Where there is no safe
fork (not Linux), or with LUXLOOP_TESTS_FORK=0, each process is one of the interpreter's own, as a user's is.
"""

from __future__ import annotations

import atexit
import gc
import json
import os
import runpy
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import IO

IMPORTED = (
    "luxloop.bus.zenoh_bus", "luxloop.client", "containers.ray_tracing.worker", "containers.thin_film.worker",
    "env_controller.serve", "env_controller.local_set", "agent.launch", "torch", "validation.diagnosing",
    "validation.compare_command", "validation.blind_command",
)  # fmt: skip
"""What commands and processes import when they run; the commands themselves come with the front door."""


class Forked:
    """A process of the server's, with what `subprocess.Popen` has for it."""

    def __init__(
        self, argv: tuple[str, ...], env: Mapping[str, str], cwd: Path | None, streams: tuple[int, int, int]
    ) -> None:
        self.args, self.returncode = argv, None
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(_server() or "")
        wanted = json.dumps({"argv": argv, "env": dict(env), "cwd": str(cwd or Path.cwd())}).encode()
        socket.send_fds(self._socket, [len(wanted).to_bytes(4, "big")], streams)
        self._socket.sendall(wanted)
        self.pid = int(_line(self._socket))

    returncode: int | None

    def poll(self) -> int | None:
        """The exit code, or None while it runs."""
        return self._ended(0.0)

    def wait(self, timeout: float | None = None) -> int:
        """The exit code; TimeoutExpired where it takes longer."""
        if self._ended(timeout) is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        assert self.returncode is not None
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Nothing happens where it has ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self.send_signal(signal.SIGKILL)

    def _ended(self, timeout: float | None) -> int | None:
        if self.returncode is None:
            self._socket.settimeout(max(timeout, 1e-4) if timeout is not None else None)
            with suppress(TimeoutError):
                self.returncode = int(_line(self._socket))
                self._socket.close()
        return self.returncode


class Telling(Forked):
    """One whose words are kept."""

    def __init__(self, argv: tuple[str, ...], env: Mapping[str, str], cwd: Path | None) -> None:
        self._said = [tempfile.TemporaryFile("w+") for _ in range(2)]  # noqa: SIM115 closed when they were read
        with open(os.devnull) as nothing:
            out, err = (said.fileno() for said in self._said)
            super().__init__(argv, env, cwd, (nothing.fileno(), out, err))

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """What it wrote to stdout and stderr, when it has ended. To be asked once."""
        self.wait(timeout)
        out, err = (_whole(said) for said in self._said)
        return out, err


Process = subprocess.Popen[bytes] | Forked


def start(*argv: str, env: Mapping[str, str], cwd: Path | None = None) -> Process:
    """`python ARGV`, without input; what it says goes where ours goes."""
    if not _forks():
        return subprocess.Popen([sys.executable, *argv], env=env, cwd=cwd, stdin=subprocess.DEVNULL)
    with open(os.devnull) as nothing:
        return Forked(argv, env, cwd, (nothing.fileno(), 1, 2))


def begin(
    *argv: str, env: Mapping[str, str] | None = None, cwd: Path | None = None
) -> subprocess.Popen[str] | Telling:
    """`luxloop ARGV` under way; `communicate` waits for its end, and gives what it said."""
    whole, env = ("-m", "luxloop", *argv), os.environ if env is None else env
    if _forks():
        return Telling(whole, env, cwd)
    return subprocess.Popen(
        [sys.executable, *whole], env=env, cwd=cwd, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def luxloop(
    *argv: str, env: Mapping[str, str] | None = None, cwd: Path | None = None, timeout: float = 60.0
) -> subprocess.CompletedProcess[str]:
    """`luxloop ARGV` to its end: exit code, and what it said. TimeoutExpired after `timeout` seconds."""
    process = begin(*argv, env=env, cwd=cwd)
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(10.0)
        raise
    return subprocess.CompletedProcess(["luxloop", *argv], process.wait(), out, err)


def _forks() -> bool:
    return sys.platform == "linux" and os.environ.get("LUXLOOP_TESTS_FORK") != "0" and _server() is not None


def _whole(said: IO[str]) -> str:
    with said:
        said.seek(0)
        return said.read()


def _line(connection: socket.socket) -> str:
    """A number on a line of its own; EOFError where the server has gone."""
    text = b""
    while not text.endswith(b"\n"):
        got = connection.recv(16)
        if not got:
            raise EOFError("the server of forks has gone")
        text += got
    return text.decode()


@cache
def _server() -> str | None:
    """Where this process's server listens, started by the first call; None where it cannot be, and has said why."""
    folder = tempfile.TemporaryDirectory(prefix="luxloop-forks-")
    path = str(Path(folder.name) / "socket")
    ours, theirs = socket.socketpair()  # it sees our end close when we are gone, however we go
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.forks", path, str(theirs.fileno())], pass_fds=[theirs.fileno()],
        stdin=subprocess.DEVNULL,
    )  # fmt: skip
    theirs.close()

    def end() -> None:
        ours.close()
        process.wait(10)
        folder.cleanup()

    if ours.recv(1) != b"+":
        end()
        return None
    atexit.register(end)
    return path


class _Server:
    """Forks a child for each connection, and tells there when it has ended. One thread, nothing computed."""

    def __init__(self, path: str, asker: socket.socket) -> None:
        self._asker, self._asked = asker, socket.socket(socket.AF_UNIX)
        self._asked.bind(path)
        self._asked.listen(64)
        self._children: dict[int, socket.socket] = {}
        self._ended, self._wake = socket.socketpair()
        for one in (self._ended, self._wake):
            one.setblocking(False)
        signal.set_wakeup_fd(self._wake.fileno(), warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)

    def serve(self) -> tuple[str, ...] | None:
        """In a child: what it is to run, its streams, environment and folder being as asked. In the server: None."""
        ready = selectors.DefaultSelector()
        for one in (self._asker, self._asked, self._ended):
            ready.register(one, selectors.EVENT_READ)
        self._asker.sendall(b"+")
        while True:
            for key, _ in ready.select():
                if key.fileobj is self._asker:
                    return None
                if key.fileobj is self._ended:
                    self._reap()
                elif (wanted := self._fork()) is not None:
                    ready.close()
                    return wanted

    def _reap(self) -> None:
        with suppress(BlockingIOError):
            self._ended.recv(4096)
        while self._children:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                return
            connection = self._children.pop(pid)
            with suppress(OSError):  # who asked has gone
                connection.sendall(b"%d\n" % os.waitstatus_to_exitcode(status))
            connection.close()

    def _fork(self) -> tuple[str, ...] | None:
        connection, _ = self._asked.accept()
        length, streams, *_ = socket.recv_fds(connection, 4, 3)
        wanted = b""
        while len(wanted) < int.from_bytes(length, "big"):
            wanted += connection.recv(65536)
        asked = json.loads(wanted)
        if pid := os.fork():
            self._children[pid] = connection
            connection.sendall(b"%d\n" % pid)
            for stream in streams:
                os.close(stream)
            return None
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for held in (connection, self._asker, self._asked, self._ended, self._wake, *self._children.values()):
            held.close()
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        os.environ.clear()
        os.environ.update(asked["env"])
        os.chdir(asked["cwd"])
        return tuple(asked["argv"])


def _main() -> None:
    """Import everything, then serve; a child goes on as the program that it was asked to be."""
    from luxloop.cli import app

    path, asker = sys.argv[1], socket.socket(fileno=int(sys.argv[2]))
    app()
    for module in IMPORTED:
        import_module(module)
    gc.freeze()  # what all children share stays shared
    if len(os.listdir("/proc/self/task")) > 1:
        sys.exit("tests: an import started a thread, so nothing is forked, and starts take longer")
    argv = _Server(path, asker).serve()
    if argv is None:
        return
    if argv[0] == "-m":
        sys.argv, sys.path[0] = [argv[1], *argv[2:]], os.getcwd()
        runpy.run_module(argv[1], run_name="__main__", alter_sys=True)
    elif argv[0] == "-c":
        sys.argv, sys.path[0] = ["-c", *argv[2:]], ""
        exec(compile(argv[1], "<string>", "exec"), {"__name__": "__main__"})  # noqa: S102 a test's own
    else:
        sys.argv, sys.path[0] = list(argv), str(Path(argv[0]).parent)
        runpy.run_path(argv[0], run_name="__main__")


if __name__ == "__main__":
    _main()
