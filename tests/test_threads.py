"""Threads: as many as a process may use, and none where only one would work."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import pytest

from ronnaplan.cohort.children import ONE_THREAD
from ronnaplan.threads import TOLD, cores, in_parts, in_threads


@pytest.mark.parametrize(("told", "expected"), [("3", 3), ("2,4", 2), (" 5 ", 5)])
def test_a_process_uses_as_many_cores_as_it_is_told(
    told: str, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOLD, told)
    assert cores() == expected


@pytest.mark.parametrize("told", ["", "0", "-2", "many", "²"])
def test_without_a_number_it_uses_those_that_the_system_gives_it(
    told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOLD, told)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 2, 5}, raising=False)
    assert cores() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert cores() == 1


@pytest.mark.parametrize("told", ["1", "4"])
def test_results_come_in_the_order_of_their_items(told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOLD, told)
    assert list(in_threads(lambda n: n * n, range(100))) == [n * n for n in range(100)]


@pytest.mark.parametrize("told", ["1", "2", "4"])
@pytest.mark.parametrize("count", [0, 1, 3, 100])
def test_each_part_is_done_once_and_comes_in_its_place(
    told: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOLD, told)
    parts = in_parts(lambda first, end: list(range(first, end)), count)
    assert [number for part in parts for number in part] == list(range(count))


@pytest.mark.parametrize("bad", [0, 99])
def test_an_error_in_any_part_is_raised(bad: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOLD, "2")

    def work(first: int, end: int) -> None:
        threading.Event().wait(0.01)
        if first <= bad < end:
            raise ValueError("of this part")

    with pytest.raises(ValueError, match="of this part"):
        in_parts(work, 100)


def test_one_core_begins_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOLD, "1")
    assert set(in_threads(lambda _: threading.get_ident(), range(3))) == {threading.get_ident()}
    monkeypatch.setenv(TOLD, "4")
    assert set(in_threads(lambda _: threading.get_ident(), range(3), most=1)) == {threading.get_ident()}
    assert threading.get_ident() not in set(in_threads(lambda _: threading.get_ident(), range(3)))
    monkeypatch.setenv(TOLD, "1")
    assert set(in_parts(lambda *_: threading.get_ident(), 8)) == {threading.get_ident()}


def test_an_error_drops_what_has_not_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOLD, "2")
    begun = []

    def work(number: int) -> None:
        begun.append(number)
        if number == 0:
            raise ValueError("first")
        threading.Event().wait(0.01)

    with pytest.raises(ValueError, match="first"):
        list(in_threads(work, range(1000)))
    assert len(begun) < 1000


def test_the_processes_of_a_cohort_have_a_core_each(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in ONE_THREAD.items():
        monkeypatch.setenv(name, value)
    assert cores() == 1


def test_linear_algebra_that_is_loaded_later_keeps_to_one_thread_too() -> None:
    code = "from threadpoolctl import threadpool_info\nfrom ronnaplan.threads import single_threaded_algebra\n"
    code += "with single_threaded_algebra():\n    pass\nimport scipy.linalg\nwith single_threaded_algebra():\n"
    code += "    print(max(one['num_threads'] for one in threadpool_info() if one['user_api'] == 'blas'))"
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "2"}
    told = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, check=True, text=True
    )
    assert told.stdout.strip() == "1"
