"""A secured set of real processes, and everybody who is not let in, or not let do what they try."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from luxloop import __version__
from luxloop.messages import Task
from tests.intruding import NO_SESSION, NOT_PERMITTED, SEEN_BY_THE_CONTROLLER, Try
from tests.secured_set import SecuredSet

CAUSES = {
    "plain tcp to the TLS port": "speaks TLS, and we spoke plain tcp",
    "its own set, CA of the same name": "the router's certificate is of another CA",
    "our CA's certificate, a client's of another CA": "the router trusts another CA",
    "expired yesterday": "out of its time",
    "valid from tomorrow": "out of its time",
    "its key in the router's place": "none of a router",
    "without certificates, our client comes": "does not begin TLS",
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredSet]:
    """One set for all tries: what an intruder breaks, the next test sees."""
    secured = SecuredSet(tmp_path_factory.mktemp("lab"))
    yield secured
    secured.close()


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A session is tried for 0.4 s, not for 3 s, a handshake for 1 s: most of these never come to be."""
    monkeypatch.setattr("luxloop.bus.identity.HANDSHAKE_S", 1.0)
    monkeypatch.setattr("luxloop.bus.configuration.OPEN_MS", 400)


def goes_on(lab: SecuredSet) -> bool:
    """Whether an honest task is still computed, by the workers that were there before."""
    answer = lab.client.run(Task(kind="film", inputs={"number": 1}, version=__version__), fresh=True, limit_s=10.0)
    return answer.worker == lab.worker("film") and len(lab.client.status().workers) == 2


def names(tried: Try) -> str:
    """The name of a case."""
    return f"{tried.who}: {tried.what}"


@pytest.mark.parametrize("tried", NO_SESSION, ids=names)
def test_who_has_no_valid_certificate_gets_no_session(lab: SecuredSet, tried: Try) -> None:
    """Or, of the router's side, is not trusted; zenoh says "Timeout" to all, luxloop says what is wrong."""
    said = tried.do(lab)
    assert said
    assert CAUSES.get(tried.what, "") in said
    assert goes_on(lab)


@pytest.mark.parametrize("tried", NOT_PERMITTED, ids=names)
def test_a_role_may_do_its_own_and_nothing_else(lab: SecuredSet, tried: Try) -> None:
    """A valid certificate on a key, or in a place, that is not its role's."""
    assert tried.do(lab)
    assert goes_on(lab)


@pytest.mark.parametrize("tried", SEEN_BY_THE_CONTROLLER, ids=names)
def test_a_lie_inside_a_message_is_seen_by_the_controller(lab: SecuredSet, tried: Try) -> None:
    """The router sees keys only: another's name or kind, and what is no message, are the controller's to refuse."""
    assert tried.do(lab)
    assert goes_on(lab)
