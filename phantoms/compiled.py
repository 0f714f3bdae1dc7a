"""The phantoms' way of compiling inner loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

from kernelcache import njit

Function = TypeVar("Function", bound=Callable[..., Any])

FASTMATH = {"contract", "reassoc", "arcp", "nsz"}
"""Only what cannot disturb infinities and NaN, which the intersection code relies on."""


def compiled(*, parallel: bool = False) -> Callable[[Function], Function]:
    """Compile a function of numbers and arrays to machine code, kept on disk between runs."""
    return njit(cache=True, parallel=parallel, fastmath=FASTMATH, error_model="numpy")


parallel_range = numba.prange
