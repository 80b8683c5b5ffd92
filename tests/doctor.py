"""The doctor as a process, for tests of what it finds."""

from __future__ import annotations

import json
from typing import Any

from luxloop.settings import Settings, as_environment
from tests.forks import luxloop


def doctor(settings: Settings, *argv: str) -> tuple[int, dict[str, dict[str, Any]]]:
    """Its exit code, and what it found by what it looked at."""
    done = luxloop("doctor", "--json", *argv, env=as_environment(settings))
    assert done.stdout, done.stderr
    return done.returncode, {finding["what"]: finding for finding in json.loads(done.stdout)["findings"]}


def ill(settings: Settings, *argv: str) -> dict[str, dict[str, Any]]:
    """What a doctor found that ends with 1."""
    code, findings = doctor(settings, *argv)
    assert code == 1
    return findings
