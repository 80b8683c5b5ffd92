"""`luxloop doctor` where something is wrong: what it finds, how it says so, exit code 1."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

from luxloop.settings import Settings, as_environment


def findings(settings: Settings) -> dict[str, dict[str, Any]]:
    """What a doctor that ends with 1 found, by what it looked at."""
    done = subprocess.run(
        [sys.executable, "-m", "luxloop", "doctor", "--json"],
        env=as_environment(settings),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    return {finding["what"]: finding for finding in json.loads(done.stdout)["findings"]}


def test_an_unusable_cache_is_found_beside_the_rest(settings: Settings, tmp_path: Path) -> None:
    """The folder, what is wrong, the variable to set; the router is looked at all the same."""
    (tmp_path / "file").touch()
    found = findings(settings.model_copy(update={"cache": tmp_path / "file"}))
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
        found = findings(settings.model_copy(update={"router": endpoint}))
    assert found["router"]["verdict"] == "fail"
    assert found["router"]["found"] == f"what listens at {endpoint} is no router of luxloop"
    assert "LUXLOOP_ROUTER" in found["router"]["mend"]
