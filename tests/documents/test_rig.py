"""What rig.json tells of the cameras."""

import json
from copy import deepcopy
from pathlib import Path

import pytest

from ronnaplan.documents.rig import read_rig
from ronnaplan.errors import InputError
from ronnaplan.robot.stereo.calibration_errors import errors_of
from ronnaplan.robot.stereo.camera import StereoRig
from tests.documents.test_strictness import documents


def test_a_rig_keeps_what_it_was_calibrated_on(tmp_path: Path) -> None:
    """Files of versions that did not tell are read as before, and their cameras taken for true."""
    written, file = deepcopy(documents()["rig"][0]), tmp_path / "rig.json"

    def read() -> StereoRig:
        file.write_text(json.dumps(written))
        return read_rig(file).rig

    boards = read().boards
    assert boards is not None
    assert boards.rig_from_board.shape == (8, 4, 4)
    assert (boards.corners, boards.square_mm, boards.error_px, boards.lens_px) == ((9, 7), 6.0, 0.02, 0.01)
    assert errors_of(read()) is not None
    del written["right"]["size"]
    with pytest.raises(InputError, match="calibrated on boards, but have no size"):
        read()
    written = deepcopy(documents()["rig"][0])
    del written["calibrated_on"]["rig_from_board"][0]
    with pytest.raises(InputError, match="8 boards, but where 7 of them were"):
        read()
    written["calibrated_on"]["rig_from_board"] += [[[2.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 300], [0, 0, 0, 1]]]
    with pytest.raises(InputError, match="rig_from_board"):
        read()
    written["calibrated_on"]["rig_from_board"][-1] = [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -300], [0, 0, 0, 1]]
    with pytest.raises(InputError, match="on a board behind them"):
        read()
    del written["calibrated_on"]
    assert read().boards is None
