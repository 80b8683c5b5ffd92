"""The SHA-256 chain over a journal: every record's link covers all records before it.

    link = SHA-256(previous link | topic length u32 | topic | sequence u64 | log time u64 | SHA-256(data))

A chain finds what was edited, deleted in the middle or put in another order, whatever the file's compression. It
does not find a tail that was cut off, or a file written anew as a whole: for that the root and the count of records
must have left the machine.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable
from dataclasses import dataclass

GENESIS = "0" * 64
"""The root of a journal without records."""


@dataclass(frozen=True)
class Link:
    """What the chain covers: one record as it lies in the file; metadata and attachments too, before the messages."""

    topic: str
    sequence: int
    log_time_ns: int
    data: bytes


@dataclass(frozen=True)
class Mark:
    """How far a chain has come: so many records, and their root."""

    records: int = 0
    root: str = GENESIS

    def then(self, links: Iterable[Link]) -> Mark:
        """The mark after these links too."""
        records, root = self.records, bytes.fromhex(self.root)
        for link in links:
            records, root = records + 1, next_root(root, link)
        return Mark(records, root.hex())


def next_root(root: bytes, link: Link) -> bytes:
    """The 32 bytes after `root` that cover `link` and all before it."""
    topic = link.topic.encode()
    head = struct.pack("<I", len(topic)) + topic + struct.pack("<QQ", link.sequence, link.log_time_ns)
    return hashlib.sha256(root + head + hashlib.sha256(link.data).digest()).digest()
