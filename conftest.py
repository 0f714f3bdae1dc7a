"""Of the program's own modules those are collected that show an example: to load each for it takes long."""

from pathlib import Path

PROGRAM = Path(__file__).parent / "ronnaplan"


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Pass over a module without examples."""
    if collection_path.suffix != ".py" or not collection_path.is_relative_to(PROGRAM):
        return None
    return ">>>" not in collection_path.read_text(encoding="utf-8") or None
