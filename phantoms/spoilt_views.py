"""What spoils a camera's view of a ball: things before it, reflections on it and beside it, drawn into the image."""

from __future__ import annotations

import numpy as np

from phantoms.cameras import SIZE
from phantoms.solids import FloatArray


def _offsets_from(at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far each column (1, columns) lies to the right of a place (2,), and each row (rows, 1) below it."""
    rows, columns = np.ogrid[: SIZE[0], : SIZE[1]]
    return columns - at[0], rows - at[1]


def hide(image: FloatArray, at: FloatArray, radius_px: float, share: float, rng: np.random.Generator) -> None:
    """Put something dark or grey with a straight edge before ``share`` of the outline."""
    angle = rng.uniform(0, 2 * np.pi)
    right, down = _offsets_from(at)
    beyond = right * np.cos(angle) + down * np.sin(angle) - radius_px * np.cos(np.pi * share)
    width = radius_px * rng.uniform(1.4, 3.0)
    cover = np.clip(beyond + 0.5, 0, 1) * np.clip(width - beyond + 0.5, 0, 1)
    image += cover * (rng.uniform(5, 60) - image)


def cross(image: FloatArray, at: FloatArray, radius_px: float, width_px: float, rng: np.random.Generator) -> None:
    """Put a straight cable, dark or grey, across the ball."""
    angle, aside = rng.uniform(0, 2 * np.pi), radius_px * rng.uniform(0.0, 0.7)
    right, down = _offsets_from(at)
    off = right * np.cos(angle) + down * np.sin(angle) - aside
    image += np.clip(width_px / 2 - np.abs(off) + 0.5, 0, 1) * (rng.uniform(5, 100) - image)


def highlight(image: FloatArray, at: FloatArray, radius_px: float, added: float, rng: np.random.Generator) -> None:
    """Add the lamp's reflection to the ball's middle, as smooth surfaces show it."""
    far = np.hypot(*_offsets_from(at + radius_px * rng.uniform(-0.1, 0.1, 2)))
    image += added * np.exp(-((far / (radius_px * rng.uniform(0.05, 0.2))) ** 2) / 2)


def glare(image: FloatArray, at: FloatArray, radius_px: float, width_px: float, rng: np.random.Generator) -> None:
    """Add a blob on the limb, soft or hard, as a lamp's reflection is."""
    angle = rng.uniform(0, 2 * np.pi)
    far = np.hypot(
        *_offsets_from(at + radius_px * rng.uniform(0.9, 1.05) * np.array([np.cos(angle), np.sin(angle)]))
    )
    if rng.uniform() < 0.5:
        image += rng.uniform(80, 250) * np.exp(-((far / width_px) ** 2) / 2)
    else:
        image += np.clip(width_px - far + 0.5, 0, 1) * (240 - image)


def glints(image: FloatArray, at: FloatArray, clear_px: float, number: int, rng: np.random.Generator) -> None:
    """Draw bright ellipses of all sizes, none nearer to the ball than ``clear_px``."""
    for _ in range(number):
        middle, angle = rng.uniform((0, 0), SIZE[::-1]), rng.uniform(0, np.pi)
        axes = np.exp(rng.uniform(np.log(2), np.log(40), 2))
        if np.linalg.norm(middle - at) < clear_px + axes.max():
            continue
        first, past = np.maximum(middle - axes.max(), 0).astype(int), (middle + axes.max()).astype(int) + 1
        around = np.s_[first[1] : past[1], first[0] : past[0]]  # no other pixel is within
        right, down = _offsets_from(middle)
        right, down = right[:, around[1]], down[around[0]]
        x, y = right * np.cos(angle) + down * np.sin(angle), down * np.cos(angle) - right * np.sin(angle)
        image[around][np.hypot(x / axes[0], y / axes[1]) < 1] = rng.uniform(200, 255)
