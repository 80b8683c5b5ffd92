"""By which state of the sources a verdict was given: a version stays what it is over many changes of them."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("containers", "luxloop", "validation")


@cache
def code_sha256() -> str:
    """SHA-256 of the names and bytes of all sources that verdicts come of, as they are installed here.

    Workers on other machines have their own.
    """
    digest = hashlib.sha256()
    for package in PACKAGES:
        spec = find_spec(package)
        for root in sorted(spec.submodule_search_locations or ()) if spec is not None else ():
            for path in sorted(Path(root).rglob("*.py")):
                digest.update(f"{package}/{path.relative_to(root)}\n{path.stat().st_size}\n".encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()
