"""Who may do what on the bus, by the role in its certificate: the router's access control, made from the key table.

Default deny. `KEYS` says of each row who asks (or tells) and who answers (or listens); a worker has its own kind's
keys only. zenoh refuses silently, at the router, in both directions: `ingress` is what a role may send, `egress` what
may reach it.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

from luxloop.bus.keys import KEYS, Key
from luxloop.messages import SCHEMA

Role = Literal["router", "controller", "client", "thin-film", "ray-tracing"]
ROLES: tuple[Role, ...] = get_args(Role)
WORKERS: dict[Role, str] = {"thin-film": "film", "ray-tracing": "ray"}
"""The kind of task that each role of a worker may take."""
PARTIES: tuple[Role, ...] = tuple(role for role in ROLES if role != "router")  # the router itself asks nothing
PRESENCE = "alive"
ANNOUNCES: dict[Role, tuple[str, str]] = {
    "controller": ("controller", "*"),
    "client": ("designer", "*"),
    "thin-film": ("worker", "film"),
    "ray-tracing": ("worker", "ray"),
}
"""Whose presence a role may announce: the first two parts of a liveliness key."""

ASK_SENDS, ASK_GETS = ["query"], ["reply"]
ANSWER_SENDS, ANSWER_GETS = ["declare_queryable", "reply"], ["query"]
TELL_SENDS = ["put"]
LISTEN_SENDS, LISTEN_GETS = ["declare_subscriber"], ["put"]
LOOK_SENDS, LOOK_GETS = ["liveliness_query", "declare_liveliness_subscriber"], ["liveliness_token"]


def access_control() -> dict[str, Any]:
    """zenoh's `access_control` for the router, all roles in it."""
    rules = [rule for role in PARTIES for rule in _rules(role)]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": role, "cert_common_names": [role]} for role in PARTIES],
        "policies": [
            {"rules": [rule["id"] for rule in rules if rule["id"].startswith(f"{role} ")], "subjects": [role]}
            for role in PARTIES
        ],
    }


def allowed(role: Role) -> dict[tuple[str, str], frozenset[str]]:
    """(flow, message) -> the key expressions on which `role` may send it (ingress) or be sent it (egress)."""
    found: dict[tuple[str, str], set[str]] = {}
    for name, row in KEYS.items():
        if name == PRESENCE:
            continue
        key = _key(row, role)
        for flow, messages in _part(row, role):
            for message in messages:
                found.setdefault((flow, message), set()).add(key)
    for message in LOOK_SENDS:
        found["ingress", message] = {_presence("*", "*")}
    for message in LOOK_GETS:
        found["egress", message] = {_presence("*", "*")}
    if role in ANNOUNCES:
        found["ingress", "liveliness_token"] = {_presence(*ANNOUNCES[role])}
    return {where: frozenset(keys) for where, keys in found.items()}


def _rules(role: Role) -> list[dict[str, Any]]:
    return [
        {
            "id": f"{role} {flow} {message}",
            "permission": "allow",
            "flows": [flow],
            "messages": [message],
            "key_exprs": sorted(keys),
        }
        for (flow, message), keys in sorted(allowed(role).items())
    ]


def _part(row: Key, role: Role) -> list[tuple[str, list[str]]]:
    """What a role sends and is sent of one row: as who asks or tells, and as who answers or listens."""
    party = "worker" if role in WORKERS else role
    part: list[tuple[str, list[str]]] = []
    if row.asked_by in (party, "anybody"):
        part += [("ingress", TELL_SENDS)] if row.reply is None else [("ingress", ASK_SENDS), ("egress", ASK_GETS)]
    if row.answered_by in (party, "anybody"):
        listens = [("ingress", LISTEN_SENDS), ("egress", LISTEN_GETS)]
        part += listens if row.reply is None else [("ingress", ANSWER_SENDS), ("egress", ANSWER_GETS)]
    return part


def _key(row: Key, role: Role) -> str:
    """The key expression of a row for a role, in whatever realm: `*` for each part, but a worker's own kind."""
    parts = [
        WORKERS.get(role, "*") if part == "{kind}" else "*" if part.startswith("{") else part
        for part in row.pattern.split("/")
    ]
    return "/".join(["*", str(SCHEMA), *parts])


def _presence(role: str, kind: str) -> str:
    pattern = KEYS[PRESENCE].pattern.replace("{role}", role).replace("{kind}", kind).replace("{name}", "*")
    return f"*/{SCHEMA}/{pattern}"
