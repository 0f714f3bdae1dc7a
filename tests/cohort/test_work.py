"""A series worked on in a cohort gives what `localize` gives, and what is refused keeps what was found."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phantoms.fast import render
from phantoms.output import write_phantom
from ronnaplan import localize, read_ct
from ronnaplan.cohort.index import Index
from ronnaplan.cohort.listing import bring_up_to_date
from ronnaplan.cohort.planning import decide, orders, tasks_of
from ronnaplan.cohort.rules import CohortRule, Rules
from ronnaplan.cohort.summary import badness
from ronnaplan.cohort.work import work
from ronnaplan.ct import reader
from ronnaplan.documents.fiducials import fiducials_document
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import InputError
from tests.cohort.scans import CENTERS_MM, phantom
from tests.ct.makers import write_series
from tests.scans import small_stack, two_sizes

TEMPLATE = {
    "format": "ronnaplan.template",
    "version": 1,
    "unit": "mm",
    "name": "daily",
    "labels": list("ABCD"),
    "centers": CENTERS_MM,
}


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return phantom(tmp_path_factory.mktemp("cohort") / "in" / "scan").parent


def told(root: Path, folder: Path, rule: CohortRule, known: dict[str, str] | None = None) -> list[dict[str, Any]]:
    """Work on the only series below ``root``."""
    rules = Rules(home=folder, rule=(rule,))
    (folder / "out").mkdir(exist_ok=True)
    with Index(folder / "out") as index:
        bring_up_to_date(index, [str(root)])
        tasks = tasks_of(rules)
        decide(index, rules, tasks)
        ((_, order, _),) = orders(index, rules, tasks)
    if known is not None:
        order["known"] = known
    said = []
    work(json.loads(json.dumps(order)), lambda event, **facts: said.append({"event": event, **facts}))
    assert said[-1]["event"] == "ended"
    return said[:-1]


def test_a_series_gives_the_document_that_localize_gives_and_is_compared_with_its_phantom(
    scan: Path, tmp_path: Path
) -> None:
    (tmp_path / "phantom.json").write_text(json.dumps(TEMPLATE))
    (part,) = told(scan, tmp_path, CohortRule(name="x", diameters=(11.5,), expected=4, phantom="phantom.json"))
    assert (part["state"], part["found"]) == ("done", 4)
    found = localize(read_ct(scan), diameter_mm=11.5, expected=4)
    assert part["fiducials"] == to_json(fiducials_document(found))
    assert np.array_equal([one["center"] for one in part["markers"]], found.centers)
    assert base64.b64decode(part["sheet"]).startswith(b"\x89PNG")
    assert part["scan"]["kernel"] == "FAST"
    assert part["scan"]["acquired"] == "2026-01-01"
    assert part["scan"]["acquired_time"] == "12:00:00"
    assert part["scan"]["pixel_mm"] == pytest.approx(64 / 96)
    checked = part["checked"]
    truth = np.array(CENTERS_MM)
    near = truth[[np.argmin(np.linalg.norm(truth - one, axis=1)) for one in found.centers]]

    def distances(points: Any) -> Any:
        return np.linalg.norm(points[:, None] - points, axis=-1)[np.triu_indices(4, 1)]

    errors = distances(found.centers) - distances(near)
    assert checked["distance_mean_mm"] == pytest.approx(errors.mean(), abs=1e-9)
    assert checked["distance_rms_mm"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-6)
    (same,) = told(scan, tmp_path, CohortRule(name="x", diameters=(11.5,)), {part["key"]: part["content"]})
    assert same["state"] == "unchanged"


def test_a_phantom_s_truth_is_not_compared_with_the_scan_that_it_was_found_in(scan: Path, tmp_path: Path) -> None:
    found = localize(read_ct(scan), diameter_mm=11.5)
    (tmp_path / "phantom.json").write_text(to_json(fiducials_document(found)))
    (part,) = told(scan, tmp_path, CohortRule(name="x", diameters=(11.5,), phantom="phantom.json"))
    assert (part["state"], part["found"]) == ("refused", 4)
    assert "the truth 'phantom.json' was found in this very scan" in part["reason"]
    assert "checked" not in part


def test_another_set_of_balls_beside_the_commonest_is_told_of_and_wants_looking_at(tmp_path: Path) -> None:
    """Four balls were taken for the markers without a word of three others."""
    scene, stack = two_sizes(), small_stack()
    write_phantom(tmp_path / "in" / "scan", scene, stack, render(scene, stack, seed=1))
    (one,) = told(tmp_path / "in", tmp_path, CohortRule(name="r"))
    assert (one["state"], one["found"]) == ("done", 4)
    assert one["reason"].startswith(
        "balls of 9.00 mm are taken, the commonest; seen: 4 spheres of 9.00 mm, 3 spheres"
    )
    assert badness(one) > badness({**one, "reason": ""})
    (one,) = told(tmp_path / "in", tmp_path, CohortRule(name="r", expected=3))
    assert (one["found"], one["reason"]) == (3, "")


def test_a_wrong_number_is_refused_with_its_sheet_and_no_ct_is_unusable(scan: Path, tmp_path: Path) -> None:
    (part,) = told(scan, tmp_path, CohortRule(name="x", diameters=(11.5,), expected=5))
    assert part["state"] == "refused"
    assert "5" in part["reason"]
    assert part["found"] == 4
    assert part["sheet"]
    write_series(tmp_path / "mr", 4, lambda made, _: setattr(made, "Modality", "MR"))
    rule = CohortRule(name="x", modality="*", diameters=(11.5,), sheet=False)
    (tmp_path / "other").mkdir()
    (part,) = told(tmp_path / "mr", tmp_path / "other", rule)
    assert (part["state"], part["reason"]) == ("unusable", "the modality is MR, not CT")


def test_files_that_cannot_be_read_now_are_a_fault_of_their_disk_and_no_answer(scan: Path, tmp_path: Path) -> None:
    rules = Rules(rule=(CohortRule(name="x", diameters=(11.5,)),))
    shutil.copytree(scan, tmp_path / "in")
    shutil.make_archive(str(tmp_path / "in" / "zipped"), "zip", scan)
    with Index(tmp_path) as index:
        bring_up_to_date(index, [str(tmp_path / "in")])
        tasks = tasks_of(rules)
        decide(index, rules, tasks)
        given = [order for _, order, _ in orders(index, rules, tasks)]
    (tmp_path / "in").rename(tmp_path / "not mounted")
    said: list[dict[str, Any]] = []
    for order in given:
        work(order, lambda event, **facts: said.append({"event": event, **facts}))
    assert [(one["event"], one["state"]) for one in said] == [("ended", "gone")] * 2
    assert all(one["reason"].startswith("its files cannot be read now; ") for one in said)
    assert all("No such file" in one["reason"] for one in said)
    work({**given[0], "version": "0.0.1"}, lambda event, **facts: said.append({"event": event, **facts}))
    assert said[-1]["state"] == "gone"
    assert "the command 0.0.1" in said[-1]["reason"]


@pytest.mark.parametrize("change", ["removed", "archived", "of another", "no image"])
def test_a_series_of_which_a_part_was_changed_since_the_listing_is_no_shorter_scan(
    scan: Path, tmp_path: Path, change: str
) -> None:
    files = sorted(
        shutil.copytree(scan, tmp_path / "in" / "a", ignore=shutil.ignore_patterns("*.json")).rglob("*.dcm")
    )
    other = sorted(write_series(tmp_path / "other", 3).iterdir())
    if change == "archived":
        shutil.make_archive(str(tmp_path / "in" / "zipped"), "zip", tmp_path / "in", "a")
        shutil.rmtree(tmp_path / "in" / "a")
    if change == "no image":
        files[-1] = files[-1].rename(files[-1].with_suffix(""))
    with Index(tmp_path) as index:
        bring_up_to_date(index, [str(tmp_path / "in")])
        rules = Rules(rule=(CohortRule(name="x", diameters=(11.5,), sheet=False),))
        tasks = tasks_of(rules)
        decide(index, rules, tasks)
        ((_, order, _),) = orders(index, rules, tasks)
    if change == "archived":
        archive = tmp_path / "in" / "zipped.zip"
        with zipfile.ZipFile(archive) as whole:
            kept = {name: whole.read(name) for name in sorted(whole.namelist())[:-2]}
        with zipfile.ZipFile(archive, "w") as shorter:
            for name, content in kept.items():
                shorter.writestr(name, content)
    elif change == "removed":
        files[-1].unlink()
    elif change == "of another":
        shutil.copy(other[0], files[-1])
    else:
        files[-1].write_text("notes" * 1000)
    said: list[dict[str, Any]] = []
    work(json.loads(json.dumps(order)), lambda event, **facts: said.append({"event": event, **facts}))
    assert [(one["event"], one.get("state")) for one in said] == [("ended", "gone")]
    assert said[-1]["reason"].startswith("its files cannot be read now; ")
    if change in ("archived", "of another"):
        assert said[-1]["reason"].endswith("since they were listed; list its root again")


def test_a_copy_cut_short_beside_a_series_is_no_reason_to_read_it_later(scan: Path, tmp_path: Path) -> None:
    files = sorted(shutil.copytree(scan, tmp_path / "in").rglob("*.dcm"))
    (tmp_path / "in" / "copy.dcm").write_bytes(files[2].read_bytes()[:-500])
    (part,) = told(tmp_path / "in", tmp_path, CohortRule(name="x", diameters=(11.5,), sheet=False))
    assert part["state"] == "done"
    assert part["scan"]["scan_flags"] == ["unreadable_files"]


def test_a_series_that_takes_too_much_memory_is_a_fault_and_not_unusable(
    scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: Any, **__: Any) -> None:
        raise InputError("the volume needs more memory than there is") from MemoryError("no room")

    monkeypatch.setattr(reader, "read_series", failing)
    with pytest.raises(MemoryError, match="more memory than there is"):
        told(scan, tmp_path, CohortRule(name="x", diameters=(11.5,)))


def test_a_process_loads_what_pairs_points_for_phantoms_only() -> None:
    code = (
        "import sys; from ronnaplan.cohort import work; work._warm_up(); work._wanted({'rule': {'name': 'x'},"
        " 'template': None, 'phantom': None}); print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert not {"scipy.spatial", "ronnaplan.correspondence.large"} & set(done.stdout.split())
