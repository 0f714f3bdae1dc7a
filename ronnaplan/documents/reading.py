"""Reading and writing a document of this project: its format, its version, and then every field, strictly.

Strict means: no text or truth value passes for a number, no number for a text, nothing unknown is passed over, and
what could not be read back is not written.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError

from ronnaplan.documents.fields import SOFTWARE
from ronnaplan.documents.files import read_json
from ronnaplan.errors import InputError, check_type
from ronnaplan.text import printable
from ronnaplan.untrusted import TOO_DEEP, checked, first_fault, read_whole

Document = TypeVar("Document", bound=BaseModel)

MOST_SETTINGS_BYTES = 1 << 18
"""Settings that a person wrote are not larger."""

MOST_DOTS = 600
"""A line of settings has fewer: a key of so many parts takes time that grows with their square."""

HOME = "home"
"""Settings that name files say by this field where relative paths start from."""


def read_document(path: str | os.PathLike[str], model: type[Document], *, kind: str, remedy: str) -> Document:
    """Read the document at ``path``.

    Raises `InputError` when it is no ``kind`` of the model's format, of another version, or when a field is wrong; the
    sentence names the first such field and ends with ``remedy``.
    """
    check_type(path, (str, os.PathLike), "the path of a document", "give the path of a file")
    name = os.fspath(path)
    content, expected = read_json(path), _always(model)
    if not isinstance(content, dict) or content.get("format") != expected["format"]:
        raise InputError(f"{name} is not a {kind}; expected the format '{expected['format']}'")
    version = content.get("version")
    if type(version) is not int or version != expected["version"]:
        raise InputError(
            f"{name} has version {printable(version)}; this ronnaplan reads version {expected['version']}, "
            "use the release that wrote it"
        )
    return validated(content, model, name, remedy)


def read_settings(
    path: str | os.PathLike[str],
    model: type[Document],
    *,
    expected: str,
    otherwise: str,
    remedy: str,
) -> Document:
    """Read the TOML file of settings at ``path``; a field ``home`` of ``model`` is the file's folder, given by no file.

    Raises `InputError` when it is not what is ``expected``: its name, ``otherwise`` ("is no room"), the first thing
    that is wrong, and ``remedy``.
    """
    content = read_whole(path, MOST_SETTINGS_BYTES, expected=f"{expected}; {remedy}")
    try:
        given = _parsed_toml(_utf8(content))
        if HOME in given:
            raise ValueError(f"{HOME}: no field of this document")
        settings = checked(given, model)
    except ValueError as error:
        raise InputError(f"{os.fspath(path)} {otherwise} ({printable(error)}); {remedy}") from error
    if HOME not in model.model_fields:
        return settings
    return settings.model_copy(update={HOME: Path(path).resolve().parent})


def _utf8(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ValueError(f"line {line} is not UTF-8; save it as UTF-8") from error


def _parsed_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text; raises ValueError for what is none, and for nesting beyond reason."""
    import tomllib

    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") > MOST_DOTS:
            raise ValueError(f"line {number} holds more than {MOST_DOTS} dots")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError(TOO_DEEP) from error


def validated(content: Any, model: type[Document], name: str, remedy: str) -> Document:
    """Return JSON's ``content`` as ``model``; raises `InputError` naming ``name`` and the first field that is wrong."""
    try:
        return checked(content, model)
    except ValueError as error:
        raise InputError(f"{name}: {error}; {remedy}") from error


def made(model: type[Document], content: dict[str, Any]) -> Document:
    """Return ``content``, put together by the program, as ``model``; raises `InputError` for what no document holds.

    What is the same in all of the kind (format, version, unit, this software) is added.
    """
    try:
        return model.model_validate(_always(model) | content)
    except ValidationError as error:
        raise InputError(f"the result cannot be written: {first_fault(error)}; change it first") from error


def _always(model: type[BaseModel]) -> dict[str, Any]:
    """Return the fields that are the same in every document of this release."""
    kinds = {name: field.annotation for name, field in model.model_fields.items()}
    choices = {name: get_args(kind) for name, kind in kinds.items() if get_origin(kind) is Literal}
    fixed: dict[str, Any] = {name: choice[0] for name, choice in choices.items() if len(choice) == 1}
    return fixed | ({"software": SOFTWARE} if "software" in kinds else {})


def to_json(document: BaseModel) -> str:
    """Return a document as indented JSON with a final newline; raises `InputError` if it could not be read back."""
    text = document.model_dump_json(indent=2) + "\n"
    try:
        type(document).model_validate_json(text, strict=True)
    except ValidationError as error:
        raise InputError(f"the document cannot be written: {first_fault(error)}; change it first") from error
    return text


def plain_json(value: Any, *, indent: int | None = 2) -> str:
    """Return plain data as JSON with a final newline; a number that is not finite is null, as JSON has none.

    Without ``indent`` there is no blank in it that tells nothing.

    >>> plain_json({"depth_mm": float("nan"), "hu": (1.0, float("inf"))}).split()
    ['{', '"depth_mm":', 'null,', '"hu":', '[', '1.0,', 'null', ']', '}']
    """
    separators = (",", ":") if indent is None else None
    return json.dumps(_finite(value), indent=indent, separators=separators, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(child) for child in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
