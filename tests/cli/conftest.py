from __future__ import annotations

from pathlib import Path

import pytest

from phantoms.fast import render
from phantoms.output import write_phantom
from tests.scans import balls, small_stack


@pytest.fixture(scope="module")
def ct_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small scan with one ball."""
    folder = tmp_path_factory.mktemp("scan") / "ct"
    scene, stack = balls([(5.0, -4.0, 2.0)]), small_stack(spacing_mm=2.0, matrix=64)
    write_phantom(folder, scene, stack, render(scene, stack, seed=1))
    return folder
