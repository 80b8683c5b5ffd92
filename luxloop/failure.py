"""Why something could not be done, as a message: the typed failures of the bus."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator

from luxloop.errors import InputError, shortened, shown
from luxloop.words import Text, Words

Code = Literal[
    "bad_input",  # the request cannot be used; trying again will not help
    "too_large",  # over the size limit of its key
    "busy",  # a bounded queue is full; try again later
    "version",  # the other side speaks another schema or is of another release
    "no_router",  # no router at the endpoint
    "no_controller",  # a router, but nobody who answers
    "no_worker",  # nobody of that kind came within the task's patience
    "worker_lost",  # workers died or fell silent while computing it, as often as is allowed
    "crashed",  # the worker's computation raised, as often as is allowed
    "cancelled",  # its submitters withdrew it
    "stale",  # of an attempt or an epoch that is over
    "refused",  # not permitted
    "timed_out",  # over its own time limit
    "not_found",  # a blob nobody holds, a task nobody knows
    "unknown_effect",  # the worker does not know the effect, or another source of it
]


def printable(text: str) -> str:
    """`text` with what cannot be encoded replaced: file names and exception texts may hold anything."""
    return text.encode(errors="replace").decode()


def _told(value: object) -> object:
    return shortened(printable(value), 4000) if isinstance(value, str) else value


Told = Annotated[Text, BeforeValidator(_told)]
"""A text that is made printable and cut short, never refused: else who asked would not be told anything."""


class Failure(Words):
    """Why something could not be done, typed: `code` for machines, the rest for a person."""

    code: Code
    message: Told
    field: Told = ""
    value: Told = ""
    allowed: Told = ""
    mend: Told = ""
    where: Told = ""
    history: tuple[Told, ...] = ()

    def text(self) -> str:
        """One line for a person: what, where, the mend, and what was tried before."""
        parts = [self.message] + [f"[{self.where}]"] * bool(self.where)
        parts += [f"mend: {self.mend}"] * (bool(self.mend) and self.mend not in self.message)
        return f"{self.code}: " + "; ".join(parts + list(self.history))

    @classmethod
    def of(cls, error: BaseException, where: str = "") -> Failure:
        """An exception as a message: `InputError` keeps its fields, anything else is a crash of that side."""
        if isinstance(error, InputError):
            fields = {name: str(getattr(error, name)) for name in ("field", "allowed", "mend")}
            return cls(code="bad_input", message=str(error), value=shown(error.value, 200), where=where, **fields)
        return cls(code="crashed", message=f"{type(error).__name__}: {error}", where=where)
