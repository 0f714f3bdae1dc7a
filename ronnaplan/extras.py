"""Packages that only some work needs: a missing one is told before anything is begun."""

from __future__ import annotations

from importlib.util import find_spec

from ronnaplan.errors import InputError


def require_packages(who: str, extra: str, *packages: str) -> None:
    """Raise `InputError` where a package of an ``extra`` is not installed; loads none of them."""
    for package in packages:
        if find_spec(package) is None:
            raise InputError(f"{who} needs {package}; install ronnaplan[{extra}]")
