"""What is kept is safe before the node says so, whatever the disk does; and once, whatever comes again."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydicom import dcmread

from ronnaplan import portable
from ronnaplan.node import spool as spool_module
from ronnaplan.node import store as store_module
from ronnaplan.node.index import Index
from ronnaplan.node.spool import Spool
from tests.ct import makers
from tests.node.peers import Listening, instance, listening, needs, save, send, until

pytestmark = needs("storescu", "echoscu")


def test_an_acknowledged_instance_is_synced_named_and_in_the_index(
    node: Listening, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    def noted(name: str, what: Any) -> Any:
        def call(*arguments: Any) -> Any:
            result = what(*arguments)
            done.append(name)
            return result

        return call

    monkeypatch.setattr(Spool, "sync", noted("content synced", Spool.sync))
    monkeypatch.setattr(store_module, "replace", noted("named", portable.replace))
    monkeypatch.setattr(store_module, "sync_folder", noted("name synced", portable.sync_folder))
    monkeypatch.setattr(Index, "add", noted("in the index", Index.add))
    send(node.port, instance(tmp_path))
    assert list(dict.fromkeys(done)) == ["content synced", "named", "name synced", "in the index"]


def test_the_same_instance_twice_is_kept_once_in_whatever_meta_part(node: Listening, tmp_path: Path) -> None:
    path = instance(tmp_path)
    assert (send(node.port, path) + send(node.port, path)).count("(Success)") == 2
    assert node.rows("SELECT instances, revision FROM series") == [(1, 1)]


def test_instances_that_are_sent_again_are_told_in_one_line(node: Listening, tmp_path: Path) -> None:
    paths = [instance(tmp_path, k) for k in range(3)]
    send(node.port, *paths)
    send(node.port, *paths, instance(tmp_path, 3))
    until(lambda: len(node.events("received")) == 2 and node.events("known already"))
    (told,) = node.events("known already")
    assert (told["study"], told["instances"]) == (makers.STUDY, 3)
    assert sorted(one["instances"] for one in node.events("received")) == [3, 4]


def test_an_instance_whose_file_was_removed_is_kept_anew_when_it_comes_again(
    node: Listening, tmp_path: Path
) -> None:
    path = instance(tmp_path)
    send(node.port, path)
    (kept,) = (node.folder / "instances").rglob("*.dcm")
    content = kept.read_bytes()
    kept.unlink()
    assert "(Success)" in send(node.port, path)
    assert kept.read_bytes() == content
    assert node.rows("SELECT instances, revision FROM series") == [(1, 1)]
    assert len(node.events("kept anew")) == 1
    assert len(node.files()) == 1


def test_other_content_under_a_known_uid_is_kept_aside_and_told(node: Listening, tmp_path: Path) -> None:
    send(node.port, instance(tmp_path))
    first = node.files()[0].read_bytes()
    said = send(node.port, instance(tmp_path, SeriesDescription="another"))
    assert "0x111" in said
    assert node.files()[0].read_bytes() == first
    (aside,) = node.files("aside")
    assert dcmread(aside).SeriesDescription == "another"
    (told,) = node.events("kept aside")
    assert told["sop_instance"] == str(makers.dataset(0).SOPInstanceUID)
    assert node.rows("SELECT revision FROM series") == [(1,)]


def test_with_too_little_room_on_the_disk_the_sender_keeps_its_instance(tmp_path: Path) -> None:
    with listening(tmp_path, limits={"least_free_mib": 100_000_000}) as node:
        said = send(node.port, instance(tmp_path))
        assert "OutOfResources" in said
        assert node.files() == []
        assert not list((node.folder / "incoming").iterdir())
        assert node.events("refused")[0]["status"] == "A700"
        until(lambda: node.rows("SELECT sop_uid FROM lacking") == [(str(makers.dataset(0).SOPInstanceUID),)])


FULL = OSError(errno.ENOSPC, "No space left on device")


def full(*_: Any, **__: Any) -> None:
    raise FULL


def full_after_300_kb(handle: int, content: memoryview) -> int:
    if os.fstat(handle).st_size > 300_000:
        raise FULL
    return os.write(handle, content)


@pytest.mark.parametrize(
    ("where", "step", "fails"),
    [
        (tempfile, "mkstemp", full),
        (shutil, "disk_usage", full),
        (spool_module, "write", full),
        (spool_module, "write", full_after_300_kb),
        (Spool, "sync", full),
        (store_module, "replace", full),
        (store_module, "sync_folder", full),
        (Index, "add", full),
    ],
)
def test_a_disk_that_fills_at_any_step_is_told_and_the_node_lives_on(
    where: Any, step: str, fails: Any, node: Listening, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    large = makers.dataset(0, stored=np.zeros((512, 512), np.int16))
    path = save(large, tmp_path / "0.dcm")
    with monkeypatch.context() as patch:
        patch.setattr(where, step, fails)
        assert "OutOfResources" in send(node.port, path)
    (told,) = node.events("refused")
    assert told["status"] == "A700"
    assert "No space left on device" in told["reason"]
    assert node.rows("SELECT count(*) FROM instances") == [(0,)]
    assert node.files() == []
    assert not list((node.folder / "incoming").iterdir())
    could_begin = fails is not full or (where, step) not in ((tempfile, "mkstemp"), (spool_module, "write"))
    until(lambda: node.rows("SELECT sop_uid FROM lacking") == [(large.SOPInstanceUID,)] * could_begin)
    assert "Success" in send(node.port, path)
    assert len(node.files()) == 1
    assert node.rows("SELECT sop_uid FROM lacking") == []


def test_a_disk_that_lets_nothing_be_removed_is_told_and_the_node_lives_on(
    node: Listening, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread that keeps instances ended, and all that came was refused until the node began anew."""
    path = instance(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(store_module, "replace", full)
        patch.setattr(Path, "unlink", full)
        assert "OutOfResources" in send(node.port, path)
    assert "Success" in send(node.port, path)
    assert len(node.files()) == 1


def test_what_comes_when_the_node_ends_is_left_to_its_sender(node: Listening, tmp_path: Path) -> None:
    node.receiver._store.stop()
    assert "OutOfResources" in send(node.port, instance(tmp_path))
    assert "the node ends" in node.events("refused")[0]["reason"]
    assert not list((node.folder / "incoming").iterdir())


def test_files_that_were_never_acknowledged_are_removed_when_the_node_starts(tmp_path: Path) -> None:
    with listening(tmp_path) as node:
        send(node.port, instance(tmp_path))
        kept = node.files()
    left = [kept[0].with_name("1.2.3.dcm"), node.folder / "incoming" / "tmpabc.dcm"]
    for path in left:
        path.write_bytes(b"half")
    with listening(tmp_path) as node:
        assert node.files() == kept
        assert not any(path.exists() for path in left)
