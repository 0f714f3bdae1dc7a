"""A scheduler that cannot be asked is told in one sentence; one that answers is in tests/cohort/test_cluster.py."""

import sys

import pytest

from ronnaplan import scheduler
from ronnaplan.errors import InputError


def test_an_address_where_none_answers_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(scheduler, "ANSWERS_WITHIN", "0.2s")
    with pytest.raises(InputError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:1; check the address"):
        scheduler.client_of("tcp://127.0.0.1:1")


def test_a_missing_dask_is_told_with_what_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"install ronnaplan\[cluster\] or leave --scheduler out"):
        scheduler.client_of("tcp://127.0.0.1:1")
