"""A Dask scheduler that runs somewhere: who works on it asks for its client here."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Final

from ronnaplan.errors import InputError

ANSWERS_WITHIN: Final = "10s"


def client_of(address: str) -> Any:
    """Return a Dask client of the scheduler at ``address``; raises `InputError` where none answers, or no Dask is."""
    try:
        distributed = import_module("distributed")
    except ImportError as error:
        raise InputError("Dask is not installed; install ronnaplan[cluster] or leave --scheduler out") from error
    try:
        return distributed.Client(address, timeout=ANSWERS_WITHIN)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"no Dask scheduler answers at {address}; check the address") from error
