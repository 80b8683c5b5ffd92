"""`luxloop doctor`: is everything there that work needs? Router, controller, workers, releases, clocks, disk."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Literal

import typer

from luxloop import __version__
from luxloop.errors import InputError, LuxloopError, RemoteError
from luxloop.messages import Status
from luxloop.settings import Settings, load_settings, usable_cache

Verdict = Literal["ok", "warn", "fail"]
PACKAGES = ("eclipse-zenoh", "numpy", "pydantic", "numba", "matplotlib")
OPTIONAL = {"numba": "workers", "matplotlib": "viewer"}
ROLES = {"film": "thin-film", "ray": "ray-tracing"}
"""Kinds of workers that a set has, and what serves them."""
SKEW_S = 0.5
DISK_GB = 1.0


@dataclass(frozen=True)
class Finding:
    """One line of the doctor's report."""

    what: str
    verdict: Verdict
    found: str
    mend: str = ""


def doctor(
    router: Annotated[str | None, typer.Option(help="Endpoint of the router (else LUXLOOP_ROUTER).")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Check router, controller, workers, releases, clocks and disk; exit 1 where something fails."""
    settings = load_settings(router=router)
    findings = [*_packages(), *_disk(settings), *_set(settings)]
    if as_json:
        typer.echo(json.dumps({"version": __version__, "findings": [asdict(finding) for finding in findings]}))
    else:
        for finding in findings:
            typer.echo(_line(finding))
    if any(finding.verdict == "fail" for finding in findings):
        raise typer.Exit(1)


def _packages() -> Iterator[Finding]:
    yield Finding("luxloop", "ok", f"{__version__} on Python {sys.version.split()[0]}, {os.cpu_count()} cores")
    for name in PACKAGES:
        try:
            yield Finding(name, "ok", version(name))
        except PackageNotFoundError:
            extra = OPTIONAL.get(name)
            yield Finding(name, "warn" if extra else "fail", "not installed", f"pip install 'luxloop[{extra}]'")


def _disk(settings: Settings) -> Iterator[Finding]:
    try:
        folder = usable_cache(settings)
    except InputError as error:
        yield Finding("cache folder", "fail", f"{error.value} is not {error.allowed}", error.mend)
        return
    free_gb = shutil.disk_usage(folder).free / 1e9
    few = free_gb < DISK_GB
    mend = "make room, or set LUXLOOP_CACHE to a larger disk" if few else ""
    yield Finding("cache folder", "fail" if few else "ok", f"{folder}, {free_gb:.1f} GB free", mend)
    shared = Path("/dev") / "shm"
    if shared.is_dir() and shutil.disk_usage(shared).free < 16e6:
        yield Finding(str(shared), "warn", "less than 16 MB free")


def _set(settings: Settings) -> Iterator[Finding]:
    from luxloop.client import Client

    try:
        with Client(settings, local=False) as client:
            status = client.status()
    except RemoteError as error:
        reached = error.failure.code != "no_router"
        if reached:
            yield Finding("router", "ok", settings.router)
        yield Finding("controller" if reached else "router", "fail", error.failure.message, error.failure.mend)
        return
    except LuxloopError as error:
        yield Finding("router", "fail", str(error))
        return
    yield Finding("router", "ok", settings.router)
    yield _controller(status)
    yield from _workers(status)


def _controller(status: Status) -> Finding:
    found = (
        f"{status.version}, epoch {status.epoch}, up {status.up_s:.0f} s, {sum(status.queued.values())} queued, "
        f"{status.running} running, {status.done} done, {status.failed} failed, {status.resident_mb:.0f} MB"
    )
    if status.version != __version__:
        return Finding("controller", "fail", found, f"run release {__version__} on all sides")
    return Finding("controller", "ok", found)


def _workers(status: Status) -> Iterator[Finding]:
    kinds = {worker.describe.kind for worker in status.workers}
    for kind, role in ROLES.items():
        if kind not in kinds:
            yield Finding(role, "fail", "no such worker", f"start one: luxloop serve {role}, or luxloop serve local")
    for worker in status.workers:
        memory = f"{worker.resident_mb:.0f} MB, " if worker.resident_mb else ""
        found = (
            f"{worker.describe.kind} on {worker.describe.host}, pid {worker.describe.pid}, {worker.finished} done, "
            f"{memory}heard {worker.heard_s_ago:.1f} s ago, clock {worker.clock_skew_s:+.2f} s"
        )
        verdict: Verdict = "ok"
        mend = ""
        if abs(worker.clock_skew_s) > SKEW_S:
            verdict, mend = "warn", "set the clocks of both hosts (NTP)"
        if worker.heard_s_ago > 5.0:
            verdict, mend = "warn", "it is silent: look at its log, or stop it"
        yield Finding(worker.describe.worker, verdict, found, mend)


def _line(finding: Finding) -> str:
    colour = {"ok": typer.colors.GREEN, "warn": typer.colors.YELLOW, "fail": typer.colors.RED}[finding.verdict]
    mend = f"\n{'':<27}mend: {finding.mend}" if finding.mend and finding.verdict != "ok" else ""
    return f"{typer.style(f'{finding.verdict:<5}', fg=colour)} {finding.what:<20} {finding.found}{mend}"
