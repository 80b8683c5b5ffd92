"""Settings: what is taken, what is refused by name, whether the cache folder can be used, what a child is told."""

from __future__ import annotations

import os
import re
import socket
from pathlib import Path

import pytest

from env_controller.taken import refuse_taken
from luxloop.endpoint import host_and_port, listening
from luxloop.errors import InputError, LuxloopError
from luxloop.files import MAX_BYTES
from luxloop.settings import Settings, as_environment, load_settings, usable_cache


@pytest.fixture(autouse=True)
def _nothing_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No LUXLOOP_* in the environment, an empty working folder."""
    for name in [name for name in os.environ if name.startswith("LUXLOOP_")]:
        monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("endpoint", "parts"),
    [
        ("tcp/127.0.0.1:7447", ("127.0.0.1", 7447)),
        ("tcp/[::1]:1", ("::1", 1)),
        ("tcp/localhost:65535", ("localhost", 65535)),
        ("tcp/router.lab-2.example:7447", ("router.lab-2.example", 7447)),
    ],
)
def test_an_endpoint_is_taken_and_split(endpoint: str, parts: tuple[str, int]) -> None:
    """Names, IPv4, IPv6 in brackets."""
    assert host_and_port(load_settings(router=endpoint).router) == parts


@pytest.mark.parametrize(
    "endpoint",
    [
        "http://x",
        "tcp/",
        "tcp/host",
        "tcp/host:0",
        "tcp/host:65536",
        "tcp/host:+80",
        "tcp/:7447",
        "tcp/::1:7447",
        "tcp/[::1:7447",
        "tcp/[localhost]:7447",
        "tcp/1.2.3:7447",
        "tcp/300.1.1.1:7447",
        "tcp/a b:7447",
        "tcp/-a:7447",
        "tcp/a..b:7447",
        "tcp/h\u00f6st:7447",
        "tcp/127.0.0.1:7447\n",
        "tcp/127.0.0.1:7447#iface=lo",
        "tls/host:7447",
        "tcp/" + "a" * 64 + ":7447",
    ],
)
def test_what_is_no_endpoint_is_refused_by_name(endpoint: str) -> None:
    """InputError of our own, naming the field, the value and an example."""
    with pytest.raises(InputError, match=r"router: got .* allowed: tcp/HOST:PORT.*127\.0\.0\.1:7447"):
        load_settings(router=endpoint)


@pytest.mark.parametrize("name", ["heartbeat_s", "silence_s", "keep_results_mb"])
@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "-1", "1e300", "soon"])
def test_a_duration_or_size_is_a_finite_number_in_its_range(
    name: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Out of the environment, nan and infinity are refused too; the error names the field."""
    monkeypatch.setenv(f"LUXLOOP_{name.upper()}", value)
    with pytest.raises(InputError, match=name):
        load_settings()


def test_a_silence_shorter_than_three_beats_is_refused() -> None:
    """A worker would be given up between two beats; three beats are enough."""
    with pytest.raises(InputError, match=r"silence_s: got 5\.9, allowed: at least 3 x heartbeat_s = 6"):
        load_settings(heartbeat_s=2.0, silence_s=5.9)
    assert load_settings(heartbeat_s=2.0, silence_s=6.0).silence_s == 6.0


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("router = ", "luxloop.toml"),
        ('colour = "blue"', "colour"),
        ("attempts = 0", "attempts"),
        ('cache = "a\\u0000b"', "LUXLOOP_CACHE"),
        ("router = 5", "router"),
    ],
)
def test_a_bad_settings_file_is_named(text: str, named: str) -> None:
    """What cannot be read, a key that is not there, a value out of range."""
    Path("luxloop.toml").write_text(text)
    with pytest.raises(InputError, match=named):
        usable_cache(load_settings())


def test_a_settings_file_that_is_not_utf8_is_named() -> None:
    """Another program's encoding."""
    Path("luxloop.toml").write_bytes(b'realm = "\xff"')
    with pytest.raises(InputError, match=r"luxloop\.toml"):
        load_settings()


@pytest.mark.parametrize(
    ("text", "said"),
    [("#" * (MAX_BYTES + 1), "more than 1,048,576 bytes"), ("a." * 20_000 + "b = 1", "names by dots")],
)
def test_a_settings_file_that_would_be_read_for_minutes_is_refused(text: str, said: str) -> None:
    """Too large, or one name of 20,000 dots, which took two minutes."""
    Path("luxloop.toml").write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        load_settings()
    assert caught.value.field.startswith("luxloop.toml")


