"""PLUS sequences, as MetaImage and as NRRD: poses are read, and what is none is flagged."""

from pathlib import Path

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.tracking import read_recording
from ronnaplan.tracking.csv_file import write_csv
from tests.tracking.files import as_nrrd, plus, sequence, turned, written


def test_metaimage_sequence_keeps_invalid_transforms_flagged(tmp_path: Path) -> None:
    good, mirrored = "1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1", "-1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1"
    nan = good.replace("5", "nan")
    text = sequence([(good, "OK"), (good, "INVALID"), (mirrored, "OK"), (nan, "OK"), ("1 2", "OK")])
    path = tmp_path / "s.mha"
    path.write_bytes(text.encode() + b"\xff\x00")
    recording = read_recording(path)
    assert [tool.usable for tool in recording.tools] == [True, False, False, False, False]
    assert recording.tools[1].status == "invalid"
    assert "left-handed" in recording.tools[2].status
    np.testing.assert_array_equal(recording.poses("StylusToTracker")[0][:3, 3], [5, 6, 7])
    assert recording.tools[4].time_s == pytest.approx(0.2)


@pytest.mark.parametrize("suffix", [".mha", ".nrrd"])
def test_matrices_that_are_nearly_rotations_are_read_as_the_nearest(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(3)
    true = [turned(k) for k in range(20)]
    rough = [matrix.copy() for matrix in true]
    for matrix in rough:
        matrix[:3, :3] += rng.uniform(-5e-4, 5e-4, (3, 3))
    scaled = true[0].copy()
    scaled[:3, :3] *= 1.002
    text = sequence([(plus(matrix), "OK") for matrix in (*rough, scaled)])
    if suffix == ".nrrd":
        text = as_nrrd(text)
    recording = read_recording(written(tmp_path, f"s{suffix}", text))
    poses = recording.poses("StylusToTracker")
    assert len(poses) == 20
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].swapaxes(1, 2), np.tile(np.eye(3), (20, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(poses, true, atol=1e-3)
    assert "not rigid" in recording.tools[-1].status
    assert recording.notes[0].startswith("2")
    assert "the nearest rotation was taken" in recording.notes[0]


def test_an_nrrd_sequence_is_read_as_its_metaimage_twin(tmp_path: Path) -> None:
    text = sequence([(plus(turned(1)), "OK"), (plus(turned(2)), "INVALID")])
    first = read_recording(written(tmp_path, "s.mha", text))
    second = read_recording(written(tmp_path, "s.seq.nrrd", as_nrrd(text)))
    assert [vars(tool).keys() for tool in first.tools] == [vars(tool).keys() for tool in second.tools]
    for one, other in zip(first.tools, second.tools, strict=True):
        np.testing.assert_equal(vars(one), vars(other))
    assert [tool.status for tool in second.tools] == ["ok", "invalid"]


@pytest.mark.parametrize("status", ["", " "])
def test_an_empty_status_calls_no_reading_good_nor_becomes_a_good_one(tmp_path: Path, status: str) -> None:
    text = sequence([(plus(turned(1)), "OK"), (plus(turned(2)), status)])
    first = read_recording(written(tmp_path, "s.mha", text))
    second = read_recording(written(tmp_path, "s.csv", write_csv(first)))
    for recording in (first, second):
        assert [(tool.usable, tool.status) for tool in recording.tools] == [(True, "ok"), (False, "no status")]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (f"Seq_Frame{'9' * 5000}_AToBTransform = 1", "expected Seq_Frame, a number"),
        ("Seq_Frame0000 AToBTransform = 1", "expected Seq_Frame, a number"),
        ("Seq_Frame0000_StylusToTrackerTransform = 1", "twice"),
        ("DistanceUnits = cm", "states lengths in cm"),
    ],
)
def test_frame_fields_that_cannot_be_understood_are_refused(tmp_path: Path, line: str, says: str) -> None:
    text = sequence([(plus(turned(1)), "OK")]).replace("ElementDataFile", f"{line}\nElementDataFile")
    with pytest.raises(InputError, match=says):
        read_recording(written(tmp_path, "s.mha", text))


def test_a_tool_of_any_name_is_read(tmp_path: Path) -> None:
    text = sequence([(plus(turned(1)), "OK")]).replace("StylusToTracker", "Stylus-1.aToTracker")
    assert read_recording(written(tmp_path, "s.mha", text)).tool_names == ("Stylus-1.aToTracker",)


def test_a_pose_further_away_than_any_tracker_sees_is_flagged(tmp_path: Path) -> None:
    far = turned(1)
    far[0, 3] = 1e7
    (tool,) = read_recording(written(tmp_path, "s.mha", sequence([(plus(far), "OK")]))).tools
    assert "further away" in tool.status
