"""Arrays too large for a frame: served in pieces of 1 MB by whoever holds them, fetched by hash."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from luxloop.bus import Asked, Bus, ask_for
from luxloop.bus.frame import ARRAY_BYTES, decode, encode
from luxloop.bus.keys import KEYS, at, last_part
from luxloop.errors import InputError, LuxloopError
from luxloop.messages import BlobAsked, BlobPiece, Failure
from luxloop.store import BlobStore


def fetcher(bus: Bus, realm: str, store: BlobStore) -> Callable[[str, int], bytes]:
    """A function (sha256, bytes) -> the bytes: from this host's store, else piece by piece over the bus."""

    def fetch(sha256: str, size: int) -> bytes:
        held = store.get(sha256)
        if held is not None:
            return held
        if size > ARRAY_BYTES:
            raise InputError("blob", f"{size} bytes", f"at most {ARRAY_BYTES} bytes")
        key, pieces, offset = at(realm, "blob", sha256=sha256), [], 0
        while offset < size:
            parcel = ask_for(bus, key, BlobAsked(offset=offset), KEYS["blob"].time_limit_s)
            piece = parcel.arrays["piece"].tobytes()
            if parcel.expect(BlobPiece).total_bytes != size or not piece:
                raise InputError(
                    "blob", f"{parcel.expect(BlobPiece).total_bytes} bytes", f"{size} bytes as announced"
                )
            pieces.append(piece)
            offset += len(piece)
        raw = b"".join(pieces)
        if store.keep(raw) != sha256:
            raise InputError("blob", f"{len(raw)} bytes", f"bytes with SHA-256 {sha256}", "fetch it again")
        return raw

    return fetch


def serve_piece(asked: Asked, source: Callable[[str], bytes | None]) -> None:
    """Answer a question for a piece, or drop it where the blob is not held here: somebody else may have it."""
    try:
        want = decode(asked.frame).expect(BlobAsked)
        raw = source(last_part(asked.key))
        if raw is None:
            asked.drop()
            return
        piece = np.frombuffer(raw[want.offset : want.offset + want.length], dtype="|u1")
        asked.reply(encode(BlobPiece(offset=want.offset, total_bytes=len(raw)), {"piece": piece}))
    except LuxloopError as error:
        asked.reply(Failure.of(error, asked.key))
