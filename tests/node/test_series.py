"""A series is complete when it should be, opened again by late slices, worked on once each time, and goes in time."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.node.audit import Audit
from ronnaplan.node.config import Rule
from ronnaplan.node.facts import Facts
from ronnaplan.node.index import Index, SeriesRow
from ronnaplan.node.logs import Log
from ronnaplan.node.retention import remove_old
from ronnaplan.node.series import SeriesWatch, rule_for
from ronnaplan.node.store import Store
from ronnaplan.node.tables import status_page
from tests.node.audit_schema import conforming
from tests.node.peers import configuration

RULE = {"name": "all", "diameters": [11.5]}


def facts(number: int, **changes: Any) -> Facts:
    given = {
        **{
            "sop_uid": f"1.2.{number}",
            "sop_class": "1.2.840.10008.5.1.4.1.1.2",
            "study_uid": "1.3",
            "series_uid": "1.4",
            "syntax": "1.2",
        },
        **{"modality": "CT", "description": "Head 1 mm", "station": "CT-OR", "protocol": "Head", "size": 10},
        **{"patient_name": "", "expected": None, "sha256": f"{number:064}"},
    }
    return Facts(**{**given, **changes})


def watch(index: Index, tmp_path: Path, **given: Any) -> SeriesWatch:
    return SeriesWatch(configuration(tmp_path, rule=[RULE], quiet_s=10.0, **given), index, Log(io.StringIO()))


def add(index: Index, number: int, now: float, **changes: Any) -> None:
    with index.transaction():
        index.add(facts(number, **changes), f"instances/1.3/1.4/1.2.{number}.dcm", "CT1", "RONNAPLAN", now)


def jobs(index: Index) -> list[tuple[Any, ...]]:
    return index.rows("SELECT revision, state FROM jobs ORDER BY id")


def test_a_quiet_time_completes_a_series_once_and_late_slices_open_it_again(index: Index, tmp_path: Path) -> None:
    watched = watch(index, tmp_path)
    for number in range(3):
        add(index, number, 100.0 + 8 * number)
        watched.tick(105.0 + 8 * number)
        assert jobs(index) == []
    watched.tick(126.1)
    watched.tick(140.0)
    assert jobs(index) == [(3, "waiting")]
    add(index, 3, 150.0)
    watched.tick(159.0)
    assert jobs(index) == [(3, "waiting")]
    watched.tick(160.1)
    assert jobs(index) == [(3, "waiting"), (4, "waiting")]


def test_a_series_waits_for_instances_that_there_was_no_room_for(index: Index, tmp_path: Path) -> None:
    watched = watch(index, tmp_path, missing_s=60.0)
    add(index, 0, 100.0)
    index.note_lacking(facts(1), 101.0)
    index.note_lacking(facts(0), 101.0)  # is here
    index.note_lacking(facts(2, series_uid="1.5"), 101.0)
    watched.tick(159.0)
    assert (jobs(index), index.lacking(1)) == ([], 1)
    watched.tick(160.1)
    assert jobs(index) == [(1, "waiting")]
    add(index, 1, 170.0)
    assert index.lacking(1) == 0
    watched.tick(180.1)
    assert jobs(index) == [(1, "waiting"), (2, "waiting")]


def test_a_time_in_which_nobody_could_send_is_no_quiet_one(index: Index, tmp_path: Path) -> None:
    watched = watch(index, tmp_path)
    add(index, 0, 100.0)
    watched.tick(120.0, listening_since=115.0)
    assert jobs(index) == []
    watched.tick(125.1, listening_since=115.0)
    assert jobs(index) == [(1, "waiting")]


def test_a_series_whose_number_of_instances_is_known_waits_for_no_quiet_time(index: Index, tmp_path: Path) -> None:
    watched = watch(index, tmp_path)
    add(index, 0, 100.0, expected=2)
    watched.tick(100.1)
    assert jobs(index) == []
    add(index, 1, 100.2, expected=2)
    watched.tick(100.3)
    assert jobs(index) == [(2, "waiting")]


def test_a_series_of_ten_thousand_instances_is_one_job(index: Index, tmp_path: Path) -> None:
    with index.transaction():
        for number in range(10_000):
            path = f"instances/1.3/1.4/1.2.{number}.dcm"
            index.add(facts(number, expected=10_000), path, "CT1", "RONNAPLAN", 100.0)
    watch(index, tmp_path).tick(100.1)
    assert jobs(index) == [(10_000, "waiting")]
    assert status_page(index).count("<tr") == 2  # its head, and the series
    log = Log(io.StringIO())
    audit = Audit(tmp_path, "audit.log", "RONNAPLAN", log)
    remove_old(tmp_path, index, 200.0, log, audit)  # owes an answer
    index.run("UPDATE jobs SET state = 'done'")
    remove_old(tmp_path, index, 200.0, log, audit)
    assert index.rows("SELECT count(*) FROM instances") == [(0,)]


def test_a_series_that_no_rule_fits_is_complete_without_a_job(index: Index, tmp_path: Path) -> None:
    watched = watch(index, tmp_path)
    add(index, 0, 100.0, modality="SEG")
    watched.tick(120.0)
    assert jobs(index) == []
    (series,) = index.records(SeriesRow, "FROM series")
    assert series.complete == series.revision


def test_a_picture_of_the_dose_that_calls_itself_ct_is_no_job(index: Index, tmp_path: Path) -> None:
    """A refused job of each study would hide those that a person has to see."""
    watched = watch(index, tmp_path)
    add(index, 0, 100.0, sop_class="1.2.840.10008.5.1.4.1.1.7")
    watched.tick(120.0)
    watch(index, tmp_path).tick(140.0)
    assert jobs(index) == []
    assert index.rows("SELECT complete = revision FROM series") == [(1,)]


def test_a_series_that_no_rule_fitted_is_worked_on_once_one_does(index: Index, tmp_path: Path) -> None:
    before, log = configuration(tmp_path, rule=[{**RULE, "station": "CT-1"}]), Log(io.StringIO())
    watched = SeriesWatch(before, index, log)
    add(index, 0, 100.0)
    watched.tick(120.0)
    SeriesWatch(before, index, log).tick(130.0)
    assert jobs(index) == []
    watch(index, tmp_path).tick(140.0)  # a node that was started again, with another rule
    watch(index, tmp_path).tick(150.0)
    assert jobs(index) == [(1, "waiting")]
    index.run("UPDATE jobs SET state = 'outdated'")  # given out while its rule was gone
    watch(index, tmp_path).tick(160.0)
    assert jobs(index) == [(1, "waiting")]
    for state in ("done", "refused", "failed"):
        index.run("UPDATE jobs SET state = ?", state)
        watch(index, tmp_path).tick(170.0)
        assert jobs(index) == [(1, state)]


def test_a_job_goes_on_under_the_rule_that_fits_where_its_own_has_another_name(
    index: Index, tmp_path: Path
) -> None:
    """One that is done, too: documents that come later are looked for by it."""
    watch(index, tmp_path)
    add(index, 0, 100.0)
    watch(index, tmp_path).tick(120.0)
    index.run("UPDATE jobs SET state = 'done'")
    for rules, expected in (
        ([{**RULE, "name": "now"}], "now"),
        ([{**RULE, "name": "other"}, {**RULE, "name": "now"}], "now"),
        ([{**RULE, "name": "none", "station": "CT-1"}], "now"),
    ):
        SeriesWatch(configuration(tmp_path, rule=rules), index, Log(io.StringIO()))
        assert index.rows("SELECT rule, state FROM jobs") == [(expected, "done")]


@pytest.mark.parametrize(
    ("pattern", "fits"),
    [
        *[({}, True), ({"station": "ct-*"}, True), ({"description": "*Head*", "protocol": "H?ad"}, True)],
        *[({"called": "OTHER"}, False), ({"calling": "CT2"}, False), ({"modality": "MR"}, False)],
    ],
)
def test_rules_fit_by_patterns_in_any_case(index: Index, pattern: dict[str, str], fits: bool) -> None:
    add(index, 0, 100.0)
    (series,) = index.records(SeriesRow, "FROM series")
    assert (rule_for(series, (Rule(name="x", **pattern),)) is not None) is fits  # type: ignore[arg-type]


def test_a_clock_that_jumps_ahead_holds_removal_back_for_a_day_and_is_told(index: Index, tmp_path: Path) -> None:
    day, said = 86_400.0, io.StringIO()
    log = Log(said)
    store = Store(tmp_path, log, Audit(tmp_path, "audit.log", "RONNAPLAN", log), keep_days=30.0)
    add(index, 0, 0.0)
    index.run("UPDATE series SET complete = revision")

    def kept(now: float) -> int:
        store._remove_old(index, now)
        return int(index.value("SELECT count(*) FROM series"))

    assert kept(1000.0) == 1
    assert [kept(40 * day + hour * 3600.0) for hour in range(24)] == [1] * 24
    assert said.getvalue().count("the clock went on by 40.0 days since it was last looked at") == 1
    assert kept(2000.0) == 1  # set back
    assert [kept(days * day) for days in range(1, 31)] == [1] * 30
    assert said.getvalue().count("held back") == 1
    assert kept(30.01 * day) == 0


def test_a_node_that_is_started_once_a_week_removes_what_was_old_when_it_ran_last(
    index: Index, tmp_path: Path
) -> None:
    day, log = 86_400.0, Log(io.StringIO())
    add(index, 0, 0.0)
    index.run("UPDATE series SET complete = revision")
    kept = {}
    for started in range(0, 50, 7):
        store = Store(tmp_path, log, Audit(tmp_path, "audit.log", "RONNAPLAN", log), keep_days=30.0)
        for hour in range(8):
            store._remove_old(index, started * day + hour * 3600.0)
        kept[started] = index.value("SELECT count(*) FROM series")
    assert kept == {0: 1, 7: 1, 14: 1, 21: 1, 28: 1, 35: 1, 42: 0, 49: 0}


def test_what_was_kept_long_enough_goes_but_nothing_that_owes_an_answer(index: Index, tmp_path: Path) -> None:
    files = []
    for number, state in enumerate(("waiting", "done", "done", "done")):
        uid = f"1.4.{number}"
        path = tmp_path / "instances" / "1.3" / uid / f"1.2.{number}.dcm"
        path.parent.mkdir(parents=True)
        path.write_bytes(b"x")
        files.append(path)
        when = 100.0 if number < 3 else 300.0
        with index.transaction():
            index.add(facts(number, series_uid=uid), path.relative_to(tmp_path).as_posix(), "A", "B", when)
            index.run("UPDATE series SET complete = revision")
            index.run(
                "INSERT INTO jobs (series, revision, rule, state, due, completed) VALUES (?, 1, 'r', ?, 0, 0)",
                number + 1,
                state,
            )
    index.run("INSERT INTO answers VALUES ('1.9', 2, 'sr', '1.2', 'answers/1.9.dcm', 0)")
    index.run("INSERT INTO deliveries (answer, receiver, state, due) VALUES ('1.9', 'pacs', 'waiting', 0)")
    log = Log(io.StringIO())
    audit = Audit(tmp_path, "audit.log", "RONNAPLAN", log)
    remove_old(tmp_path, index, 200.0, log, audit)
    assert [path.exists() for path in files] == [True, True, False, True]
    index.run("UPDATE deliveries SET state = 'sent'")
    remove_old(tmp_path, index, 200.0, log, audit)
    assert [path.exists() for path in files] == [True, False, False, True]
    assert not files[1].parent.exists()
    assert index.rows("SELECT count(*) FROM answers") == [(0,)]
    removed = [conforming(line) for line in (tmp_path / "audit.log").read_text().splitlines()]
    assert [(one.action, one.details["series"], one.count) for one in removed] == [
        ("D", "1.4.2", 1),
        ("D", "1.4.1", 1),
    ]
