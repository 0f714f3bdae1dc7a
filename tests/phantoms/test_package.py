from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import pytest

import phantoms
from phantoms.beam import tube_beam
from phantoms.errors import PhantomError
from phantoms.scene_file import read_scene

PACKAGE = Path(phantoms.__file__).parent
DOCUMENT = PACKAGE.parent / "docs" / "phantoms.md"


@pytest.mark.parametrize("path", sorted(PACKAGE.glob("*.py")), ids=lambda path: path.stem)
def test_nothing_of_ronnaplan_is_imported(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        assert not [name for name in names if name.split(".")[0] == "ronnaplan"]


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "spekpy", None)
    with pytest.raises(PhantomError, match="needs spekpy, which is not installed; install the extra 'phantoms'"):
        tube_beam(101.0)


def test_the_documented_scene_can_be_read(tmp_path: Path) -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "scene.toml").write_text(block, encoding="utf-8")
    examination = read_scene(tmp_path / "scene.toml")
    assert [one.label for one in examination.scene.markers] == ["C1", "X1", "X2", "X3", "X4", "M1", "M2"]
    assert [one.kind for one in examination.scene.decoys][-1] == "capsule"
    held = [examination.stack.holds_whole(one.center_mm, one.diameter_mm) for one in examination.scene.markers]
    assert all(held)
