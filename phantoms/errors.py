"""The one error of this package."""

from __future__ import annotations


class PhantomError(Exception):
    """A scene or a scan that cannot be made; the message is one sentence: found, expected, what to do."""
