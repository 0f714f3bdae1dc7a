"""Noise that a filter has smoothed; scipy's own filter takes a second to import, in each process that tests."""

from __future__ import annotations

from collections.abc import Sequence

from ronnaplan.geometry import FloatArray


def filtered(gain: float, memory: Sequence[float], white: FloatArray) -> FloatArray:
    """Return the rows of ``gain * white``, each with those before it: the last times ``memory[0]``, and so on."""
    found = gain * white
    for row in range(1, len(found)):
        for back, share in enumerate(memory[:row], start=1):
            found[row] += share * found[row - back]
    return found
