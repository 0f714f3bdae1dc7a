"""What the page shows beside the scan, a second image and a region, and the scene that it hands out."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pydicom
import pytest
from pydicom.uid import ExplicitVRLittleEndian

from ronnaplan.planner.second import SQUARES
from tests import cases
from tests.planner.browser import Planner, eventually, needs_browser, opened, planner, value, with_head

pytestmark = needs_browser

AXIAL_PNG = "document.querySelector('canvas[data-picture=axial]').toDataURL('image/png').split(',')[1]"
EVERY = 4
"""Of so many slices the second image has one."""


def write_negative(folder: Path) -> Path:
    """Write the scan's negative in the scan's own frame of reference."""
    folder.mkdir()
    images = [pydicom.dcmread(path) for path in cases.CT.glob("*.dcm")]
    images.sort(key=lambda one: one.ImagePositionPatient[2])
    for k in range(0, len(images), EVERY):
        images[k].file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        images[k].PixelData = (-cases.volume().voxels_hu[k]).tobytes()
        images[k].RescaleSlope, images[k].RescaleIntercept, images[k].PixelRepresentation = 1, 0, 1
        images[k].save_as(folder / f"{k}.dcm")
    return folder


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Planner]:
    """A planner with a second image and a region."""
    folder = cases.write_case(tmp_path_factory.mktemp("images"))
    tumor = cases.write_label_map(folder / "labels" / "tumor.nrrd", side=24)
    with planner(
        folder, "--second", str(write_negative(folder / "mr")), "--labels", str(tumor), surfaces=True
    ) as one:
        yield one


def bright_air(page: Any) -> list[list[bool]]:
    """Whether the air to the right and to the left of the head is bright, in four rows of a checkerboard's squares."""
    png = np.frombuffer(base64.b64decode(page.evaluate(AXIAL_PNG)), np.uint8)
    grey = cv2.imdecode(png, cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    side = min(grey.shape) // SQUARES

    def bright(row: int, column: int) -> bool:
        square = grey[row * side : (row + 1) * side, column * side : (column + 1) * side]
        return bool(np.median(square) > 100)

    return [[bright(row, column) for column in (0, 1, 6, 7)] for row in (3, 4, 5, 6)]


def test_a_second_image_is_blended_by_its_share_and_checkered_square_by_square(
    browser: Any, case: Planner
) -> None:
    page = opened(browser, case.url)
    page.wait_for_selector("#second >> text=own frame of reference")
    page.locator("#second input").fill("0")
    eventually(page, lambda: bright_air(page) == [[False] * 4] * 4)
    page.locator("#second input").fill("1")
    eventually(page, lambda: bright_air(page) == [[True] * 4] * 4)
    page.select_option("#second select", "checkerboard")
    even, odd = [True, False, True, False], [False, True, False, True]
    eventually(page, lambda: bright_air(page) == [odd, even, odd, even])
    assert page.locator("#second input").count() == 0


def test_a_region_is_hidden_shown_again_and_kept_as_it_was_last(browser: Any, case: Planner) -> None:
    page = with_head(opened(browser, case.url))
    opacity, outline = page.locator("#regions input[type=range]"), page.locator("svg[data-view=axial] .rp-region")
    page.wait_for_function("window.trame.state.get('drawn_head').points.some(one => one.label === 'tumor')")
    page.wait_for_selector("svg[data-view=axial] .rp-region", state="attached")
    solid = value(page, "picture_head")
    opacity.fill("0")
    eventually(page, lambda: outline.count() == 0)
    eventually(page, lambda: value(page, "picture_head") != solid)
    eventually(page, lambda: all(one["label"] != "tumor" for one in value(page, "drawn_head")["points"]))
    opacity.fill("0.3")
    eventually(page, lambda: outline.count() == 1)
    page.reload()
    page.wait_for_selector("#regions")
    eventually(page, lambda: opacity.input_value() == "0.3")
    assert json.loads((case.folder / "planner.json").read_text())["regions"]["tumor"]["opacity"] == 0.3


@pytest.mark.long  # what is in a scene and how files are handed out is tested for itself, and by the start page's test
def test_the_scene_is_downloaded_with_all_that_is_seen(browser: Any, case: Planner) -> None:
    page = opened(browser, case.url)
    page.click(".rp-tab >> text=Files")
    with page.expect_download() as made:
        page.click("[data-download='scene.glb']")
    assert made.value.suggested_filename == f"{case.folder.name} scene.glb"
    content = made.value.path().read_bytes()
    magic, _, size, length = struct.unpack("<4sIII", content[:16])
    assert (magic, size) == (b"glTF", len(content))
    nodes = {node["name"] for node in json.loads(content[20 : 20 + length])["nodes"]}
    assert {"skin", "skull", "marker F1", "path left", "region tumor"} <= nodes
    page.wait_for_selector(f"#making >> text={case.folder.name} scene.glb was downloaded")
