"""Packages that only some work needs: a missing one is told, with what brings it."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from ronnaplan.errors import InputError, UsageError


def require_packages(who: str, extra: str, *packages: str) -> None:
    """Raise `InputError` where a package of an ``extra`` is not installed; loads none of them."""
    for package in packages:
        if find_spec(package) is None:
            raise InputError(f"{who} needs {package}; install ronnaplan[{extra}]")


def library_of_arrays(name: str) -> Any:
    """Return another library for arrays, or tables; raises `UsageError` where it is not installed."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise UsageError(
            f"{name} is not installed; run 'pip install {name}', or install ronnaplan[arrays]"
        ) from error
