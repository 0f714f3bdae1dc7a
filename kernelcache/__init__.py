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
import logging
import pickle
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from enum import Enum, EnumMeta
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import caching
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.types import unliteral

Function = TypeVar("Function", bound=Callable[..., Any])

UNREADABLE = (pickle.UnpicklingError, EOFError, AttributeError, ImportError, IndexError, TypeError, ValueError)
"""What reading an index ends in that was cut off, or names a type that another version has no more."""

PATIENCE_S = 60.0
"""So long a process waits for another that compiles a kernel, which takes some seconds: that may hang, or have left a
lock behind where the system knows none."""

NO_MORE: dict[str, Any] = {"no_cfunc_wrapper": True}
"""Nobody calls a kernel from C; numba would compile a tenth longer for that. Its stubs do not know the option."""

NO_FOLDER = "no locator available"
"""What numba says of copies where it may write neither beside the source nor in the user's folder of such files."""

homeless: list[str] = []
"""Kernels that are compiled anew each time."""

PLAIN = (bool, int, float, complex, str, bytes, np.generic)
"""Constants whose text tells their value."""


def njit(*, cache: bool = False, **options: Any) -> Callable[[Function], Function]:
    """Compile a function of numbers and arrays to machine code; the options are those of `numba.njit`.

    A kernel fills slices and rows with an array by loops: where one assigns it, numba compiles, too, how an error tells
    two shapes, which takes longer than most kernels (2 s of a processor for each number of axes). One that takes a few
    microseconds keeps the interpreter's lock: to hand that to another thread, and wait for it, takes longer.
    """

    def compiled(function: Function) -> Function:
        kernel: Any = numba.njit(**options, **NO_MORE)(function)
        if isinstance(kernel, Dispatcher):  # it is none where numba was told to compile nothing
            _take_constants_as_numbers(kernel)
            copies = _copies(function) if cache else None
            if copies is not None:
                kernel._cache = copies  # type: ignore[attr-defined]
                _compile_once(kernel)
        return cast(Function, kernel)

    return compiled


def _copies(function: Any) -> Copies | None:
    """Return a kernel's copies on disk; None where there is no folder for any, as without a home in a read-only system.

    The first such kernel is told: all of a program are compiled anew then, each time that it runs.
    """
    try:
        return Copies(function)
    except RuntimeError as error:
        if NO_FOLDER not in str(error):
            raise
        if not homeless:
            logging.getLogger(__name__).warning(
                "no folder takes compiled copies of the inner loops, which are compiled anew each time (15 to 40 s); "
                "name one that may be written to by NUMBA_CACHE_DIR"
            )
        homeless.append(function.__qualname__)
        return None


@cache
def _say_what_is_waited_for() -> None:
    """Tell who sits at a terminal, once a process, why it takes so long this time; files and pipes get nothing."""
    if sys.stderr is not None and sys.stderr.isatty():
        print("compiling the inner loops, once for this version and machine (15 to 40 s) ...", file=sys.stderr)


def _take_constants_as_numbers(kernel: Any) -> None:
    """Have a ``kernel`` that another calls with a constant be the one that takes any number.

    Numba would compile one for each constant, and one more for a count that begins at 0 and is handed on in a loop.
    """
    given = kernel._compiler.fold_argument_types

    def numbers(arguments: Any, named: Any) -> tuple[Any, tuple[Any, ...]]:
        signature, kinds = given(arguments, named)
        return signature, tuple(map(unliteral, kinds))

    kernel._compiler.fold_argument_types = numbers


def _compile_once(kernel: Any) -> None:
    """Have processes that want a ``kernel`` at once wait for the first to compile it, and take its copy."""
    compiling = kernel.compile

    def once(signature: Any) -> Any:
        with global_compiler_lock, kernel._cache.alone(signature, kernel.targetctx):
            return compiling(signature)

    kernel.compile = once


def _never_stale(locator: type) -> type:
    """Return numba's ``locator`` of copies with a stamp that changes with all that a copy holds."""

    def begin(self: Any, function: Any, file: str) -> None:
        locator.__init__(self, function, file)  # type: ignore[misc]  # of this very class
        self.imports = imported(function.__globals__)

    def stamp(self: Any) -> tuple[object, str]:
        return locator.get_source_stamp(self), self.imports  # type: ignore[attr-defined]  # numba has no types

    return type(locator.__name__, (locator,), {"__init__": begin, "get_source_stamp": stamp})


def imported(namespace: Mapping[str, Any]) -> str:
    """Return a digest of what a module's ``namespace`` holds of other modules and a kernel may contain.

    Where the module lies is no part of that: in a folder that was moved, or copied, the copies count as before.
    """
    own = sorted((name, value) for name, value in namespace.items() if not name.startswith("__"))
    told = (f"{name}={_told(value, namespace['__name__'])}" for name, value in own)
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


LOCATORS: list[type[object]] = [
    _never_stale(caching.UserProvidedCacheLocator),
    _never_stale(caching.InTreeCacheLocator),
    _never_stale(caching.UserWideCacheLocator),
    _never_stale(caching.ZipCacheLocator),
]
"""Where copies are looked for, in numba's order."""


class _Copy(caching.CompileResultCacheImpl):
    """Where a copy lies, unless a person has stated other places to numba, and what is in it."""

    _locator_classes = LOCATORS


class _Index(caching.IndexDataCacheFile):
    """The list of a kernel's copies: none where it cannot be read."""

    def _load_index(self) -> Any:
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        except UNREADABLE:
            return {}


class Copies(caching.FunctionCache):
    """A kernel's copies on disk.

    To read one, numba would load all that any kernel could be compiled with, which takes longer than most kernels run.
    A copy is machine code and names itself the modules that it needs; that is loaded and no more, until something is
    compiled.
    """

    _impl_class = _Copy

    def __init__(self, function: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        made = self._cache_file
        self._cache_file = _Index(  # type: ignore[no-untyped-call]
            self._cache_path, self._impl.filename_base, made._source_stamp
        )

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the kernel for ``signature`` as it was compiled once, or None."""
        rtsys.initialize(context)  # its memory management, which every kernel is linked to
        kernel = None
        with self._guard_against_spurious_io_errors():
            kernel = self._load_overload(signature, context)  # type: ignore[no-untyped-call]
        if kernel is None:
            _say_what_is_waited_for()
        return kernel

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep a copy of the kernel as it was compiled; where the disk takes none it is compiled again next time."""
        with suppress(OSError):
            super().save_overload(signature, data)  # type: ignore[no-untyped-call]

    @contextmanager
    def alone(self, signature: Any, context: Any) -> Iterator[None]:
        """Keep other processes from compiling meanwhile, unless there is a copy, or nowhere to put one."""
        with ExitStack() as stack:
            with suppress(OSError):
                wanted = self._index_key(signature, context.codegen())  # type: ignore[no-untyped-call]
                if wanted not in self._cache_file._load_index():  # type: ignore[no-untyped-call]
                    from filelock import FileLock

                    self._impl.locator.ensure_cache_path()
                    lock = Path(self._cache_path) / f"{self._impl.filename_base}.lock"
                    stack.enter_context(FileLock(lock, timeout=PATIENCE_S))
            yield
