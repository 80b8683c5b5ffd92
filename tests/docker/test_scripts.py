"""What runs in a container beside luxloop itself: the way in, and the health check."""

from __future__ import annotations

import os
import runpy
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

DOCKER = Path(__file__).parents[2] / "docker"
ENTER = DOCKER / "enter.sh"


@pytest.fixture(scope="module")
def healthy() -> dict[str, Any]:
    """The names of docker/healthy.py, which is no part of a package."""
    return runpy.run_path(str(DOCKER / "healthy.py"))


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    """Something that listens on loopback and says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def entered(cache: Path, kernels: Path, *command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """enter.sh run with this cache folder, and with the image's kernels lying in `kernels`."""
    script = ENTER.read_text().replace("/opt/luxloop/kernels", str(kernels))
    return subprocess.run(
        ["sh", "-c", script, "enter.sh", *command],
        env={"PATH": os.environ["PATH"], "LUXLOOP_CACHE": str(cache), **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_command_is_what_the_container_becomes(tmp_path: Path) -> None:
    """Nothing stands between the engine's signals and the command: its exit code is the container's."""
    done = entered(tmp_path, tmp_path / "none", "sh", "-c", "echo $$ is here; exit 3")
    assert done.returncode == 3
    assert done.stdout.endswith("is here\n")


def test_the_images_kernels_come_into_the_cache_once(tmp_path: Path) -> None:
    """A folder of kernels that is not there is copied whole, one that is there is left as it is."""
    image, cache = tmp_path / "image", tmp_path / "cache"
    (image / "rays-1" / "below").mkdir(parents=True)
    (image / "rays-1" / "below" / "walk.nbi").write_text("compiled")
    (image / "film-1").mkdir()
    (image / "film-1" / "solve.nbi").write_text("of the image")
    (cache / "kernels" / "film-1").mkdir(parents=True)
    (cache / "kernels" / "film-1" / "solve.nbi").write_text("compiled here")
    for _ in range(2):
        assert entered(cache, image, "true").returncode == 0
    assert (cache / "kernels" / "rays-1" / "below" / "walk.nbi").read_text() == "compiled"
    assert (cache / "kernels" / "film-1" / "solve.nbi").read_text() == "compiled here"
    assert sorted(path.name for path in (cache / "kernels").iterdir()) == ["film-1", "rays-1"]


def test_a_uid_that_cannot_write_runs_is_told_who_can_and_what_to_do(tmp_path: Path) -> None:
    """Before anything starts: whose folder it is, and the line that mends it. A folder that is missing stands in."""
    done = entered(tmp_path, tmp_path / "none", "echo", "started", LUXLOOP_RUNS=str(tmp_path / "missing"))
    assert done.returncode == 2
    assert "started" not in done.stdout
    assert f"uid {os.getuid()} cannot write ./runs" in done.stderr
    assert "(echo UID=$(id -u); echo GID=$(id -g)) >>.env" in done.stderr


def test_no_ray_worker_is_refused_at_once(tmp_path: Path) -> None:
    """`RAY_WORKERS=0 docker compose up` waited for one without a word; other numbers, and none, pass."""
    for number in ("0", "00", "-1"):
        done = entered(tmp_path, tmp_path / "none", "echo", "started", RAY_WORKERS=number)
        assert (done.returncode, done.stdout) == (2, "")
        assert f"RAY_WORKERS is {number}, allowed: 1 or more" in done.stderr
    for number in ("", "1", "2"):
        assert entered(tmp_path, tmp_path / "none", "true", RAY_WORKERS=number).returncode == 0


def test_a_session_with_the_router_is_seen_and_its_end_too(healthy: dict[str, Any], listener: socket.socket) -> None:
    """Connected to that port, and no longer: as the system's own table shows it."""
    port = listener.getsockname()[1]
    table = Path("/proc/net/tcp")
    with socket.create_connection(("127.0.0.1", port)):
        assert healthy["connected"](port, table.read_text()) == ""
    assert "no session with the router" in healthy["connected"](port + 1, table.read_text())


def test_a_session_that_the_router_has_ended_does_not_count(healthy: dict[str, Any]) -> None:
    """A row in another state than established (here: closed by the other side), or with the port on this side."""
    row = "   1: 0100007F:{:04X} 0200007F:{:04X} {} 00000000:00000000 00:00000000 00000000  1000        0 5"
    assert healthy["connected"](7447, row.format(5000, 7447, "01")) == ""
    assert healthy["connected"](7447, row.format(5000, 7447, "08")) != ""
    assert healthy["connected"](7447, row.format(7447, 5000, "01")) != ""


def test_a_router_that_only_accepts_is_not_healthy(
    healthy: dict[str, Any], listener: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel accepts connections of a process that hangs: only a handshake shows that it lives."""
    from env_controller.certs import make

    make(tmp_path / "lab", days=2)
    monkeypatch.setitem(healthy["listens"].__globals__, "HANDSHAKE_S", 0.2)
    said = healthy["listens"](listener.getsockname()[1], tmp_path / "lab" / "router")
    assert "no TLS session" in said
