"""What the benchmarks share: a set of real processes, percentiles, a table on stdout."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType

from luxloop.client import Client
from luxloop.errors import RemoteError
from luxloop.settings import Settings, as_environment

os.environ.setdefault("LUXLOOP_KERNELS", str(Path("~/.cache/luxloop/kernels").expanduser()))  # compiled at set-up
SLEEPY = str(Path(__file__).parents[1] / "tests" / "sleepy_worker.py")
THIN_FILM = ("-m", "luxloop", "serve", "thin-film", "--quiet")


class Processes:
    """A router, a controller and workers with a port and a cache folder of their own."""

    def __init__(self, *workers: Sequence[str], silence_s: float = 6.0) -> None:
        self._folder = tempfile.TemporaryDirectory()
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        folder = Path(self._folder.name)
        self.settings = Settings(router=endpoint, cache=folder, runs=folder / "runs", silence_s=silence_s)
        self.router = self.start("-m", "luxloop", "serve", "router", "--quiet")
        self.controller = self.start("-m", "luxloop", "serve", "controller", "--quiet")
        self.workers = [self.start(*worker) for worker in workers]
        wait_for(self._answers)
        self.client = Client(self.settings, local=False)
        wait_for(lambda: len(self.client.status(5.0).workers) == len(workers))

    def start(self, *argv: str) -> subprocess.Popen[bytes]:
        """A process of this Python that sees the set's settings."""
        return subprocess.Popen([sys.executable, *argv], env=as_environment(self.settings), stdin=subprocess.DEVNULL)

    def _answers(self) -> bool:
        try:
            Client(self.settings, local=False).close()
        except RemoteError:
            return False
        return True

    def __enter__(self) -> Processes:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.client.close()
        for process in [*self.workers, self.controller, self.router]:
            process.kill()
            process.wait()
        self._folder.cleanup()


def wait_for(condition: Callable[[], object], limit_s: float = 60.0) -> float:
    """Seconds until `condition()` is true."""
    begin = time.monotonic()
    while not condition():
        if time.monotonic() - begin > limit_s:
            raise TimeoutError("waited in vain")
        time.sleep(0.005)
    return time.monotonic() - begin


def percentile(values: Sequence[float], percent: float) -> float:
    """The value below which `percent` of the values lie."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(len(ordered) * percent / 100))]


def table(title: str, rows: Sequence[Sequence[object]], heads: Sequence[str]) -> None:
    """Print rows under heads, columns aligned."""
    cells = [[str(cell) for cell in row] for row in [heads, *rows]]
    widths = [max(len(row[i]) for row in cells) for i in range(len(heads))]
    print(f"\n{title}")
    for row in cells:
        print("  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def memory_mb(pid: int) -> tuple[float, float]:
    """Resident and anonymous memory of a process in MB."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    kb = {line.split(":")[0]: int(line.split()[1]) for line in text.splitlines()[1:]}
    return kb["Rss"] / 1e3, kb["Anonymous"] / 1e3
