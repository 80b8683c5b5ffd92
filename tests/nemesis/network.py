"""What only root may break: a network in a namespace, a small disk; where that is not permitted, why not."""

from __future__ import annotations

import os
import subprocess
from contextlib import suppress
from pathlib import Path

PIECE_BYTES = 1 << 16


class NotPermittedError(Exception):
    """This machine does not let us; the text says what."""


class Wire:
    """A network namespace with one wire to this host; `host` is the address of this end. Leave it by `with`.

    `inside` goes before a command that is to run there.
    """

    def __init__(self) -> None:
        number = os.getpid() % 60_000
        self._name, self._near, self._far = f"lux{number}", f"luxa{number}", f"luxb{number}"
        net = f"10.{200 + number // 16_384}.{number // 64 % 256}.{4 * (number % 64)}"
        first = net.rpartition(".")
        self.host, self._there = (f"{first[0]}.{int(first[2]) + more}" for more in (1, 2))
        self.inside = ("ip", "netns", "exec", self._name)

    def __enter__(self) -> Wire:
        try:
            _ip("netns", "add", self._name)
            _ip("link", "add", self._near, "type", "veth", "peer", "name", self._far)
            _ip("link", "set", self._far, "netns", self._name)
            _ip("addr", "add", f"{self.host}/30", "dev", self._near)
            _ip("link", "set", self._near, "up")
            _ip("-n", self._name, "addr", "add", f"{self._there}/30", "dev", self._far)
            _ip("-n", self._name, "link", "set", self._far, "up")
            _ip("-n", self._name, "link", "set", "lo", "up")
        except NotPermittedError:
            self._remove()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._remove()

    def cut(self) -> None:
        """Pull the wire out."""
        _ip("link", "set", self._near, "down")

    def heal(self) -> None:
        """Put it back."""
        _ip("link", "set", self._near, "up")

    def _remove(self) -> None:
        for command in (("link", "del", self._near), ("netns", "del", self._name)):
            with suppress(NotPermittedError):
                _ip(*command)


class SmallDisk:
    """A disk of a few MB mounted at `folder`, with a file that fills it. Leave it by `with`."""

    def __init__(self, folder: Path, size_mb: int = 48) -> None:
        self.folder, self._size_mb = folder, size_mb
        self._filler = folder / "filler"

    def __enter__(self) -> SmallDisk:
        self.folder.mkdir(exist_ok=True)
        _run("mount", "-t", "tmpfs", "-o", f"size={self._size_mb}m", "tmpfs", str(self.folder))
        return self

    def __exit__(self, *_: object) -> None:
        _run("umount", "-l", str(self.folder))

    def fill(self) -> None:
        """Nothing more can be written there."""
        with self._filler.open("wb", buffering=0) as file, suppress(OSError):
            while True:
                file.write(bytes(PIECE_BYTES))

    def empty(self) -> None:
        """There is room again."""
        self._filler.unlink(missing_ok=True)


def _ip(*words: str) -> None:
    _run("ip", *words)


def _run(*command: str) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    except OSError as error:
        raise NotPermittedError(f"{command[0]}: {error.strerror}") from error
    if done.returncode:
        raise NotPermittedError(f"{' '.join(command)}: {done.stderr.strip()}")
