"""A real set of processes that is looked after: what dies is started again, a designer that died is resumed.

    router ◀── controller, film, ray-1
       ▲────── link-ray ◀──── ray-2          links are TCP proxies
       ▲────── link-designer ◀ designer      one campaign at a time

`LUXLOOP_ATTEMPTS` is 20: the faults of a storm come so close together that a task may lose three workers in a row,
which would be its legitimate end, and the run another one. Results are not kept, or the second campaign of a kind
would need no worker.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from luxloop.errors import LuxloopError
from luxloop.journal.reader import RunJournal, segments_of
from luxloop.settings import Settings, as_environment
from tests.conftest import free_endpoint, wait_for
from tests.nemesis.history import History, Steps, digests_of
from tests.nemesis.network import Wire
from tests.nemesis.proxy import Proxy
from tests.nemesis.worker import GIL_FILE

ROOT = Path(__file__).parents[2]
PAUSE_S = 0.4  # what died is started again after this
LOOK_S = 0.05
LAUNCH, WORKER = ("-m", "tests.nemesis.launch"), ("-m", "tests.nemesis.worker")
SERVERS = ("router", "controller", "film", "ray-1", "ray-2")
MEMBERS = (*SERVERS, "designer")
LINKS = ("ray", "designer")


class Lab:
    """The set, its folder, its history. Leave it by `with`."""

    def __init__(self, folder: Path, *, mutant: str = "-", nap_s: float = 0.1, wire: Wire | None = None) -> None:
        self.folder, self._mutant, self._nap_s, self.wire = folder, mutant, nap_s, wire
        for name in ("orders", "logs", "runs", "cache"):
            (folder / name).mkdir(exist_ok=True)
        self.settings = Settings(
            router=free_endpoint(), attempts=20, keep_results_mb=0.0,
            cache=folder / "cache", runs=folder / "runs", effects=folder / "effects",
        )  # fmt: skip
        self.links = {
            "ray": Proxy(self.settings.router, wire.host if wire else "127.0.0.1"),
            "designer": Proxy(self.settings.router),
        }
        self.history = History(folder / "history.jsonl")
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.lock = threading.RLock()
        self.starts = dict.fromkeys(MEMBERS, 0)
        self.run, self._campaign = "", tuple[str, ...]()
        self.finished = threading.Event()
        self._since_s: dict[str, float] = {}
        self._died: dict[str, float] = {}
        self._closing = threading.Event()

    def __enter__(self) -> Lab:
        for name in SERVERS:
            self._start(name)
        self._watcher = threading.Thread(target=self._look_after, daemon=True)
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._watcher.join()
        for process in self.processes.values():
            process.kill()
            process.wait()
        for link in self.links.values():
            link.close()
        self.history.close()

    def begin(self, run: str, designer: str, evaluations: int, lanes: int = 4) -> None:
        """Start a campaign; `finished` is set when it has ended, however often it had to be resumed."""
        with self.lock:
            self.finished.clear()
            how = ("--designer", designer, "--evaluations", str(evaluations), "--lanes", str(lanes))
            self.run, self._campaign = run, ("run", "--id", run, *how)
            self._start("designer")

    def complete(self, run: str, designer: str, evaluations: int, lanes: int = 4, limit_s: float = 60.0) -> None:
        """A campaign from its begin to its end. Raises AssertionError where that takes longer."""
        self.begin(run, designer, evaluations, lanes)
        wait_for(self.finished.is_set, f"the end of {run}; see {self.folder}/logs", limit_s)

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a process a signal, if it is there."""
        with self.lock, suppress(KeyError, ProcessLookupError):
            self.processes[name].send_signal(number)

    def kill(self, *names: str) -> None:
        """SIGKILL, all of them in one moment; they have ended on return."""
        with self.lock:
            mine = [self.processes[name] for name in names if name in self.processes]
            for process in mine:
                process.kill()
            for process in mine:
                process.wait()

    def hold_gil(self, name: str, dwell_s: float) -> None:
        """A worker's Python stands still for so long."""
        (self.folder / "orders" / GIL_FILE).write_text(str(dwell_s))
        self.signal(name, signal.SIGUSR1)

    def order(self, kind: str, text: str) -> None:
        """Give whoever of a kind computes next an order, a JSON object."""
        path = self.folder / "orders" / f"{kind}-{time.monotonic_ns():020}.json"
        fresh = path.with_suffix(".new")
        fresh.write_text(text)
        fresh.rename(path)

    def told(self) -> int:
        """Steps told so far, each counted once."""
        return len(self.history.tellings(self.run))

    def on_record(self) -> Steps:
        """The steps that the run's journal holds; none where it has not begun."""
        try:
            return digests_of(RunJournal(self.settings.runs_dir / self.run).steps())
        except LuxloopError:
            return {}

    def resident_mb(self) -> dict[str, float]:
        """Resident memory of the processes that live."""
        found = {}
        for name in SERVERS:
            with suppress(OSError, KeyError):
                pages = Path(f"/proc/{self.processes[name].pid}/statm").read_text().split()[1]
                found[name] = int(pages) * os.sysconf("SC_PAGE_SIZE") / 1e6
        return found

    def ages_s(self) -> dict[str, float]:
        """For how long the processes have lived."""
        return {name: time.monotonic() - since_s for name, since_s in self._since_s.items()}

    def _look_after(self) -> None:
        while not self._closing.wait(LOOK_S):
            with self.lock:
                for name, process in list(self.processes.items()):
                    if process.poll() is not None and not (name == "designer" and self.finished.is_set()):
                        self._after(name, process)

    def _after(self, name: str, process: subprocess.Popen[bytes]) -> None:
        """Start what has ended again, after a pause."""
        died_s = self._died.setdefault(name, time.monotonic())
        if time.monotonic() - died_s < PAUSE_S:
            return
        del self._died[name]
        if name == "designer" and (process.returncode == 0 or self._said("has ended")):
            self.finished.set()
            return
        if name == "controller" and self.run:
            self.history.note("on record", run=self.run, steps=self.on_record())
        self._start(name)

    def _start(self, name: str) -> None:
        self.starts[name] += 1
        self._since_s[name] = time.monotonic()
        log = self._log(name).open("wb" if name == "designer" else "ab")
        ours, prefix = self._settings_of(name), tuple[str, ...]()
        if name == "ray-2" and self.wire is not None:
            prefix = self.wire.inside
        with log:
            self.processes[name] = subprocess.Popen(
                [*prefix, sys.executable, *self._argv(name)], cwd=ROOT, stdin=subprocess.DEVNULL, stdout=log,
                stderr=log, env=as_environment(ours) | {"LUXLOOP_WITH_PARENT": str(os.getpid())},
            )  # fmt: skip

    def _settings_of(self, name: str) -> Settings:
        link = {"ray-2": "ray", "designer": "designer"}.get(name)
        return self.settings.model_copy(update={"router": self.links[link].endpoint}) if link else self.settings

    def _argv(self, name: str) -> Sequence[str]:
        watched = (*LAUNCH, str(self.history.path), self._mutant)
        if name == "router":
            return ("-m", "luxloop", "serve", "router", "--quiet")
        if name == "controller":
            return (*watched, "serve", "controller", "--quiet")
        if name == "designer":
            return (*watched, "campaign", *self._designer_argv(), "--no-local", "--json")
        kind, nap_s = ("film", 0.0) if name == "film" else ("ray", self._nap_s)
        return (*WORKER, kind, str(nap_s), str(self.history.path), str(self.folder / "orders"))

    def _designer_argv(self) -> Sequence[str]:
        """A begun run is resumed; one of which nothing was committed was never begun."""
        folder = self.settings.runs_dir / self.run
        if not folder.exists():
            return self._campaign
        try:
            RunJournal(folder)
        except LuxloopError:
            for path in segments_of(folder):
                path.unlink()
            folder.rmdir()
            return self._campaign
        return ("resume", self.run)

    def _log(self, name: str) -> Path:
        count = f"-{self.starts[name]:03}" if name == "designer" else ""
        return self.folder / "logs" / f"{name}{count}.log"

    def _said(self, words: str) -> bool:
        """Whether the designer's last words were these."""
        return words in self._log("designer").read_text(errors="replace")
