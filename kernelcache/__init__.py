"""Numba's `njit`, typed, and with copies on disk that are never stale.

Numba compares a compiled copy with the source of the function's own file only. A kernel also holds the constants that
its module imports, and the code of the kernels that it calls: where those stand in another module and change, numba
goes on with the old copy. Here a copy counts only while everything that its module has imported of its own package is
the same: constants by their values, kernels by the source of their modules, and of all that those import in turn.
What a module merely mentions in types does not count.

Two packages stand on this one, `ronnaplan` and `phantoms`, which share nothing else.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from enum import Enum, EnumMeta
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import caching

Function = TypeVar("Function", bound=Callable[..., Any])

PLAIN = (bool, int, float, complex, str, bytes, np.generic)
"""Constants whose text tells their value."""


def njit(**options: Any) -> Callable[[Function], Function]:
    """Compile a function of numbers and arrays to machine code; ``options`` are those of `numba.njit`."""

    def compiled(function: Function) -> Function:
        with _own_locators():
            return cast(Function, numba.njit(**options)(function))

    return compiled


@contextmanager
def _own_locators() -> Iterator[None]:
    """Let numba keep the copies of what is compiled just now by these rules, unless a person has stated others."""
    config: Any = numba.config
    stated = config.CACHE_LOCATOR_CLASSES
    config.CACHE_LOCATOR_CLASSES = stated or ",".join(f"{__name__}.{one.__name__}" for one in LOCATORS)
    try:
        yield
    finally:
        config.CACHE_LOCATOR_CLASSES = stated


def _never_stale(locator: type) -> type:
    """Return numba's ``locator`` of copies with a stamp that changes with all that a copy holds."""

    def begin(self: Any, function: Any, file: str) -> None:
        locator.__init__(self, function, file)  # type: ignore[misc]  # of this very class
        self.imports = imported(function.__globals__)

    def stamp(self: Any) -> tuple[object, str]:
        return locator.get_source_stamp(self), self.imports  # type: ignore[attr-defined]  # numba has no types

    return type(locator.__name__, (locator,), {"__init__": begin, "get_source_stamp": stamp})


def imported(namespace: Mapping[str, Any]) -> str:
    """Return a digest of what a module's ``namespace`` holds of other modules and a kernel may contain."""
    told = (f"{name}={_told(value, namespace['__name__'])}" for name, value in sorted(namespace.items()))
    return hashlib.sha256("\n".join(told).encode()).hexdigest()


def _told(value: object, home: str) -> str:
    """Return in text what a kernel of the module ``home`` may take from ``value``, empty where it is nothing."""
    if value is None or isinstance(value, PLAIN):
        return repr(value)
    if isinstance(value, tuple):
        return ",".join(_told(one, home) for one in value)
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, EnumMeta):
        members: Mapping[str, Enum] = value.__members__
        return repr({name: member.value for name, member in members.items()})
    function = getattr(value, "py_func", None)
    module = value.__name__ if isinstance(value, ModuleType) else getattr(function, "__module__", home)
    return _module(module) if module != home and module.split(".")[0] == home.split(".")[0] else ""


@cache
def _module(name: str) -> str:
    """Return a digest of a module's source and of what it has imported."""
    module = sys.modules[name]
    source = Path(module.__file__).read_bytes() if module.__file__ else b""
    return hashlib.sha256(source).hexdigest() + imported(vars(module))


UserProvidedCacheLocator = _never_stale(caching.UserProvidedCacheLocator)
InTreeCacheLocator = _never_stale(caching.InTreeCacheLocator)
UserWideCacheLocator = _never_stale(caching.UserWideCacheLocator)
ZipCacheLocator = _never_stale(caching.ZipCacheLocator)
LOCATORS = (UserProvidedCacheLocator, InTreeCacheLocator, UserWideCacheLocator, ZipCacheLocator)
"""Where copies are looked for, in numba's order."""
