"""Work in another process: its answer, its refusals, how far it is, and its end."""

from __future__ import annotations

import io
import os
import signal
import threading
import time
from functools import partial
from typing import Any

import numpy as np
import pytest

from ronnaplan.case.surroundings import Surroundings
from ronnaplan.errors import InputError, RonnaplanError, UsageError
from ronnaplan.pipes import receive, send
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.worker import CancelledError, Job, Told, Worker
from tests import cases


def told_in_thirds(progress: Told) -> str:
    print("this is not an answer")
    for share in (1 / 3, 2 / 3):
        progress(share)
    return f"{os.getpid()}"


def refuse() -> None:
    raise InputError("found nothing; expected something")


def kill_oneself() -> None:
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(10)


def job(work: Any, *, tells: bool = False) -> Job:
    return Job("working", work, lambda _: None, tells)


def ignore(_: float) -> None:
    pass


def test_an_answer_comes_from_another_process_which_tells_how_far_it_is() -> None:
    shares: list[float] = []
    answer = Worker().answer(job(told_in_thirds, tells=True), shares.append)
    assert int(answer) != os.getpid()
    assert shares == [1 / 3, 2 / 3]


def test_a_refusal_is_that_of_the_work_and_an_end_without_an_answer_is_told() -> None:
    worker = Worker()
    with pytest.raises(InputError, match="found nothing"):
        worker.answer(job(refuse), ignore)
    with pytest.raises(RonnaplanError, match="working ended without an answer"):
        worker.answer(job(kill_oneself), ignore)
    assert not worker.busy


def test_work_is_cancelled_at_once_and_nothing_else_is_begun_meanwhile() -> None:
    worker = Worker()
    ended: list[Exception] = []

    def wait() -> None:
        try:
            worker.answer(job(partial(time.sleep, 60)), ignore)
        except RonnaplanError as error:
            ended.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    while not worker.busy:
        time.sleep(0.01)
    with pytest.raises(UsageError, match="something else"):
        worker.answer(job(refuse), ignore)
    worker.cancel()
    thread.join(60)
    assert [type(one) for one in ended] == [CancelledError]


def test_work_that_is_cancelled_before_its_process_is_there_is_not_done() -> None:
    """It was done all the same: who cancelled it at once was not heard."""
    worker = Worker()
    worker.cancel()
    with pytest.raises(CancelledError, match="cancelled: working"):
        worker.answer(job(partial(time.sleep, 60)), ignore)
    assert not worker.busy


def test_arrays_go_to_the_other_process_as_they_are() -> None:
    stream = io.BytesIO()
    values = np.arange(7000, dtype=np.int16).reshape(70, 100)
    send(stream, {"values": values, "words": ("a", None)})
    stream.seek(0)
    back = receive(stream)
    assert np.array_equal(back["values"], values)
    assert back["words"] == ("a", None)
    with pytest.raises(EOFError):
        receive(stream)


def test_surroundings_go_to_another_process_without_what_is_found_again(state: PlannerState) -> None:
    around, plan = state.case.surroundings, state.case.plan
    judged = state.case.judge(plan.trajectory("left"))
    stream = io.BytesIO()
    send(stream, around)
    assert len(stream.getvalue()) < 1.1 * cases.volume().voxels_hu.nbytes
    stream.seek(0)
    again: Surroundings = receive(stream)
    assert again.judge(plan.trajectory("left"), plan).verdicts == judged.verdicts
