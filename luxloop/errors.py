"""What goes wrong, and who is told.

Policy. Three things can go wrong, and each has one class:

* somebody handed in something that cannot be used: `InputError`, raised at the border where the thing enters
  (command line, file, message) and by physics functions for a value out of range. It names field, value, allowed
  range and the mend. Command line: exit code 2. On the bus: a `Failure` with code `bad_input`.
* the other side of the bus could not do what was asked: `RemoteError`. The worker's typed `Failure` is inside.
* something of ours is broken: any other exception. It is not caught to be hidden; a worker turns it into a
  `Failure` with code `crashed`, goes on, and the task is tried again elsewhere.

Never a bare except, never a silent None.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from luxloop.failure import Failure


def shortened(text: str, most: int) -> str:
    """`text`, its end left out where it is longer than `most` characters."""
    return text if len(text) <= most else text[: most - 3] + "..."


def shown(value: object, most: int = 80) -> str:
    """A value in at most `most` characters, also one that Python refuses to write out."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a number of more than 4,300 digits; what nests too deeply
        text = hex(value) if isinstance(value, int) else f"a {type(value).__name__} too large to show"
    return shortened(text, most)


class LuxloopError(Exception):
    """Base of all errors that a caller may want to catch; `exit_code` is what the command line ends with."""

    exit_code = 1


class InputError(LuxloopError, ValueError):
    """A value that cannot be used: which field, which value, what is allowed, how to mend it."""

    exit_code = 2

    def __init__(self, field: str, value: object, allowed: str, mend: str = "") -> None:
        self.field, self.value, self.allowed, self.mend = field, value, allowed, mend
        said = f"{shortened(field, 400)}: got {shown(value)}, allowed: {shortened(allowed, 1000)}"
        super().__init__(said + (f"; {shortened(mend, 1000)}" if mend else ""))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str, str]]:
        return type(self), (self.field, self.value, self.allowed, self.mend)


class RemoteError(LuxloopError):
    """The other side of the bus answered with a `Failure`, or gave no answer at all."""

    def __init__(self, failure: Failure) -> None:
        self.failure = failure
        super().__init__(failure.text())

    @property
    def exit_code(self) -> int:  # type: ignore[override]  # a property where the base has a constant
        """2 where the request was at fault, 1 where the other side was."""
        return 2 if self.failure.code in ("bad_input", "too_large", "unknown_effect") else 1
