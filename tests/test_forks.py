"""Forked processes are as those of an interpreter of their own: what they say, how they end, what they draw."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests import forks


@pytest.fixture(params=["", "0"], ids=["forked", "by itself"])
def environment(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """With and without the server of forks."""
    monkeypatch.setenv("LUXLOOP_TESTS_FORK", request.param)
    return dict(os.environ)


def test_a_command_says_what_it_says_and_ends_as_it_ends(environment: dict[str, str], tmp_path: Path) -> None:
    """Exit code, both streams apart, the folder that it runs in."""
    good = forks.luxloop("model", "show", "paper", env=environment, cwd=tmp_path)
    assert (good.returncode, good.stderr) == (0, "")
    assert good.stdout.startswith("paper")
    bad = forks.luxloop("model", "show", "no.toml", env=environment, cwd=tmp_path)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert "no.toml" in bad.stderr


def test_a_signal_ends_it_and_is_told(environment: dict[str, str]) -> None:
    """As of subprocess: minus its number; nothing is told while it runs."""
    process = forks.start("-c", "import time; time.sleep(60)", env=environment)
    assert process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.1)
    process.terminate()
    assert process.wait(10.0) == -signal.SIGTERM
    assert process.poll() == -signal.SIGTERM


def test_each_has_its_environment_and_random_numbers_of_its_own(environment: dict[str, str], tmp_path: Path) -> None:
    """Those of one server are not copies of each other."""
    code = "import os, random; open(os.environ['TO'], 'w').write(f'{random.random()} {os.getpid()}')"
    for name in ("one", "two"):
        assert forks.start("-c", code, env=environment | {"TO": str(tmp_path / name)}).wait(30.0) == 0
    one, two = ((tmp_path / name).read_text().split() for name in ("one", "two"))
    assert one[0] != two[0]
    assert one[1] != two[1]
