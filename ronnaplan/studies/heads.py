"""The marker layouts that the studies use; the paper did not publish its own."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray

HEADS_MM: FloatArray = np.array(
    [
        [
            [21.5, -90.8, 40.3],
            [48.2, -56.1, 58.9],
            [-41.7, -52.4, 68.3],
            [68.5, -46.9, 30.3],
            [-63.7, 8.3, 61.1],
            [16.9, 59.1, 78.1],
            [66.1, 60.5, 9.5],
            [-28.9, 92.5, 28.3],
        ],
        [
            [46.4, -74.4, 19.8],
            [-50.3, -69.6, 21.8],
            [-32.9, -63.4, 57.3],
            [-74.7, -1.5, 22.2],
            [-64.6, 35.5, 36.8],
            [25.7, 63.1, 62.7],
            [-44.9, 68.6, 36.5],
            [31.4, 88.0, 8.5],
        ],
        [
            [-35.0, -83.2, 48.7],
            [17.5, -70.6, 73.8],
            [66.2, -47.5, 46.6],
            [-0.3, -36.2, 96.0],
            [73.8, -9.1, 51.4],
            [-69.6, -4.3, 59.6],
            [-64.9, 51.4, 45.5],
            [-29.9, 99.7, -10.2],
        ],
    ]
)
"""(3, 8, 3) Eight adhesive markers on three heads, LPS mm about the head's center.

Drawn at random over the scalp of an ellipsoid of 152 x 196, 142 x 182 and 160 x 202 mm, 6 mm above the skin, at least
35 mm apart, with markers on both sides and in front and none on the face; of 100 such layouts a head, the one that is
harder to confuse than four in five."""

X_FRAME_MM: FloatArray = np.array(
    [[34.0, 40.0, -3.0], [-40.0, 38.0, -3.0], [-32.0, -51.0, -2.0], [51.0, -37.0, 3.0]]
)
"""(4, 3) Four markers of an x-shaped frame, mm: sides of 74.0, 79.1, 84.3 and 89.4, diagonals of 112.4 and 118.1.

The two most similar distances differ by 5.1 mm; the paper's frame, whose coordinates were not published, let the
algorithm succeed up to e = 4.5 mm."""
