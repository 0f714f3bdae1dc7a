"""A chessboard in the cameras' images: where its inner corners are, and which of them is which.

OpenCV finds the board. Its own places of corners are up to a pixel off on the edge of a board of small squares, so each
is fitted: two edges that cross, blurred. Turned by half a turn about the corner, that looks the same whatever the
blur, and however cameras bend brightness, so that neither moves it.
"""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral, Real

import numpy as np

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.circles import Image
from ronnaplan.transforms import exponential

FEWEST_BOARDS = 6
"""Image pairs that show the whole board."""
FEWEST_CORNERS, MOST_CORNERS = 3, 100
"""Inner corners that a board may have along either side."""
BENT_ORDER = 4
"""A board may be bent as a polynomial of up to this degree along both sides together."""
BRIGHTEST_PERCENT = (100, 95)
"""What is brighter than so much of the image is taken for white when boards are looked for: nothing at first, then a
retro-reflective marker or another highlight, beside which a board may be too dark to be found."""
SQUARE_SHARE, LARGEST_RADIUS_PX = 0.75, 12.0
"""A corner is fitted within so much of the way to the next line of corners, and no farther out than this."""
STEPS, FITTED_PX = 40, 1e-3
"""A fit is done when no corner moves by more; what still does after so many steps is no corner."""
DAMPING, SMALLEST_INFORMATION = 1e-3, 1e-9
"""Part of the normal matrix's diagonal that is added at first, and a tenth of it each step after; and what is added
always, for what a corner without contrast does not tell."""
LARGEST_BLUR_PX, SMALLEST_BLUR_PX = 6.0, 0.3
LARGEST_STEPS = np.array([1.0, 1.0, 0.2, 0.2, np.inf, np.inf, 0.3, np.inf, np.inf])
"""Of a corner's place (px), the directions square to its edges (rad), grey, contrast, blur (px), and slope of grey."""


def require_board(corners: tuple[int, int], square_mm: float, sigma_square: float) -> None:
    """Raise `UsageError` or `InputError` for what is no board: its inner corners, and the side of its squares."""
    check_type(corners, Sequence, "the board's corners", "give those along its rows and columns: (9, 7)")
    if len(corners) != 2 or not all(
        isinstance(count, Integral) and FEWEST_CORNERS <= count <= MOST_CORNERS for count in corners
    ):
        raise InputError(
            f"a board of {corners} inner corners was given; expected columns and rows, {FEWEST_CORNERS} to "
            f"{MOST_CORNERS} of either"
        )
    check_type(square_mm, Real, "the side of the board's squares", "give a number of mm")
    check_type(sigma_square, Real, "the error of that side", "give it as a part of the side: 0.001")
    if not 0 < square_mm < np.inf or not 0 <= sigma_square < 1:
        raise InputError(
            f"the board's squares are {square_mm} mm long, to a part of {sigma_square}; expected a length above zero, "
            "and its standard error as a part of it, below 1"
        )


