"""Which effects the workers of this room know: none in this release."""

from __future__ import annotations

from collections.abc import Sequence

from luxloop.effect import AppliedEffect
from luxloop.errors import RemoteError
from luxloop.failure import Failure


def refuse_unknown(effects: Sequence[AppliedEffect], worker: str) -> None:
    """Raises RemoteError where a request has effects: nothing is computed without an effect of its model."""
    if not effects:
        return
    names = ", ".join(effect.name for effect in effects)
    raise RemoteError(
        Failure(
            code="unknown_effect",
            message=f"the {worker} worker knows no effect {names}",
            field="effects",
            value=names,
            allowed="none in this release",
            mend="take the effects out of the model file",
        )
    )
