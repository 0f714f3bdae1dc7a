"""Standard output and standard error as every verb meets them: what cannot be written is said, never lost."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO, cast

from ronnaplan.errors import InputError


@contextmanager
def guarded_output() -> Iterator[None]:
    """Guard both streams while a verb runs, whatever it is and however it prints.

    Standard output that is closed or full raises `InputError` at the first text that does not get out. Standard error
    carries messages only: where it is closed or full, they are dropped (Python itself would print them to standard
    output). `BrokenPipeError` is passed on, for a reader may go away.
    """
    output, error = sys.stdout, sys.stderr
    # sys.stdout is None when the process was started with it closed, whatever its type says
    sys.stdout, sys.stderr = cast(TextIO, _Output(output)), cast(TextIO, _Messages(error))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = output, error


@contextmanager
def ended_gently() -> Iterator[None]:
    """Have SIGTERM and a lost terminal end what runs within as Ctrl-C does, so that what came until then is kept."""
    named = (getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP"))
    found = [one for one in named if one is not None and signal.getsignal(one) is signal.SIG_DFL]
    heeded = found if threading.current_thread() is threading.main_thread() else []  # no other may set them
    for one in heeded:
        signal.signal(one, signal.default_int_handler)
    try:
        yield
    finally:
        for one in heeded:
            signal.signal(one, signal.SIG_DFL)


def discard_output() -> None:
    """Send what is still to be written to standard output nowhere, so that leaving does not fail once more."""
    _discard(sys.stdout)


def _discard(stream: TextIO) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _Output:
    """A stream whose failures are sentences."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        if self._stream is None:
            raise InputError("standard output is closed; name a file with -o, or give it somewhere to go")
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise _cannot_write(error) from error

    def flush(self) -> None:
        try:
            if self._stream is not None:
                self._stream.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            raise _cannot_write(error) from error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class _Messages:
    """A stream that nobody may read: what does not get out is dropped."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        if self._stream is not None:
            with self._dropped():
                self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        if self._stream is not None:
            with self._dropped():
                self._stream.flush()

    @contextmanager
    def _dropped(self) -> Iterator[None]:
        try:
            yield
        except OSError:
            _discard(cast(TextIO, self._stream))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _cannot_write(error: OSError) -> InputError:
    discard_output()
    return InputError(f"cannot write to standard output: {error.strerror}; name a file with -o, or make room")


def tell(*lines: str) -> None:
    """Say on standard error what was found."""
    for line in lines:
        print(line, file=sys.stderr)


def warn(*sentences: str) -> None:
    """Say on standard error what a person should know beside the result."""
    tell(*(f"ronnaplan: warning: {sentence}" for sentence in sentences))


@contextmanager
def library_warnings() -> Iterator[None]:
    """Have what the library warns of, in the midst of a call, said as `warn` says it."""

    class Said(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            warn(record.getMessage())

    logger, handler = logging.getLogger("ronnaplan"), Said(logging.WARNING)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
