"""What a person types at a command: numbers and ranges, a stack as a sentence, names of files to write."""

from __future__ import annotations

import math
from pathlib import Path

from luxloop.errors import InputError
from luxloop.files import try_to_write
from luxloop.film import GRAZING_DEG, MAX_PLACES
from luxloop.stack import MAX_K, MAX_LAYERS, MAX_N, MAX_NAME, MAX_ROUGHNESS_NM, MAX_THICKNESS_NM, Layer, Medium, Stack
from luxloop.words import parse

WAVELENGTH_NM = (1.0, 1e6)
EXAMPLE = "for example GaN | AlN 51.6 ~1 | air"


def numbers(option: str, text: str) -> list[float]:
    """The numbers of `5.5`, `1,2,3` or `first:last:step` (last included). Raises InputError naming the option."""
    allowed, mend = "a number, a list 1,2,3 or a range first:last:step", "for example 0:80:20"
    try:
        parts = [float(part) for part in text.split(":" if ":" in text else ",")]
    except ValueError as error:
        raise InputError(option, text, allowed, mend) from error
    if not all(map(math.isfinite, parts)):
        raise InputError(option, text, "finite numbers", mend)
    if ":" in text:
        return _range(option, text, parts, allowed)
    if len(parts) > MAX_PLACES:
        raise InputError(option, text, f"at most {MAX_PLACES:,} values", "ask in parts")
    return parts


def angles_deg(option: str, text: str) -> list[float]:
    """The angles of incidence in a text, degrees; InputError naming the option unless all are from 0 to below 90."""
    mend = "angles from the normal; at 90 light only grazes the film: end at 89.9"
    return _all_within(option, numbers(option, text), 0.0, GRAZING_DEG, "0 to below 90 deg", mend, below=True)


def wavelengths_nm(option: str, text: str) -> list[float]:
    """The vacuum wavelengths in a text, nm; InputError naming the option unless all are within `WAVELENGTH_NM`."""
    least, most = WAVELENGTH_NM
    return _all_within(option, numbers(option, text), least, most, f"{least:g} to {most:g} nm", "give nanometres")


def dbr_pairs(option: str, text: str) -> list[float]:
    """The pairs of DBRs in a text; InputError naming the option unless all are multiples of 0.5 from 0 to 100."""
    from containers.stack import MAX_PAIRS

    found = _all_within(option, numbers(option, text), 0.0, MAX_PAIRS, f"0 to {MAX_PAIRS:g} pairs", "take fewer")
    for value in found:
        if not (2 * value).is_integer():
            mend = f"take {math.floor(2 * value) / 2:g} or {math.ceil(2 * value) / 2:g}"
            raise InputError(option, value, f"multiples of 0.5 from 0 to {MAX_PAIRS:g}", mend)
    return found


def bandwidth_nm(option: str, value: float) -> float:
    """The full width of an instrument's line; InputError naming the option unless it is from 0 to 1000 nm."""
    return _all_within(option, [value], 0.0, 1000.0, "0 to 1000 nm", "give the full width at half maximum, or 0")[0]


def _all_within(
    option: str, values: list[float], least: float, most: float, allowed: str, mend: str, *, below: bool = False
) -> list[float]:
    for value in values:
        if not least <= value <= most or (below and value == most):
            raise InputError(option, value, allowed, mend)
    return values


def _range(option: str, text: str, parts: list[float], allowed: str) -> list[float]:
    if len(parts) != 3 or parts[2] <= 0 or parts[1] < parts[0]:
        raise InputError(option, text, f"{allowed}, step above 0, last not below first", "for example 0:80:20")
    first, last, step = parts
    steps = (last - first) / step  # infinite where the range is enormous or the step is tiny
    if steps >= MAX_PLACES:
        raise InputError(option, text, f"at most {MAX_PLACES:,} values", "take a larger step")
    return [min(first + i * step, last) for i in range(int(steps + 1e-9) + 1)]


def parse_stack(text: str) -> Stack:
    """A stack from its sentence, from the bulk outwards: `GaN | AlN 51.6 ~1 | 2.49+0.01i 45.2 | air`.

    A medium is a material's name, or an index n or n+ki; a layer adds its thickness in nm, `~` its outer face's
    roughness in nm, and the word `incoherent` where powers add. Raises InputError naming the part.
    """
    parts = [part.split() for part in text.split("|")]
    if len(parts) < 2 or not all(parts):
        raise InputError("--stack", text, "media separated by |, at least the two half spaces", EXAMPLE)
    first, *layers, last = parts
    if len(layers) > MAX_LAYERS:
        raise InputError("--stack", f"{len(layers)} layers", f"at most {MAX_LAYERS}", "leave out or join layers")
    if len(last) != 1:
        raise InputError("--stack", " ".join(last), "one word: the outermost medium has no thickness", EXAMPLE)
    inside, inside_roughness_nm = first[0], 0.0
    if len(first) == 2 and first[1].startswith("~"):
        inside_roughness_nm = _length_nm("roughness", first[1][1:], MAX_ROUGHNESS_NM, " ".join(first))
    elif len(first) != 1:
        raise InputError("--stack", " ".join(first), "one word: the innermost medium has no thickness", EXAMPLE)
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
        allowed = "medium thickness [~roughness] [incoherent], lengths in nm"
        raise InputError("--stack", whole, allowed, EXAMPLE)
    return parse(
        Layer,
        {
            "medium": _medium(words[0]),
            "thickness_nm": _length_nm("thickness", thickness[0], MAX_THICKNESS_NM, whole),
            "roughness_nm": _length_nm("roughness", rough[0][1:], MAX_ROUGHNESS_NM, whole) if rough else 0.0,
            "coherent": coherent,
        },
        f"--stack: {whole!r}",
    )


def _medium(word: str) -> Medium:
    try:
        index = complex(word.replace("i", "j"))
    except ValueError:
        if len(word) > MAX_NAME:
            raise InputError("--stack", word, f"a name of at most {MAX_NAME}", "luxloop materials list") from None
        return Medium(material=word) if word != "air" else Medium(n=1.0)
    if not (0.0 < index.real <= MAX_N and 0.0 <= index.imag <= MAX_K):
        allowed = f"an index n or n+ki, n above 0 to {MAX_N:g}, k 0 to {MAX_K:g}"
        raise InputError("--stack", word, allowed, "absorption has a plus sign: 2.49+0.01i")
    return Medium(n=index.real, k=index.imag)


def _length_nm(what: str, word: str, most: float, whole: str) -> float:
    try:
        value = float(word.removesuffix("nm"))
    except ValueError as error:
        raise InputError("--stack", whole, f"a {what} in nm", f"{word!r} is no number") from error
    if not 0.0 <= value <= most:
        raise InputError("--stack", whole, f"a {what} of 0 to {most:g} nm", f"{word!r} is outside: correct it")
    return value


def check_file(option: str, file: Path | None, endings: tuple[str, ...]) -> None:
    """InputError unless `file` (where given) has one of the endings and can be written; asked before work begins."""
    if file is None:
        return
    if file.suffix.lower() not in endings:
        mend = f"for example {file.stem or 'film'}{endings[0]}"
        raise InputError(option, str(file), "a name that ends with " + " or ".join(endings), mend)
    try:
        try_to_write(file)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        why = getattr(error, "strerror", None) or str(error)
        raise InputError(option, str(file), "a file that can be written, in a folder that exists", why) from error
