"""Numba's decorator with a type, so that the compiled inner loops stay checked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

FASTMATH = {"contract", "reassoc", "arcp", "nsz"}
"""Only what cannot disturb infinities and NaN, which the intersection code relies on."""


def compiled(*, parallel: bool = False) -> Callable[[Function], Function]:
    """Compile a function of numbers and arrays to machine code, kept on disk between runs."""
    decorator = numba.njit(cache=True, parallel=parallel, fastmath=FASTMATH, error_model="numpy")
    return cast(Callable[[Function], Function], decorator)


parallel_range = numba.prange
