"""What a session of zenoh is told, by path: no discovery, no shared memory, bounded sizes, who may do what."""

from __future__ import annotations

from luxloop.bus.access import access_control
from luxloop.bus.frame import FRAME_BYTES
from luxloop.bus.identity import Identity
from luxloop.settings import Settings

LEASE_MS = 4000
OPEN_MS = 3000
RECEIVE_BYTES = 4 * FRAME_BYTES  # above what any frame may have, so that a too large one gets a clear answer


def of_router(settings: Settings, identity: Identity | None) -> dict[str, object]:
    """The router at `settings.router`; where there are certificates, each role may do what `access` says."""
    listen = {"endpoints": [settings.router], "exit_on_failure": True}
    return (
        _of_any("router", identity) | {"listen": listen} | ({"access_control": access_control()} if identity else {})
    )


def of_client(settings: Settings, identity: Identity | None, *, patient: bool) -> dict[str, object]:
    """A client of the router at `settings.router`; `patient` tries for ever, else it gives up after OPEN_MS."""
    connect = {
        "endpoints": [settings.router],
        "timeout_ms": -1 if patient else OPEN_MS,
        "exit_on_failure": not patient,
        "retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
    }
    return _of_any("client", identity) | {"connect": connect}


def _of_any(mode: str, identity: Identity | None) -> dict[str, object]:
    return _certified(identity) | {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/rx/max_message_size": RECEIVE_BYTES,
        "transport/shared_memory/enabled": False,
        "queries_default_timeout": 10000,
    }


def _certified(identity: Identity | None) -> dict[str, object]:
    """Both sides show a certificate of the one CA; the router's must be for the host that was asked for."""
    if identity is None:
        return {}
    own = str(identity.own)
    sides = {f"{side}_{what}": own for side in ("listen", "connect") for what in ("certificate", "private_key")}
    checks = dict.fromkeys(("enable_mtls", "verify_name_on_connect", "close_link_on_expiration"), True)
    tls = {"root_ca_certificate": str(identity.ca)} | sides | checks
    return {"transport/link/tls": tls, "transport/link/protocols": ["tls"]}