def seen_by_both(
    left: Sequence[Image], right: Sequence[Image], corners: tuple[int, int]
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the corners (K, 1, 2) in each pair of images that shows the whole board; `InputError` for too few."""
    pairs = [(find_corners(a, corners), find_corners(b, corners)) for a, b in zip(left, right, strict=True)]
    seen = [(a, b) for a, b in pairs if a is not None and b is not None]
    if len(seen) < FEWEST_BOARDS:
        raise InputError(
            f"the whole board is seen in {len(seen)} image pairs; expected {FEWEST_BOARDS} or more of a plain "
            f"chessboard (no ChArUco) of {corners[0]} x {corners[1]} inner corners, all of it in both images"
        )
    return seen


def find_corners(image: Image, corners: tuple[int, int]) -> FloatArray | None:
    """Return the places (K, 1, 2) of a board's inner ``corners`` row by row, or None where it is not whole."""
    import cv2

    grey = np.asarray(image, dtype=np.float64)
    for white in np.percentile(grey, BRIGHTEST_PERCENT):
        scaled = np.clip(grey * (255 / max(float(white), 1e-9)), 0, 255).astype(np.uint8)
        found, places = cv2.findChessboardCornersSB(scaled, corners, flags=cv2.CALIB_CB_ACCURACY)
        fitted = _fitted(grey, np.asarray(places, dtype=np.float64).reshape(-1, 2), corners) if found else None
        if fitted is not None:
            return fitted[:, None]
    return None


def grid_mm(corners: tuple[int, int], square_mm: float) -> FloatArray:
    """Return the inner corners (K, 3) of a board in its own frame, row by row."""
    places = np.zeros((corners[0] * corners[1], 3))
    places[:, :2] = np.mgrid[: corners[0], : corners[1]].T.reshape(-1, 2) * square_mm
    return places


def shapes(corners: tuple[int, int]) -> FloatArray:
    """Return how a board's inner corners move (K, 3, S) by each number of its shape, by 1 RMS or more.

    It may be bent, stretched along one side against the other, and lean. Its scale and place are not of its shape.
    """
    columns, rows = corners
    places = grid_mm(corners, 1.0)[:, :2]
    x, y = ((places - places.mean(axis=0)) / places.std()).T
    powers = [(i, j) for i in range(columns) for j in range(rows) if i + j <= BENT_ORDER]
    powers.sort(key=sum)  # those of a plane first, to which the others are made square
    bent = np.linalg.qr(np.column_stack([x**i * y**j for i, j in powers]))[0][:, 3:] * np.sqrt(len(x))
    moves = np.zeros((len(x), 3, bent.shape[1] + 2))
    moves[:, 2, :-2] = bent
    moves[:, :2, -2] = np.column_stack([x, -y])
    moves[:, :2, -1] = np.column_stack([y, x])
    return moves


def quarters_apart(left: FloatArray, right: FloatArray, square: bool) -> list[int]:
    """Return by how many quarter turns the right camera counts each board's corners otherwise than the left.

    Boards are seen with rotations (N, 3, 3). One that looks the same upside down, or on its side where it is
    ``square``, has several first corners, and the cameras may not have taken the same. The cameras rest against each
    other, so the choice is the one with the steadiest rotation between them.
    """
    from scipy.spatial.transform import Rotation

    counts = (0, 1, 2, 3) if square else (0, 2)
    turns = exponential(np.outer(counts, (0.0, 0.0, np.pi / 2)))
    choices = right @ turns[:, None] @ left.swapaxes(1, 2)
    angles: list[list[FloatArray]] = [
        [np.atleast_1d(Rotation.from_matrix(reference.T @ choice).magnitude()) for choice in choices]
        for reference in choices[:, 0]
    ]
    best = min(angles, key=lambda one: float(np.min(one, axis=0).sum()))
    return [counts[n] for n in np.argmin(best, axis=0)]


def recounted(seen: FloatArray, corners: tuple[int, int], quarters: int) -> FloatArray:
    """Return the places of a board's corners, row by row, in the order in which they are counted ``quarters`` on."""
    columns, rows = corners
    return np.rot90(seen.reshape(rows, columns, 2), quarters).reshape(seen.shape)


def _fitted(grey: FloatArray, places: FloatArray, corners: tuple[int, int]) -> FloatArray | None:
    """Return the corners (K, 2) near ``places``, each where two blurred edges cross, or None where one does not fit."""
    columns, rows = corners
    at = places.reshape(rows, columns, 2)
    along, down = (np.asarray(np.gradient(at, axis=axis)).reshape(-1, 2) for axis in (1, 0))
    area = np.abs(along[:, 0] * down[:, 1] - along[:, 1] * down[:, 0])
    apart = area / np.maximum(np.linalg.norm(along, axis=1), np.linalg.norm(down, axis=1))
    radius = np.minimum(SQUARE_SHARE * apart, LARGEST_RADIUS_PX)
    pixels, weights, values = _windows(grey, places, radius)
    found = np.zeros((len(places), len(LARGEST_STEPS)))  # without contrast, which the first step finds, none moves
    found[:, :2], found[:, 6] = places, 1.0
    found[:, 2], found[:, 3] = np.arctan2(along[:, 0], -along[:, 1]), np.arctan2(down[:, 0], -down[:, 1])
    every = np.arange(found.shape[1])
    for number in range(STEPS):
        model, slope = _crossing_edges(found, pixels)
        counted = (slope * weights[:, :, None]).transpose(0, 2, 1)
        normal = counted @ slope
        normal[:, every, every] = normal[:, every, every] * (1 + DAMPING * 0.1**number) + SMALLEST_INFORMATION
        step = np.linalg.solve(normal, counted @ (values - model)[:, :, None])[:, :, 0]
        step = np.clip(step, -LARGEST_STEPS, LARGEST_STEPS)
        found += step
        found[:, 6] = np.clip(found[:, 6], SMALLEST_BLUR_PX, LARGEST_BLUR_PX)
        moved_px = float(np.abs(step[:, :2]).max())
        if number > 0 and moved_px < FITTED_PX:
            near = np.linalg.norm(found[:, :2] - places, axis=1) < radius / 2
            return found[:, :2] if near.all() else None
    return None


def _windows(
    grey: FloatArray, places: FloatArray, radius: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pixels (K, P, 2) about ``places`` (K, 2), whether they are within ``radius`` (K), and their grey."""
    reach = int(np.ceil(radius.max()))
    around = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)[::-1].T
    pixels = np.round(places).astype(int)[:, None] + around
    last = np.array(grey.shape[::-1]) - 1
    within = ((pixels >= 0) & (pixels <= last)).all(axis=2)
    near = np.linalg.norm(pixels - places[:, None], axis=2) <= radius[:, None]
    columns, rows = np.moveaxis(np.clip(pixels, 0, last), 2, 0)
    return pixels.astype(np.float64), (within & near).astype(np.float64), grey[rows, columns]


def _crossing_edges(corner: FloatArray, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the grey (K, P) of each ``corner`` (K, 9) at ``pixels`` (K, P, 2), and its derivatives (K, P, 9).

    It is ``m + g . x + h erf(d1 / s) erf(d2 / s)`` of the place x from the corner and the distances d from its edges;
    a corner is its place, the directions square to its edges, m, h, s, and g.
    """
    from scipy.special import erf

    first, second, middle, contrast, blur, *slope = corner.T[2:, :, None]
    x, y = np.moveaxis(pixels - corner[:, None, :2], 2, 0)
    far, edge, rise, turned = [], [], [], []
    for angle in (first, second):
        far.append(np.cos(angle) * x + np.sin(angle) * y)
        turned.append(np.cos(angle) * y - np.sin(angle) * x)
        edge.append(erf(far[-1] / blur))
        rise.append(2 / np.sqrt(np.pi) * np.exp(-((far[-1] / blur) ** 2)) / blur)
    by_far = [contrast * rise[0] * edge[1], contrast * rise[1] * edge[0]]
    derivatives = [
        -(np.cos(first) * by_far[0] + np.cos(second) * by_far[1]) - slope[0],
        -(np.sin(first) * by_far[0] + np.sin(second) * by_far[1]) - slope[1],
        by_far[0] * turned[0],
        by_far[1] * turned[1],
        np.ones_like(x),
        edge[0] * edge[1],
        -(by_far[0] * far[0] + by_far[1] * far[1]) / blur,
        x,
        y,
    ]
    model = middle + slope[0] * x + slope[1] * y + contrast * edge[0] * edge[1]
    return model, np.stack(derivatives, axis=2)
