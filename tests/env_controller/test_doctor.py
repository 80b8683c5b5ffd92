"""`luxloop doctor` where something is wrong: what it finds, how it says so, exit code 1."""

from __future__ import annotations

import resource
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from env_controller.health import host
from luxloop.settings import Settings, as_environment
from tests.doctor import ill


def test_an_unusable_cache_is_found_beside_the_rest(settings: Settings, tmp_path: Path) -> None:
    """The folder, what is wrong, the variable to set; the router is looked at all the same."""
    (tmp_path / "file").touch()
    found = ill(settings.model_copy(update={"cache": tmp_path / "file"}))
    assert found["cache folder"]["verdict"] == "fail"
    assert str(tmp_path / "file") in found["cache folder"]["found"]
    assert "LUXLOOP_CACHE" in found["cache folder"]["mend"]
    assert found["router"]["verdict"] == "fail"


def test_a_stranger_at_the_endpoint_is_called_one(settings: Settings) -> None:
    """Something that accepts connections and knows no zenoh is no router, and starting one there would not help."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        endpoint = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
        found = ill(settings.model_copy(update={"router": endpoint}))
    assert found["router"]["verdict"] == "fail"
    assert found["router"]["found"] == f"what listens at {endpoint} is no router of luxloop"
    assert "LUXLOOP_ROUTER" in found["router"]["mend"]


@pytest.mark.parametrize(
    ("file", "text", "limit_mb"),
    [
        ("memory.max", "268435456\n", 268.435456),
        ("memory/memory.limit_in_bytes", "134217728\n", 134.217728),
        ("memory.max", "max\n", None),
        ("memory/memory.limit_in_bytes", f"{2**63 - 4096}\n", None),
    ],
)
def test_the_memory_limit_is_the_control_group_s(
    tmp_path: Path, file: str, text: str, limit_mb: float | None
) -> None:
    """Of either version of control groups; without one, all that is installed."""
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(text)
    assert host.memory_limit_mb(tmp_path) == pytest.approx(limit_mb or host.memory_limit_mb(tmp_path / "none"))


def test_narrow_limits_are_warnings_with_a_mend(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few open files, little memory: what a container or a login may lack."""
    monkeypatch.setattr(resource, "getrlimit", lambda _: (256, 4096))
    monkeypatch.setattr(host, "memory_limit_mb", lambda: 128.0)
    found = {finding.what: finding for finding in host.limits()}
    assert (found["open files"].verdict, found["memory"].verdict) == ("warn", "warn")
    assert "ulimit -n" in found["open files"].mend
    assert "mem_limit" in found["memory"].mend


def test_a_role_that_is_none_is_refused(settings: Settings) -> None:
    """Bad usage, exit code 2, with the roles there are."""
    done = subprocess.run(
        [sys.executable, "-m", "luxloop", "doctor", "--role", "boss"],
        env=as_environment(settings),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert "ray-tracing" in done.stderr
