"""Arrays too large for a frame: served in pieces of 1 MB by whoever holds them, fetched by hash."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from luxloop.bus import Asked, Bus, ask_for
from luxloop.bus.frame import ARRAY_BYTES, decode, encode
from luxloop.bus.keys import KEYS, at
from luxloop.errors import InputError
from luxloop.failure import Failure
from luxloop.messages import BlobAsked, BlobPiece
from luxloop.store import BlobStore


def fetcher(bus: Bus, realm: str, store: BlobStore) -> Callable[[str, int], bytes]:
    """A function (sha256, bytes) -> the bytes: from this host's store, else piece by piece over the bus."""

    def fetch(sha256: str, size: int) -> bytes:
        held = store.get(sha256)
        if held is not None:
            return held
        if size > ARRAY_BYTES:
            raise InputError("blob", f"{size} bytes", f"at most {ARRAY_BYTES} bytes")
        pieces, offset, holder = [], 0, "*"
        while offset < size:
            key = at(realm, "blob", sha256=sha256, worker=holder)
            parcel = ask_for(bus, key, BlobAsked(offset=offset), KEYS["blob"].time_limit_s)
            told, piece = parcel.expect(BlobPiece), parcel.arrays["piece"].tobytes()
            if told.total_bytes != size or not piece:
                raise InputError("blob", f"{told.total_bytes} bytes", f"{size} bytes as announced")
            pieces.append(piece)
            offset, holder = offset + len(piece), told.holder
        raw = b"".join(pieces)
        if store.keep(raw) != sha256:
            raise InputError("blob", f"{len(raw)} bytes", f"bytes with SHA-256 {sha256}", "fetch it again")
        return raw

    return fetch


Source = Callable[[str, int, int], tuple[bytes, int] | None]
"""(sha256, offset, length) -> the piece and the size of the whole, or None where it is not held."""


def serve_piece(asked: Asked, source: Source, holder: str) -> None:
    """Answer as `holder` a question for a piece, or drop it where the blob is not held: somebody else may have it.

    A source that fails, on its disk or in its database, is a failure of this answer only.
    """
    try:
        want = decode(asked.frame).expect(BlobAsked)
        found = source(asked.key.split("/")[-2], want.offset, want.length)
        if found is None:
            asked.drop()
            return
        piece, total = np.frombuffer(found[0], dtype="|u1"), found[1]
        asked.reply(encode(BlobPiece(holder=holder, offset=want.offset, total_bytes=total), {"piece": piece}))
    except Exception as error:  # noqa: BLE001  the asker is told, and its holder goes on
        asked.reply(Failure.of(error, asked.key))
