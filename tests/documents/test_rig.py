"""What rig.json tells of the cameras."""

import json
from copy import deepcopy
from pathlib import Path

import pytest

from ronnaplan.documents.rig import read_rig
from ronnaplan.errors import InputError
from tests.documents.test_strictness import documents


def test_a_camera_keeps_how_far_out_boards_were_seen(tmp_path: Path) -> None:
    """Files of versions that did not tell are read as before; a part of no size is refused."""
    written = deepcopy(documents()["rig"][0])
    (tmp_path / "rig.json").write_text(json.dumps(written))
    assert read_rig(tmp_path / "rig.json").rig.left.reach == (0.9, 0.8, 0.7, 0.6)
    del written["left"]["reach"]
    (tmp_path / "rig.json").write_text(json.dumps(written))
    assert read_rig(tmp_path / "rig.json").rig.left.reach is None
    del written["right"]["size"]
    (tmp_path / "rig.json").write_text(json.dumps(written))
    with pytest.raises(InputError, match="right: a camera has a reach, but no size"):
        read_rig(tmp_path / "rig.json")
