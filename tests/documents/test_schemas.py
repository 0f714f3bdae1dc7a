"""The published schema of a file says what a written file is."""

from __future__ import annotations

import json
from typing import Any

import pytest

from ronnaplan.cli import main
from ronnaplan.documents.schemas import DOCUMENTS, schema
from ronnaplan.errors import UsageError


def fits(value: Any, kind: dict[str, Any], defs: dict[str, Any]) -> bool:
    """Whether a value has the type that a schema states, by the few words of JSON Schema that occur here."""
    if "$ref" in kind:
        kind = defs[kind["$ref"].rsplit("/", 1)[1]]
    if "anyOf" in kind:
        return any(fits(value, one, defs) for one in kind["anyOf"])
    if "const" in kind:
        return bool(value == kind["const"])
    if kind.get("type") == "object":
        properties = kind.get("properties", {})
        needed = set(kind.get("required", ())) <= set(value) if isinstance(value, dict) else False
        return needed and all(fits(value[name], properties.get(name, {}), defs) for name in value)
    if kind.get("type") == "array":
        items = [*kind.get("prefixItems", ()), *[kind.get("items", {})] * 10_000]
        return isinstance(value, list) and all(
            fits(one, each, defs) for one, each in zip(value, items, strict=False)
        )
    types = {"string": str, "integer": int, "number": (int, float), "boolean": bool, "null": type(None)}
    return isinstance(value, types.get(kind.get("type", ""), object))  # type: ignore[arg-type]


def test_a_written_file_fits_its_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", "template"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == schema("template")
    for name in DOCUMENTS:
        described = schema(name)
        assert described["additionalProperties"] is False
        assert described["properties"]["version"]["const"] == 1


def test_an_unknown_name_is_told_the_known_ones() -> None:
    with pytest.raises(UsageError, match="fiducials, registration, plan"):
        schema("nothing")
