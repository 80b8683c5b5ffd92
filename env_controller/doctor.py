"""`luxloop doctor`: is everything there that work needs? This host, certificates, permissions, the running set."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import Annotated

import typer

from env_controller.health.finding import Finding, Verdict
from env_controller.health.host import disk, limits, packages
from luxloop import __version__
from luxloop.bus import Bus, ask_for
from luxloop.bus.access import ROLES, WORKERS, Role
from luxloop.bus.identity import Identity, answering
from luxloop.bus.keys import KEYS, at
from luxloop.errors import InputError, LuxloopError, RemoteError
from luxloop.messages import Status, StatusAsked
from luxloop.settings import Settings, load_settings

SKEW_S = 0.5
SILENT_S = 5.0


def doctor(
    router: Annotated[str | None, typer.Option(help="Endpoint of the router (else LUXLOOP_ROUTER).")] = None,
    role: Annotated[str, typer.Option(help=f"Whose certificate to show: {', '.join(ROLES)}.")] = "client",
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Check releases, disk, limits, certificates, permissions, clocks and the set; exit 1 where something fails."""
    from env_controller.health.certificates import certificates

    settings, whose = load_settings(router=router), _checked_role(role)
    findings = [*packages(), *disk(settings), *limits(), *certificates(settings, whose), *_set(settings, whose)]
    if as_json:
        typer.echo(json.dumps({"version": __version__, "findings": [asdict(finding) for finding in findings]}))
    else:
        for finding in findings:
            typer.echo(_line(finding))
    if any(finding.verdict == "fail" for finding in findings):
        raise typer.Exit(1)


def _checked_role(role: str) -> Role:
    found = next((known for known in ROLES if known == role), None)
    if found is None:
        raise InputError("role", role, ", ".join(ROLES))
    return found


def _set(settings: Settings, role: Role) -> Iterator[Finding]:
    """The router, what it lets us do, and, for a client, who is there."""
    from env_controller.health.certificates import admission, permissions
    from luxloop.bus.zenoh_bus import ZenohBus

    try:
        identity = Identity.of(settings, role)
        if not answering(settings, identity):  # said at once, where opening a session would wait
            mend = "start one (luxloop serve local), or set LUXLOOP_ROUTER to where it is"
            yield Finding("router", "fail", f"no router at {settings.router}", mend)
            return
        with ZenohBus(settings, role=role) as bus:
            yield Finding("router", "ok", settings.router)
            if identity is not None:
                yield admission(settings, identity)
                yield permissions(bus, settings, role)
            if role == "client":
                yield from _members(bus, settings)
    except RemoteError as error:
        yield Finding("router", "fail", error.failure.message, error.failure.mend)
    except LuxloopError as error:
        yield Finding("router", "fail", str(error))


def _members(bus: Bus, settings: Settings) -> Iterator[Finding]:
    asked_s = time.time()
    try:
        parcel = ask_for(bus, at(settings.realm, "status"), StatusAsked(), KEYS["status"].time_limit_s)
        status = parcel.expect(Status)
    except RemoteError as error:
        yield Finding("controller", "fail", error.failure.message, error.failure.mend)
        return
    except InputError as error:
        yield Finding("controller", "fail", str(error))
        return
    yield _controller(status, (asked_s + time.time()) / 2)
    yield from _workers(status)


def _controller(status: Status, asked_unix_s: float) -> Finding:
    skew_s = status.now_unix_s - asked_unix_s
    found = (
        f"{status.version}, epoch {status.epoch}, up {status.up_s:.0f} s, {sum(status.queued.values())} queued, "
        f"{status.running} running, {status.done} done, {status.failed} failed, "
        f"{status.resident_mb:.0f} MB, clock {skew_s:+.2f} s"
    )
    if status.version != __version__:
        return Finding("controller", "fail", found, f"run release {__version__} on all sides")
    if abs(skew_s) > SKEW_S:
        return Finding("controller", "warn", found, "set the clocks of both hosts (NTP)")
    return Finding("controller", "ok", found)


def _workers(status: Status) -> Iterator[Finding]:
    kinds = {worker.describe.kind for worker in status.workers}
    for role, kind in WORKERS.items():
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
        if worker.heard_s_ago > SILENT_S:
            verdict, mend = "warn", "it is silent: look at its log, or stop it"
        yield Finding(worker.describe.worker, verdict, found, mend)


def _line(finding: Finding) -> str:
    colour = {"ok": typer.colors.GREEN, "warn": typer.colors.YELLOW, "fail": typer.colors.RED}[finding.verdict]
    mend = f"\n{'':<27}mend: {finding.mend}" if finding.mend and finding.verdict != "ok" else ""
    return f"{typer.style(f'{finding.verdict:<5}', fg=colour)} {finding.what:<20} {finding.found}{mend}"
