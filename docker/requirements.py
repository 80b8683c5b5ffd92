"""Prints the packages that luxloop needs, and those of the extras named: `python requirements.py workers`.

An image installs them from this list, a layer below luxloop itself: a change of the code does not bring them anew.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path


def wanted(pyproject: Path, extras: list[str]) -> list[str]:
    """The requirements of `pyproject`, those of the named extras last. Raises KeyError for an extra it has not."""
    project = tomllib.loads(pyproject.read_text())["project"]
    return [*project["dependencies"], *(one for extra in extras for one in project["optional-dependencies"][extra])]


if __name__ == "__main__":
    sys.stdout.write("\n".join(wanted(Path(__file__).parent / "pyproject.toml", sys.argv[1:])) + "\n")
