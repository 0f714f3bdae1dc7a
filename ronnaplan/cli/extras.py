"""Packages that only some verbs need: a missing one is told before anything is begun."""

from __future__ import annotations


def require_packages(who: str, extra: str, *packages: str) -> None:
    """Raise `InputError` where a package of an ``extra`` is not installed; loads none of them."""
    from importlib.util import find_spec

    from ronnaplan.errors import InputError

    for package in packages:
        if find_spec(package) is None:
            raise InputError(f"{who} needs {package}; install ronnaplan[{extra}]")
