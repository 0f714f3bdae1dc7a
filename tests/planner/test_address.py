"""The address kept with a case: found again by its own user only, and never while somebody else has its port."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from ronnaplan.planner.address import Address, address_for, keep

HOST = "127.0.0.1"


@pytest.fixture
def free_port() -> int:
    with socket.create_server((HOST, 0)) as one:
        return int(one.getsockname()[1])


def test_an_address_is_found_again_and_only_its_user_can_read_it(tmp_path: Path, free_port: int) -> None:
    file = tmp_path / "address.json"
    first = address_for(file, HOST)
    assert (first.port, len(first.token)) == (0, 32)
    known = Address(free_port, first.token)
    keep(file, known)
    assert address_for(file, HOST) == known
    assert address_for(file, HOST, free_port) == known
    other = address_for(file, HOST, 1 + free_port % 60_000)
    assert other.port != free_port
    assert other.token != known.token
    if os.name == "posix":
        assert file.stat().st_mode & 0o777 == 0o600


@pytest.mark.skipif(os.name != "posix", reason="the system has no such modes")
@pytest.mark.parametrize("spoilt", ["readable", "linked", "damaged", "foreign"])
def test_a_file_that_another_user_may_have_made_is_not_believed(
    tmp_path: Path, free_port: int, spoilt: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "address.json"
    known = Address.new(free_port)
    keep(file, known)
    if spoilt == "readable":
        file.chmod(0o640)
    elif spoilt == "linked":
        file.rename(tmp_path / "elsewhere")
        file.symlink_to(tmp_path / "elsewhere")
    elif spoilt == "damaged":
        file.write_text('{"port": 0, "token": "short"}')
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 1 + file.stat().st_uid)
    found = address_for(file, HOST)
    assert found.token != known.token
    assert found.port == 0


@pytest.mark.skipif(os.name != "posix", reason="the system has no such modes")
def test_a_folder_that_nobody_may_write_into_keeps_no_address_of_roots_either(
    tmp_path: Path, free_port: int
) -> None:
    tmp_path.chmod(0o555)
    try:
        keep(tmp_path / "address.json", Address.new(free_port))
        assert not list(tmp_path.iterdir())
    finally:
        tmp_path.chmod(0o755)


def test_a_second_planner_of_a_case_leaves_the_first_its_address(tmp_path: Path) -> None:
    file = tmp_path / "address.json"
    with socket.create_server((HOST, 0)) as taken:
        first = Address.new(taken.getsockname()[1])
        keep(file, first)
        second = address_for(file, HOST)
        assert second.token != first.token
        keep(file, second)
    assert address_for(file, HOST) == first
