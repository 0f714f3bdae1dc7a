"""Reading a document of this project: its format, its version, and then every field against its model."""

from __future__ import annotations

import os
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from ronnaplan.documents.files import read_json
from ronnaplan.errors import InputError

Document = TypeVar("Document", bound=BaseModel)

VERSION = 1
"""The version of every document that this release writes and reads."""


def read_document(
    path: str | os.PathLike[str], model: type[Document], *, format_name: str, kind: str, remedy: str
) -> Document:
    """Read the document at ``path``.

    Raises `InputError` when it is no ``kind`` of ``format_name``, of another version, or when a field is wrong; the
    sentence names the first such field and ends with ``remedy``.
    """
    name = os.fspath(path)
    content = read_json(path)
    if not isinstance(content, dict) or content.get("format") != format_name:
        raise InputError(f"{name} is not a {kind}; expected the format '{format_name}'")
    if content.get("version") != VERSION:
        raise InputError(
            f"{name} has version {content.get('version')}; this ronnaplan reads version {VERSION}, "
            "use the release that wrote it"
        )
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{name}: {first_fault(error)}; {remedy}") from error


def first_fault(error: ValidationError) -> str:
    """Name the first field that is wrong, and why."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"]) or "the document"
    return f"{where}: {first['msg']}"
