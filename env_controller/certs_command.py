"""`luxloop certs`: certificates for a set of processes that nobody else can join."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

import typer

from luxloop.endpoint import checked
from luxloop.errors import InputError

DAYS = 365
MOST_DAYS = 3650  # the CA's own time


def certs(
    out: Annotated[Path, typer.Option(help="Folder of the set; made, readable by you alone.")] = Path("certs"),
    days: Annotated[
        int, typer.Option(min=1, max=MOST_DAYS, help="How long the roles' certificates are valid.")
    ] = DAYS,
    host: Annotated[list[str] | None, typer.Option(help="One more name or address of the router's host.")] = None,
    renew: Annotated[bool, typer.Option("--renew", help="Keep the CA, make the roles' certificates anew.")] = False,
    if_needed: Annotated[
        bool,
        typer.Option("--if-needed", help="Leave a set that is good for 30 days more; else make or renew it."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Make a lab CA and one certificate per role, for a set of processes that nobody else can join."""
    from env_controller.certs import make

    hosts = tuple(map(_checked_host, host or []))
    made = make(Path(os.path.expanduser(out)), days=days, hosts=hosts, renew=renew, if_needed=if_needed)
    if as_json:
        facts = {"folder": str(made.folder), "what": made.what, "roles": made.roles, "hosts": made.hosts}
        until = {"valid_until": made.valid_until.isoformat(), "ca_valid_until": made.ca_valid_until.isoformat()}
        typer.echo(json.dumps(facts | until))
        return
    typer.echo(f"{made.folder}: {made.what}")
    typer.echo(f"  roles   {', '.join(made.roles)}; valid until {made.valid_until:%Y-%m-%d %H:%M} UTC")
    typer.echo(f"  CA      valid until {made.ca_valid_until:%Y-%m-%d}; keep ca.key off the other hosts")
    typer.echo(f"  router  is known as {', '.join(made.hosts)}")
    typer.echo(f"to use it: export LUXLOOP_CERTS={made.folder}; another host needs the folder of its role only")


def _checked_host(host: str) -> str:
    try:
        checked(f"tcp/[{host}]:1" if ":" in host else f"tcp/{host}:1")
    except InputError:
        mend = "e.g. --host pc1.lab --host 10.0.0.5"
        raise InputError("host", host, "a name, an IPv4 or an IPv6 address", mend) from None
    with suppress(ValueError):  # as certificates write it: short, in small letters
        return str(ip_address(host))
    return host
