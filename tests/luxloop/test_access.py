"""Who may do what, as it follows from the table of keys: each role its own part, and every row somebody's."""

from __future__ import annotations

import pytest

from luxloop.bus.access import PARTIES, ROLES, WORKERS, Role, access_control, allowed
from luxloop.bus.keys import KEYS, at
from tests.local_bus import matches


def may(role: Role, flow: str, message: str, key: str) -> bool:
    """Whether the rules let `role` send (ingress) or be sent (egress) this message on this key."""
    return any(matches(expression, key) for expression in allowed(role).get((flow, message), ()))


def askers(row: str, **parts: str) -> set[str]:
    """The roles that may ask, or tell, on a row."""
    message = "put" if KEYS[row].reply is None else "query"
    return {role for role in PARTIES if may(role, "ingress", message, at("luxloop", row, **parts))}


def answerers(row: str, **parts: str) -> set[str]:
    """The roles that may answer, or listen, on a row."""
    message = "declare_subscriber" if KEYS[row].reply is None else "declare_queryable"
    return {role for role in PARTIES if may(role, "ingress", message, at("luxloop", row, **parts))}


@pytest.mark.parametrize("row", ["submit", "withdraw", "status", "begin", "act", "note", "end"])
def test_clients_ask_the_controller(row: str) -> None:
    """What starts work or shows it: for clients only, and nobody answers but the controller."""
    assert askers(row, kind="ray", name="r") == {"client"}
    assert answerers(row, kind="ray", name="r") == {"controller"}


@pytest.mark.parametrize("row", ["hello", "pull", "done", "heartbeat"])
def test_a_worker_speaks_for_its_own_kind(row: str) -> None:
    """A ray worker on the ray keys, a thin-film worker on the film keys, nobody on a kind that is none."""
    assert askers(row, kind="ray", worker="w") == {"ray-tracing"}
    assert askers(row, kind="film", worker="w") == {"thin-film"}
    assert askers(row, kind="other", worker="w") == set()
    assert answerers(row, kind="ray", worker="w") == {"controller"}


def test_the_controller_cancels_and_the_worker_of_that_kind_hears_it() -> None:
    """Nobody else tells a worker to stop, and none hears of another kind's."""
    assert askers("cancel", kind="ray", worker="w") == {"controller"}
    assert answerers("cancel", kind="ray", worker="w") == {"ray-tracing"}


def test_blobs_are_asked_and_answered_by_all() -> None:
    """Their hash says whether they are right."""
    assert askers("blob", sha256="0", worker="w") == answerers("blob", sha256="0", worker="w") == set(PARTIES)


def test_a_replay_is_told_and_heard_by_clients() -> None:
    """Neither a worker nor the controller can pass something off as a run's record."""
    assert askers("replay", name="r") == {"client"}
    assert "client" in answerers("replay", name="r")


def test_each_announces_itself_and_sees_all() -> None:
    """No role can claim to be present as another; who is there is no secret in the set."""
    places = {
        "controller": ("controller", "controller"),
        "client": ("designer", "run"),
        "thin-film": ("worker", "film"),
        "ray-tracing": ("worker", "ray"),
    }
    for role in PARTIES:
        for other, (party, kind) in places.items():
            key = at("luxloop", "alive", role=party, kind=kind, name="n")
            assert may(role, "ingress", "liveliness_token", key) == (role == other)
            assert may(role, "egress", "liveliness_token", key)
        everybody = at("luxloop", "alive")
        assert may(role, "ingress", "liveliness_query", everybody)
        assert may(role, "ingress", "declare_liveliness_subscriber", everybody)


def test_what_is_asked_can_be_answered() -> None:
    """For each row with a reply: the answerer is sent the query, and the asker the reply."""
    for row, key in KEYS.items():
        if key.reply is None:
            continue
        name = at("luxloop", row, kind="ray", sha256="0", worker="w", name="n")
        asking = [role for role in PARTIES if may(role, "ingress", "query", name)]
        answering = [role for role in PARTIES if may(role, "ingress", "reply", name)]
        assert asking
        assert answering
        assert all(may(role, "egress", "reply", name) for role in asking)
        assert all(may(role, "egress", "query", name) for role in answering)


def test_nothing_is_open_to_all_keys() -> None:
    """No rule has `**`, none begins at another schema, and the default is deny."""
    control = access_control()
    assert control["default_permission"] == "deny"
    for rule in control["rules"]:
        assert all(key.startswith("*/1/") and "**" not in key for key in rule["key_exprs"])
    assert not any(may(role, "ingress", "query", "luxloop/2/status") for role in PARTIES)


def test_every_role_has_a_policy_of_its_own_rules() -> None:
    """One subject for each party by its common name; the router's own certificate may nothing."""
    control = access_control()
    names = {subject["id"]: subject["cert_common_names"] for subject in control["subjects"]}
    assert names == {role: [role] for role in PARTIES}
    assert set(ROLES) - set(PARTIES) == {"router"}
    known = {rule["id"] for rule in control["rules"]}
    for policy in control["policies"]:
        (role,) = policy["subjects"]
        assert set(policy["rules"]) == {rule for rule in known if rule.startswith(f"{role} ")}
        assert policy["rules"]
    assert set(WORKERS) < set(PARTIES)
