"""A cohort in a bucket of an object store gives what the same files give on the disk."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import pytest

from ronnaplan import localize, read_ct
from ronnaplan.cohort.cohort import run_cohort
from ronnaplan.cohort.index import Index
from ronnaplan.cohort.listing import bring_up_to_date
from ronnaplan.cohort.planning import decide, tasks_of
from ronnaplan.cohort.rules import CohortRule, Rules
from tests.cohort.scans import CENTERS_MM, phantom, tiny

pytest.importorskip("distributed")
parquet = pytest.importorskip("pyarrow.parquet")

RULES = Rules(rule=(CohortRule(name="all", diameters=(11.5,), expected=len(CENTERS_MM), sheet=False),))
ROOT = "s3://heads/lab"


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The file system of a store on this machine, with an empty bucket."""
    s3fs = pytest.importorskip("s3fs")  # here: to import both takes half a second, and no other test needs them
    server = pytest.importorskip("moto.server")
    here = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    here.start()
    host, port = here.get_host_and_port()
    for name, value in {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "nobody",
        "AWS_SECRET_ACCESS_KEY": "nothing",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    files = s3fs.S3FileSystem()
    files.mkdir("heads")
    yield files
    s3fs.S3FileSystem.clear_instance_cache()
    urlopen(Request(f"http://{host}:{port}/moto-api/reset", method="POST")).close()
    here.stop()


def test_a_cohort_in_a_bucket_is_worked_off_and_only_what_changed_is_read_again(
    tmp_path: Path, bucket: Any
) -> None:
    here = phantom(tmp_path / "in" / "2026" / "scan")
    tiny(tmp_path / "in" / "2026" / "tiny", "7")
    (tmp_path / "in" / "notes.txt").write_text("no scan")
    bucket.put(f"{tmp_path / 'in'}/", "heads/lab/", recursive=True)
    counts = run_cohort([ROOT], tmp_path / "out", RULES, workers=1)
    assert (counts.listed.files, counts.worked, counts.done, counts.unusable) == (35, 2, 1, 1)
    series = parquet.read_table(tmp_path / "out" / "series.parquet").to_pylist()
    assert {one["folder"]: one["state"] for one in series} == {"2026/scan": "done", "2026/tiny": "unusable"}
    markers = parquet.read_table(tmp_path / "out" / "markers.parquet").to_pylist()
    expected = localize(read_ct(here), diameter_mm=11.5)
    assert [[one[f"{axis}_mm"] for axis in "xyz"] for one in markers] == expected.centers.tolist()
    assert [one["covariance_xz_mm2"] for one in markers] == expected.covariances[:, 0, 2].tolist()
    bucket.rm(sorted(bucket.ls("heads/lab/2026/scan"))[0])
    type(bucket).clear_instance_cache()
    with Index(tmp_path / "out") as index:
        listed = bring_up_to_date(index, [ROOT])
        assert (listed.files, listed.changed) == (34, 0)
        decide(index, RULES, tasks_of(RULES))
        assert index.rows("SELECT folder FROM series WHERE state = 'waiting'") == [("2026/scan",)]


def test_objects_below_a_folder_without_a_name_are_told(tmp_path: Path, bucket: Any) -> None:
    for name in ("", "a/1.txt", "b//2.txt"):  # the first stands for the folder
        bucket.call_s3("put_object", Bucket="heads", Key=f"lab/{name}", Body=b"no scan")
    with Index(tmp_path) as index:
        listed = bring_up_to_date(index, [ROOT])
        (told,) = listed.skipped
    assert told.startswith("heads/lab/b//: ")
    assert "two slashes" in told
