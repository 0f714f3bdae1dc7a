"""Images of two cameras are paired by the number in their names, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ronnaplan.errors import InputError
from ronnaplan.robot.stereo.images import read_pairs


def test_images_are_paired_by_their_number(tmp_path: Path) -> None:
    def image(side: str, name: str, values: np.ndarray) -> None:
        (tmp_path / side).mkdir(exist_ok=True)
        Image.fromarray(values).save(tmp_path / side / name)

    grey = np.full((40, 50), 7, np.uint8)
    image("left", "002.png", grey)
    image("left", "010.png", grey + 1)
    image("right", "2.png", grey + 2)
    with pytest.raises(InputError, match="frame 10 with one camera only"):
        read_pairs(tmp_path)
    image("right", "10.png", grey + 3)
    pairs = read_pairs(tmp_path)
    assert {number: (left[0, 0], right[0, 0]) for number, (left, right) in pairs.items()} == {
        2: (7, 9),
        10: (8, 10),
    }
    image("left", "11.png", grey)
    image("right", "11.png", grey + 2)
    with pytest.raises(InputError, match=r"the same images as frames 2 and 11"):  # copied boards counted as others
        read_pairs(tmp_path)
    for side in ("left", "right"):
        (tmp_path / side / "11.png").unlink()
    image("left", "last.png", grey)
    with pytest.raises(InputError, match="not named by the number"):
        read_pairs(tmp_path)
    (tmp_path / "left" / "last.png").unlink()
    image("right", "10.png", np.zeros((40, 50, 3), np.uint8))
    with pytest.raises(InputError, match="one grey value"):
        read_pairs(tmp_path)
    with pytest.raises(InputError, match="no folder"):
        read_pairs(tmp_path / "nowhere")


@pytest.mark.parametrize("content", [b"", b"P5\n100000 100000\n255\n", b"P5\n50 40\n255\n", b"no image"])
def test_what_is_no_image_or_damaged_is_named(tmp_path: Path, content: bytes) -> None:
    """One that says of itself that it is as large as a house ended in a traceback of OpenCV."""
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        (tmp_path / side / "1.pgm").write_bytes(content)
    with pytest.raises(InputError, match=r"1\.pgm is no image, or damaged; expected grey values as \.png"):
        read_pairs(tmp_path)
