"""Processes of the node hold no more than they need: code for what they do, and the scan while it is looked at."""

from __future__ import annotations

import subprocess
import sys
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.ct.scratch import Scratch
from ronnaplan.node import work as work_module
from ronnaplan.node.config import Rule
from ronnaplan.node.work import Order, begin, finish
from ronnaplan.report import contact, marker_part, pdf
from tests.cohort.scans import CENTERS_MM, phantom

HEAVY = {
    "PIL",
    "cv2",
    "gdcm",
    "highdicom",
    "matplotlib",
    "numba",
    "numpy",
    "pylibjpeg",
    "requests",
    "scipy",
    "SimpleITK",
    "tqdm",
    "vtk",
}
LOADED = """
import sys
def tell():
    print(*sorted({name.partition(".")[0] for name in sys.modules}))
import ronnaplan.cli.node, ronnaplan.node.hub
tell()
from ronnaplan.node.lean import load_pydicom
load_pydicom()
import ronnaplan.node.association, ronnaplan.node.receiver, ronnaplan.node.sender
tell()
import requests, PIL.Image, numpy
"""


def test_no_process_loads_what_another_one_is_for() -> None:
    told = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True).stdout
    hub, receiver = (set(line.split()) for line in told.splitlines())
    assert not {*HEAVY, "pydicom", "pynetdicom"} & hub
    assert not HEAVY & receiver
    assert {"pydicom", "pynetdicom"} <= receiver


def test_what_draws_answers_loads_no_compiler() -> None:
    """It takes the place of what found the markers, and as much memory as that for its own libraries."""
    code = "import sys, ronnaplan.report.contact, ronnaplan.report.quality; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_the_voxels_are_gone_before_what_needs_none_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held: list[weakref.ref[Any]] = []
    find = work_module._find

    def found(order: Order, scratch: Scratch) -> Any:
        volume, *others = find(order, scratch)
        held.append(weakref.ref(volume))
        return volume, *others

    def without_voxels(make: Callable[..., Any]) -> Callable[..., Any]:
        def made(*given: Any) -> Any:
            assert held[0]() is None
            return make(*given)

        return made

    monkeypatch.setattr(work_module, "_find", found)
    monkeypatch.setattr(contact, "draw_sheet", without_voxels(contact.draw_sheet))
    monkeypatch.setattr(marker_part, "draw_row", without_voxels(contact.draw_row))
    monkeypatch.setattr(pdf, "print_pdf", without_voxels(lambda page, below: b"%PDF-"))
    told: list[tuple[str, Any]] = []
    scan = phantom(tmp_path / "scan")
    rule = Rule(name="r", diameters=(11.5,), expected=len(CENTERS_MM))
    order = Order(1, scan, len(list(scan.glob("*.dcm"))), tmp_path, tmp_path / "answers", rule, ())

    def tell(event: str, **facts: Any) -> None:
        told.append((event, facts.get("kind")))

    left: list[tuple[str, ...]] = []
    finish(begin(order, tell), tell, lambda begun: left.append(tuple(begun.makers)))
    assert left == [("sheet", "pdf"), ("pdf",)]  # each is made by a program of its own
    assert told == [*(("answer", kind) for kind in ("fiducials", "sr", "sheet", "pdf")), ("ended", None)]
