"""What every message and file model of luxloop has in common: frozen, unknown keys refused, finite, hashable.

`canonical` is the one text form that is hashed: JSON with sorted keys, no blanks, no NaN. Task ids, content hashes
and version hashes all come from it, so the same inputs have the same name on every machine.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from luxloop.errors import InputError

Model = TypeVar("Model", bound=BaseModel)


class Words(BaseModel):
    """Base of everything that is written to a file or sent: frozen, strict about keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)


def canonical(value: BaseModel | Mapping[str, Any] | list[Any] | tuple[Any, ...]) -> bytes:
    """The one text form that is hashed: UTF-8 JSON, keys sorted, no blanks, floats by shortest repr."""
    plain = value.model_dump(mode="json") if isinstance(value, BaseModel) else value
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    if "-0.0" in text:
        text = json.dumps(_without_minus_zero(plain), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return text.encode()


def _without_minus_zero(value: Any) -> Any:
    """The same with 0.0 for -0.0: the two are equal, so they must have one text."""
    if isinstance(value, dict):
        return {key: _without_minus_zero(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_minus_zero(item) for item in value]
    return 0.0 if isinstance(value, float) and value == 0.0 else value


def sha256_of(value: BaseModel | Mapping[str, Any] | list[Any] | tuple[Any, ...]) -> str:
    """SHA-256 of the canonical form, 64 hex digits."""
    return hashlib.sha256(canonical(value)).hexdigest()


def parse(model: type[Model], data: object, where: str = "") -> Model:
    """`data` as a `model`, or an `InputError` naming the first wrong field with its path, value and range.

    `where` says where the data came from (a file name, a message), and leads the field path.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise as_input_error(error, where) from error


def as_input_error(error: ValidationError, where: str = "") -> InputError:
    """A pydantic `ValidationError` as the project's own: the first wrong field, how many more there are."""
    first, *others = error.errors()
    path = ".".join(str(part) for part in first["loc"]) or "(whole)"
    context = first.get("ctx", {}).get("error")
    if isinstance(context, InputError):
        named = path.rpartition(".")[2] == context.field
        inner = context.field if path == "(whole)" else path if named else f"{path}.{context.field}"
        return InputError(f"{where}: {inner}" if where else inner, context.value, context.allowed, context.mend)
    mends = ["remove it, or look for the right spelling"] * (first["type"] == "extra_forbidden")
    if others:
        mends.append(f"{len(others)} more wrong: " + ", ".join(".".join(map(str, one["loc"])) for one in others[:3]))
    allowed = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    return InputError(f"{where}: {path}" if where else path, first["input"], allowed, "; ".join(mends))


Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Text = Annotated[str, Field(max_length=4000)]


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    try:
        canonical(values)
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError("values", str(error)[:200], "JSON values and finite numbers only") from error
    return values


Plain = Annotated[dict[str, Any], AfterValidator(_finite)]
