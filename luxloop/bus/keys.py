"""The one table of keys: which message travels where, who answers, how long it may take.

All keys lie under `<realm>/<schema>/`; the realm separates two sets on one router.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from luxloop import campaign as c
from luxloop import messages as m
from luxloop.words import Words

Role = Literal["controller", "worker", "client", "anybody"]

HOLD_S = 5.0  # how long the controller holds a query open; then it answers Pending or Nothing, and is asked again.
# An answer that gets lost with a router that dies is missed for this and 5 s more; asking again costs 1 ms.
SHORT_S = 5.0  # a query that is answered at once


@dataclass(frozen=True)
class Key:
    """One row: the key's pattern, what is asked or told, what comes back, by whom, the limits, and who may ask."""

    pattern: str
    message: type[Words]
    reply: type[Words] | None
    answered_by: Role
    time_limit_s: float
    asked_by: Role = "client"  # or told by; the router lets nobody else (access.py)


KEYS: dict[str, Key] = {
    "submit": Key("submit/{kind}", m.Submit, m.Outcome, "controller", HOLD_S + 5.0),
    "withdraw": Key("withdraw", m.Withdraw, m.Receipt, "controller", SHORT_S),
    "status": Key("status", m.StatusAsked, m.Status, "controller", SHORT_S),
    "hello": Key("hello/{kind}", m.Hello, m.Welcome, "controller", SHORT_S, "worker"),
    "pull": Key("pull/{kind}", m.Pull, m.Lease, "controller", HOLD_S + 5.0, "worker"),
    "done": Key("done/{kind}", m.Done, m.Receipt, "controller", SHORT_S, "worker"),
    "heartbeat": Key("heartbeat/{kind}/{worker}", m.Heartbeat, None, "controller", SHORT_S, "worker"),
    "cancel": Key("cancel/{kind}/{worker}", m.Cancel, None, "worker", SHORT_S, "controller"),
    "blob": Key("blob/{sha256}/{worker}", m.BlobAsked, m.BlobPiece, "anybody", SHORT_S, "anybody"),
    "begin": Key("begin", c.Begin, c.Begun, "controller", HOLD_S + 5.0),
    "act": Key("act/{name}", c.Action, c.Step, "controller", HOLD_S + 5.0),
    "note": Key("note/{name}", c.Note, m.Receipt, "controller", SHORT_S),
    "end": Key("end/{name}", c.End, c.Ended, "controller", 2.0 * SHORT_S),
    "replay": Key("replay/{name}", m.Replayed, None, "client", SHORT_S),
    "alive": Key("alive/{role}/{kind}/{name}", m.Nothing, None, "anybody", SHORT_S, "anybody"),
}


def at(realm: str, row: str, /, **parts: str) -> str:
    """The full key of a row; a part that is left out becomes the wildcard `*`."""
    pattern = KEYS[row].pattern
    for part in ("kind", "worker", "sha256", "role", "name"):
        pattern = pattern.replace("{" + part + "}", parts.get(part, "*"))
    return f"{realm}/{m.SCHEMA}/{pattern}"


def name_of(key: str) -> str:
    """The row's name of a full key; empty where it is none of ours."""
    parts = key.split("/")
    return parts[2] if len(parts) > 2 else ""


def last_part(key: str) -> str:
    """The last part of a key: a worker's name, a blob's hash."""
    return key.rsplit("/", 1)[-1]
