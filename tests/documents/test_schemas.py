"""The published schema of a file says what a written file is."""

from __future__ import annotations

import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.cli import main
from ronnaplan.cli.schema import HELP
from ronnaplan.documents.schemas import DOCUMENTS, schema
from ronnaplan.errors import UsageError
from tests.documents.test_strictness import KINDS, documents


def fits(value: Any, kind: dict[str, Any], defs: dict[str, Any]) -> bool:
    """Whether a value has the type that a schema states, by the few words of JSON Schema that occur here."""
    if "$ref" in kind:
        kind = defs[kind["$ref"].rsplit("/", 1)[1]]
    if "anyOf" in kind:
        return any(fits(value, one, defs) for one in kind["anyOf"])
    if "const" in kind:
        return bool(value == kind["const"])
    if kind.get("type") == "object":
        properties, names = kind.get("properties", {}), set(value) if isinstance(value, dict) else set()
        is_whole = isinstance(value, dict) and set(kind.get("required", ())) <= names
        is_closed = names <= set(properties) or kind.get("additionalProperties", True) is not False
        return is_whole and is_closed and all(fits(value[name], properties.get(name, {}), defs) for name in names)
    if kind.get("type") == "array":
        items = [*kind.get("prefixItems", ()), *[kind.get("items", {})] * 10_000]
        return isinstance(value, list) and all(
            fits(one, each, defs) for one, each in zip(value, items, strict=False)
        )
    types = {"string": str, "integer": int, "number": (int, float), "boolean": bool, "null": type(None)}
    return isinstance(value, types.get(kind.get("type", ""), object))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", [*KINDS, "placement"])
def test_a_written_file_fits_its_schema(name: str) -> None:
    described, (written, _) = schema(name.split()[-1].replace("-", "_")), documents()[name]
    defs = described.get("$defs", {})
    assert fits(written, described, defs)
    for field in described["required"]:
        assert not fits({**written, field: {"nothing": "of the kind"}}, described, defs), field


def test_no_written_file_is_left_out_here() -> None:
    assert set(documents()) == {*KINDS, "placement"}


def test_every_schema_is_printed_and_closed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", "template"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == schema("template")
    for name in DOCUMENTS:
        described = schema(name)
        assert described["additionalProperties"] is False
        assert described["properties"]["version"]["const"] == 1


def test_the_package_holds_every_schema_as_a_file(tmp_path: Path) -> None:
    folder = resources.files("ronnaplan.documents") / "schema"
    assert {one.name for one in folder.iterdir()} == {f"{name}.schema.json" for name in DOCUMENTS}
    for name in DOCUMENTS:
        now, shipped = tmp_path / name, folder / f"{name}.schema.json"
        assert main(["schema", name, "-o", str(now)]) == 0
        assert shipped.read_bytes() == now.read_bytes(), f"write it anew: ronnaplan schema {name} -o {shipped}"


def test_the_help_names_every_file() -> None:
    assert all(re.search(rf"\b{name}\b", HELP) for name in DOCUMENTS)


def test_an_unknown_name_is_told_the_known_ones() -> None:
    with pytest.raises(UsageError, match="fiducials, registration, plan"):
        schema("nothing")
