"""The project's own errors: each is one sentence that says what was found, what was expected, what to do."""

from __future__ import annotations

import errno

from ronnaplan.text import LONGEST_SENTENCE, printable

STANDARD_INPUT = "-"
"""By which other programs mean standard input."""
NOT_READ = "standard input is not read, so save what it brings to a file"

NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT})
"""What the system says where a disk, or this user's share of it, takes no more."""


class RonnaplanError(Exception):
    """Base of every error that a user can cause; ``exit_status`` is what the command line returns for it.

    Its text is one printable line, whatever a file or the network put into it.
    """

    exit_status = 1

    def __str__(self) -> str:
        return printable(super().__str__(), LONGEST_SENTENCE)


class InputError(RonnaplanError):
    """The input cannot be used: missing, damaged, not what it should be, or geometrically unsafe."""

    exit_status = 1


class UnwrittenError(InputError):
    """A file cannot be written as things are: no room, no permission, a bad disk. Nothing of it was."""


class UsageError(RonnaplanError):
    """The call itself is wrong: an impossible argument or option."""

    exit_status = 2


class RefusedError(RonnaplanError):
    """The input is sound but the answer is not unique or not what was expected, so none is given."""

    exit_status = 3


class FrameMismatchError(InputError):
    """Two things that live in different frames of reference were about to be combined."""


def check_type(value: object, kind: type | tuple[type, ...], what: str, remedy: str) -> None:
    """Raise `UsageError` unless ``value`` is of a ``kind``: ``what`` it is for, and what to do instead."""
    kinds = kind if isinstance(kind, tuple) else (kind,)
    if not isinstance(value, kinds):
        expected = " or ".join(one.__name__ for one in kinds if one is not type(None))
        raise UsageError(f"{type(value).__name__} is given for {what}, expected {expected}; {remedy}")


def wants_room(error: OSError) -> bool:
    """Whether a disk takes no more, a file may grow no larger, or, as then, no folder takes temporary files."""
    is_of_no_file = error.errno == errno.ENOENT and error.filename is None
    return error.errno in NO_ROOM | {errno.EFBIG} or is_of_no_file
