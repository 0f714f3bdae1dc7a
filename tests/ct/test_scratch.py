import errno
import time
from pathlib import Path
from typing import Never

import numpy as np
import pytest

from ronnaplan.ct import read_ct
from ronnaplan.ct import scratch as under_test
from ronnaplan.ct.scratch import AT_ONCE, Scratch, runs
from tests.ct.makers import write_series


def test_voxels_in_a_file_are_those_in_memory_however_often_they_are_given_back(tmp_path: Path) -> None:
    folder, room = write_series(tmp_path / "ct"), tmp_path / "room"
    room.mkdir()
    in_memory = read_ct(folder)
    with Scratch(room) as scratch:
        volume = read_ct(folder, scratch=scratch)
        for _ in range(3):
            time.sleep(2 * under_test.GIVEN_BACK_S)
            assert np.array_equal(volume.voxels_hu, in_memory.voxels_hu)
    assert volume.voxel_sha256 == in_memory.voxel_sha256
    assert not list(room.iterdir())


@pytest.mark.parametrize("count", [0, 1, AT_ONCE, 2 * AT_ONCE + 3])
def test_who_goes_through_a_scan_a_few_slices_at_a_time_sees_each_once(count: int) -> None:
    seen = [
        number for first, end in runs(np.empty((count + 1, 2, 2)), 1, count + 1) for number in range(first, end)
    ]
    assert seen == list(range(1, count + 1))


def test_where_the_disk_is_full_the_voxels_take_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int, count: int) -> Never:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(under_test, "reserve", full)
    folder = write_series(tmp_path / "ct")
    with Scratch(tmp_path) as scratch:
        assert read_ct(folder, scratch=scratch).voxel_sha256 == read_ct(folder).voxel_sha256
