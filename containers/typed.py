"""What a person types at a command: numbers and ranges, a stack as a sentence, names of files to write."""

from __future__ import annotations

import math
import os
from pathlib import Path

from luxloop.errors import InputError
from luxloop.stack import Layer, Medium, Stack
from luxloop.words import parse

MOST_NUMBERS = 10_000


def numbers(option: str, text: str) -> list[float]:
    """The numbers of `5.5`, `1,2,3` or `first:last:step` (last included). Raises InputError naming the option."""
    allowed = "a number, a list 1,2,3 or a range first:last:step"
    try:
        parts = [float(part) for part in text.split(":" if ":" in text else ",")]
    except ValueError as error:
        raise InputError(option, text, allowed) from error
    if not all(map(math.isfinite, parts)):
        raise InputError(option, text, "finite numbers")
    if ":" in text:
        return _range(option, text, parts, allowed)
    if len(parts) > MOST_NUMBERS:
        raise InputError(option, text, f"at most {MOST_NUMBERS:,} values")
    return parts


def _range(option: str, text: str, parts: list[float], allowed: str) -> list[float]:
    if len(parts) != 3 or parts[2] <= 0 or parts[1] < parts[0]:
        raise InputError(option, text, f"{allowed}, step above 0, last not below first")
    first, last, step = parts
    steps = (last - first) / step  # infinite where the range is enormous or the step is tiny
    if steps >= MOST_NUMBERS:
        raise InputError(option, text, f"at most {MOST_NUMBERS:,} values", "take a larger step")
    return [min(first + i * step, last) for i in range(int(steps + 1e-9) + 1)]


def parse_stack(text: str) -> Stack:
    """A stack from its sentence, from the bulk outwards: `GaN | AlN 51.6 ~1 | 2.49+0.01i 45.2 | air`.

    A medium is a material's name, or an index n or n+ki; a layer adds its thickness in nm, `~` its outer face's
    roughness in nm, and the word `incoherent` where powers add. Raises InputError naming the part.
    """
    parts = [part.split() for part in text.split("|")]
    if len(parts) < 2 or not all(parts):
        raise InputError("--stack", text, "media separated by |, at least the two half spaces")
    first, *layers, last = parts
    if len(last) != 1:
        raise InputError("--stack", " ".join(last), "one word: the outermost medium has no thickness")
    inside, inside_roughness_nm = first[0], 0.0
    if len(first) == 2 and first[1].startswith("~"):
        inside_roughness_nm = _number(first[1][1:], " ".join(first))
    elif len(first) != 1:
        raise InputError("--stack", " ".join(first), "one word: the innermost medium has no thickness")
    return parse(
        Stack,
        {
            "inside": _medium(inside),
            "layers": tuple(_layer(words) for words in layers),
            "outside": _medium(last[0]),
            "inside_roughness_nm": inside_roughness_nm,
        },
        "--stack",
    )


def _layer(words: list[str]) -> Layer:
    rest, whole = list(words[1:]), " ".join(words)
    coherent = "incoherent" not in rest
    rest = [word for word in rest if word != "incoherent"]
    rough = [word for word in rest if word.startswith("~")]
    thickness = [word for word in rest if not word.startswith("~")]
    if len(thickness) != 1 or len(rough) > 1:
        raise InputError("--stack", whole, "medium thickness [~roughness] [incoherent], lengths in nm")
    return parse(
        Layer,
        {
            "medium": _medium(words[0]),
            "thickness_nm": _number(thickness[0], whole),
            "roughness_nm": _number(rough[0][1:], whole) if rough else 0.0,
            "coherent": coherent,
        },
        f"--stack: {whole!r}",
    )


def _medium(word: str) -> Medium:
    try:
        index = complex(word.replace("i", "j"))
    except ValueError:
        return parse(Medium, {"material": word}, "--stack") if word != "air" else Medium(n=1.0)
    return parse(Medium, {"n": index.real, "k": index.imag}, f"--stack: {word!r}")


def _number(word: str, whole: str) -> float:
    try:
        return float(word.removesuffix("nm"))
    except ValueError as error:
        raise InputError("--stack", whole, "a number of nm", f"{word!r} is none") from error


def check_file(option: str, file: Path | None, endings: tuple[str, ...]) -> None:
    """InputError unless `file` (where given) has one of the endings and can be written; asked before work begins."""
    if file is None:
        return
    if file.suffix.lower() not in endings:
        raise InputError(option, str(file), "a name that ends with " + " or ".join(endings))
    try:
        _try_to_write(file)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        why = getattr(error, "strerror", None) or str(error)
        raise InputError(option, str(file), "a file that can be written, in a folder that exists", why) from error


def _try_to_write(file: Path) -> None:
    """Raises OSError where that cannot be done; leaves what is there as it is. Rights alone do not tell."""
    if file.exists():
        os.close(os.open(file, os.O_WRONLY | os.O_NONBLOCK))  # a folder, and a pipe that nobody reads, are refused
        return
    file.touch(exist_ok=False)
    file.unlink()
