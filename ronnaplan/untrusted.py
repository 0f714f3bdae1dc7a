"""Files that others wrote: read whole, within a size, and parsed by the letter, never by what may have been meant."""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ronnaplan.errors import NOT_READ, STANDARD_INPUT, InputError
from ronnaplan.text import LONGEST_NUMBER, MOST_DIGITS, printable

Model = TypeVar("Model", bound=BaseModel)

TOO_DEEP = "it is nested too deeply"
PARSER_TOO_DEEP = "Invalid JSON: recursion limit exceeded"
"""How pydantic's parser says so, which reads fewer levels than Python's own."""


def read_whole(path: str | os.PathLike[str], most_bytes: int, *, expected: str) -> bytes:
    """Return the bytes of the regular file at ``path``.

    Raises `InputError`, naming what was ``expected``, for a file that is missing, unreadable or larger than
    ``most_bytes``, and for pipes and devices, which would be waited for.
    """
    require_file(path, expected=expected)
    try:
        with Path(path).open("rb") as stream:
            content = stream.read(most_bytes + 1)
    except OSError as error:
        raise InputError(f"{os.fspath(path)} cannot be read: {error.strerror}; expected {expected}") from error
    if len(content) > most_bytes:
        raise InputError(f"{os.fspath(path)} is larger than {most_bytes} bytes; expected {expected}")
    return content


def require_file(path: str | os.PathLike[str], *, expected: str) -> None:
    """Raise `InputError`, naming what was ``expected``, unless there is a regular file at ``path``."""
    source = Path(path)
    try:
        if source.is_file():
            return
        reason = _no_file(source)
    except (OSError, ValueError) as error:  # a path with a null byte is a ValueError
        reason = getattr(error, "strerror", None) or str(error)
    raise InputError(f"{os.fspath(path)} cannot be read: {reason}; expected {expected}")


def _no_file(path: Path) -> str:
    """Say why there is nothing to read at ``path``, where there is no regular file."""
    if path.is_dir():
        return "it is a folder"
    if path.exists():
        return "it is no regular file, so save what a pipe brings to one"
    return NOT_READ if os.fspath(path) == STANDARD_INPUT else "there is no such file"


def parse_json(content: bytes) -> Any:
    """Return the value of a JSON text.

    Raises ValueError for what is not JSON and for what readers understand differently: two members of one name,
    numbers that are not finite or have more than `MOST_DIGITS` digits, lone surrogates, and nesting beyond reason.
    """
    try:
        value = json.loads(
            content,
            object_pairs_hook=_unique,
            parse_constant=_no_constant,
            parse_float=_finite,
            parse_int=_whole,
        )
        json.dumps(value, ensure_ascii=False).encode()
    except RecursionError as error:
        raise ValueError(TOO_DEEP) from error
    return value


def checked(content: Any, model: type[Model]) -> Model:
    """Return ``content`` of JSON or TOML as ``model``, strictly: no text or truth value passes for a number.

    Raises ValueError naming the first field that is wrong, and for nesting beyond reason.
    """
    try:
        # by way of a text, since pydantic's strict mode knows JSON's types (a list for a tuple) only there
        return model.model_validate_json(json.dumps(content, default=_no_field), strict=True)
    except ValidationError as error:
        is_deep = PARSER_TOO_DEEP in error.errors(include_url=False)[0]["msg"]
        raise ValueError(TOO_DEEP if is_deep else first_fault(error)) from error
    except RecursionError as error:
        raise ValueError(TOO_DEEP) from error


def _no_field(value: object) -> dict[str, str]:
    """Return what no field takes, so that the field is named, for a date or time of TOML."""
    return {type(value).__name__: str(value)}


def first_fault(error: ValidationError) -> str:
    """Name the first field that is wrong, why, and what was found there."""
    first, *others = error.errors(include_url=False)
    where = _place(first["loc"])
    if first["type"] == "extra_forbidden":
        return f"{where}: no field of this document"
    for other in others:
        if first["type"] == "missing" and (other["type"], other["loc"][:-1]) == (
            "extra_forbidden",
            first["loc"][:-1],
        ):
            return f"{_place(other['loc'])}: no field of this document, which lacks {where}"
    return f"{where}: {first['msg'].removeprefix('Value error, ')}{_found(first['type'], first['input'])}"


def _place(location: tuple[int | str, ...]) -> str:
    return ".".join(map(printable, location)) or "the document"


def _found(kind: str, value: Any) -> str:
    """Say what was found, if that is a number or one of JSON's constants, or a word in place of certain others.

    Other texts may name a patient, and checks of this project say by themselves what they found.
    """
    is_word = kind == "literal_error" and isinstance(value, str)
    if kind in ("missing", "value_error") or not (
        is_word or value is None or isinstance(value, bool | int | float)
    ):
        return ""
    return f", found {printable(json.dumps(value)[:LONGEST_NUMBER])}"


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) < len(pairs):
        counts = Counter(name for name, _ in pairs)
        twice = next(name for name, count in counts.items() if count > 1)
        raise ValueError(f"'{twice}' stands twice in one object")
    return members


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is no number of JSON")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:LONGEST_NUMBER]} is too large")
    return value


def _whole(text: str) -> int:
    if len(text) > MOST_DIGITS + 1:
        raise ValueError(f"a number has {len(text)} digits")
    return int(text)
