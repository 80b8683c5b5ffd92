"""Why something could not be done, as a message: the typed failures of the bus."""

from __future__ import annotations

from typing import Literal

from luxloop.errors import InputError, shown
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


class Failure(Words):
    """Why something could not be done, typed: `code` for machines, the rest for a person."""

    code: Code
    message: Text
    field: Text = ""
    value: Text = ""
    allowed: Text = ""
    mend: Text = ""
    where: Text = ""
    history: tuple[Text, ...] = ()

    def text(self) -> str:
        """One line for a person: what, where, the mend, and what was tried before."""
        parts = [self.message] + [f"[{self.where}]"] * bool(self.where)
        parts += [f"mend: {self.mend}"] * (bool(self.mend) and self.mend not in self.message)
        return f"{self.code}: " + "; ".join(parts + list(self.history))

    @classmethod
    def of(cls, error: BaseException, where: str = "") -> Failure:
        """An exception as a message: `InputError` keeps its fields, anything else is a crash of that side."""
        if isinstance(error, InputError):
            fields = {name: printable(str(getattr(error, name)))[:4000] for name in ("field", "allowed", "mend")}
            said = {"message": printable(str(error))[:4000], "value": shown(error.value, 200)}
            return cls(code="bad_input", **fields, **said, where=where)
        return cls(code="crashed", message=printable(f"{type(error).__name__}: {error}")[:4000], where=where)


def printable(text: str) -> str:
    """`text` with what cannot be encoded replaced: file names and exception texts may hold anything."""
    return text.encode(errors="replace").decode()