def test_a_settings_file_is_below_the_environment_and_may_have_a_byte_order_mark(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As every other file of a user."""
    Path("luxloop.toml").write_bytes(b'\xef\xbb\xbfattempts = 7\nrealm = "lab"')
    monkeypatch.setenv("LUXLOOP_REALM", "other")
    assert (load_settings().attempts, load_settings().realm) == (7, "other")


def test_an_empty_variable_is_as_good_as_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """`LUXLOOP_ROUTER= luxloop ...` means the default."""
    monkeypatch.setenv("LUXLOOP_ROUTER", "")
    assert load_settings().router == Settings.model_fields["router"].default


def test_a_cache_of_nobody_is_refused() -> None:
    """`~nosuchuser` names no folder."""
    with pytest.raises(InputError, match="cache: got '~no-such-user/x'"):
        load_settings(cache="~no-such-user/x")


def test_the_folder_of_effects_is_expanded_as_the_others_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """`LUXLOOP_EFFECTS=~/mine`; nobody's `~` is refused."""
    monkeypatch.setenv("LUXLOOP_EFFECTS", "~/mine")
    assert load_settings().effects_dir == Path.home() / "mine"
    with pytest.raises(InputError, match="effects: got '~no-such-user/x'"):
        load_settings(effects="~no-such-user/x")


def test_every_room_asks_for_the_expanded_folder() -> None:
    """Nobody reads a folder of the settings as it was typed, with its `~`."""
    rooms = ("agent", "containers", "env_controller", "luxloop", "validation", "viewer")
    files = [path for room in rooms for path in (Path(__file__).parents[2] / room).rglob("*.py")]
    typed = re.compile(r"settings(\(\))?\.(cache|runs|effects|certs)\b")
    assert [str(path) for path in files if typed.search(path.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize("cache", ["file", "file/below", "n" * 300, "/proc/luxloop"])
def test_a_cache_that_cannot_be_used_is_refused(cache: str) -> None:
    """A file, a folder below a file, a name too long, a place where nobody can write."""
    Path("file").touch()
    with pytest.raises(InputError, match=r"LUXLOOP_CACHE: got .*a folder that can be made and written"):
        usable_cache(load_settings(cache=cache))


def test_a_usable_cache_is_made_and_left_empty() -> None:
    """With the folders above it."""
    folder = usable_cache(load_settings(cache="new/cache"))
    assert folder.is_dir()
    assert list(folder.iterdir()) == []


def test_a_child_process_reads_the_same_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every field goes through the environment and comes back equal."""
    given = Settings(router="tcp/[::1]:7", realm="a", cache=Path("c"), heartbeat_s=0.5, silence_s=2.5, attempts=2)
    for name, value in as_environment(given).items():
        monkeypatch.setenv(name, value)
    assert load_settings() == given


def test_a_taken_endpoint_is_refused_and_a_free_one_is_not() -> None:
    """While somebody listens there; who has stopped is no hurdle."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        endpoint = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
        assert listening(endpoint)
        with pytest.raises(LuxloopError, match=f"cannot listen at {endpoint}: something listens there already"):
            refuse_taken(endpoint)
    assert not listening(endpoint)
    refuse_taken(endpoint)


def test_an_address_of_another_host_is_refused() -> None:
    """192.0.2.1 is kept for documentation: it is nobody's."""
    with pytest.raises(LuxloopError, match=r"cannot listen at tcp/192\.0\.2\.1:7447: .*--router"):
        refuse_taken("tcp/192.0.2.1:7447")


def test_with_certificates_the_router_is_at_a_tls_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing said: the usual port, encrypted; a plain endpoint beside them is refused with the endpoint to write."""
    monkeypatch.setenv("LUXLOOP_CERTS", "certs")
    assert load_settings().router == "tls/127.0.0.1:7447"
    assert host_and_port(load_settings(router="tls/router:7448").router) == ("router", 7448)
    with pytest.raises(InputError, match=r"router: got 'tcp/host:7447'.*write tls/host:7447, or unset LUXLOOP_CERTS"):
        load_settings(router="tcp/host:7447")


def test_a_tls_port_needs_certificates() -> None:
    """The command that makes them is named."""
    with pytest.raises(InputError, match=r"router: got 'tls/host:7447'.*luxloop certs"):
        load_settings(router="tls/host:7447")


def test_a_child_process_has_the_certificates_or_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Either comes back equal, also where our own environment says otherwise."""
    for given in (Settings(certs=Path("c"), router="tls/[::1]:7"), Settings()):
        monkeypatch.setenv("LUXLOOP_CERTS", "others")
        environment = as_environment(given)
        with monkeypatch.context() as child:
            for name, value in environment.items():
                child.setenv(name, value)
            assert load_settings() == given
        monkeypatch.delenv("LUXLOOP_CERTS")
