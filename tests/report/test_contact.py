"""What a marker's model leaves over, as the contact sheet and the report draw it."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ronnaplan import localize
from ronnaplan.report.contact import NEARLY_SHOWN, TILE, Candidate, cut_pair, draw_row, draw_sheet, gathered
from ronnaplan.report.picture import CUTS
from tests.cases import ball_parameters
from tests.long import few_and_others
from tests.names import ANY_NAME
from tests.scans import balls, scan, small_stack

CENTER = (3.0, -4.0, 2.0)
HEADING, MARGIN, ACROSS, DOWN = 48, 19, 180, 171
"""Pixels of the heading, before the first tile, and from one tile to the next."""


@few_and_others("tilt_deg", [0.0], [12.0])
def test_a_ball_that_the_model_fits_leaves_only_noise_on_every_cut(tilt_deg: float) -> None:
    volume = scan(balls([CENTER]), small_stack(tilt_deg=tilt_deg), noise_hu=5.0)
    found = localize(volume, diameter_mm=11.5, expected=1).fiducials[0]
    fitted = Candidate("F1", found.center_mm, found.parameters, accepted=True)
    moved = Candidate("F1", found.center_mm + 0.5, found.parameters, accepted=True)
    for cut in CUTS:
        _, rest = cut_pair(volume, fitted, cut)
        assert np.std(rest) < 8.0
        assert np.abs(rest).max() < 0.05 * found.contrast_hu
        _, wrong = cut_pair(volume, moved, cut)
        assert np.abs(wrong).max() > 0.1 * found.contrast_hu


def pixels(png: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), dtype=np.float64)


def test_the_sheet_has_each_cut_where_it_belongs_and_an_outline_on_the_edge() -> None:
    volume = scan(balls([CENTER]), small_stack(), noise_hu=5.0)
    found = localize(volume, diameter_mm=11.5, expected=1)
    drawn = gathered(volume, found)
    sheet = pixels(draw_sheet(drawn))
    alone = pixels(draw_row(*drawn[0]))
    rows = 1 + min(len(found.rejected), NEARLY_SHOWN)
    assert sheet.shape == (HEADING + rows * DOWN + MARGIN, 6 * ACROSS, 3)
    names = sheet[HEADING - 16 : HEADING]
    assert all(
        names[:, MARGIN + column * ACROSS :][:, :TILE].min() < 100 for column in range(6)
    )  # each has a title
    sheet = sheet[HEADING:]
    np.testing.assert_array_equal(alone[MARGIN:], sheet[MARGIN : len(alone)])
    reach_mm = 1.6 * 5.75 + 1.0
    for column in range(6):
        tile = sheet[MARGIN:, MARGIN + column * ACROSS :][:TILE, :TILE]
        middle, corner = tile[65:85, 65:85].mean(axis=(0, 1)), tile[:10, :10].mean(axis=(0, 1))
        if column % 2 == 0:
            assert middle.min() > 150 > 60 > corner.max()  # the ball is bright, what is about it dark
        else:
            assert min(middle.min(), corner.min()) > 215  # next to nothing is left over
        edge = TILE / 2 + 5.75 / reach_mm * TILE / 2
        line = tile[TILE // 2, round(edge) - 3 : round(edge) + 4]
        assert (line[:, 0] - line[:, 2]).max() > 80  # the outline is orange


def test_a_row_is_named_in_any_script_and_by_the_letter() -> None:
    named = Candidate(ANY_NAME, np.zeros(3), ball_parameters(), accepted=True)
    cut = np.zeros((4, 4), dtype=np.float32)
    assert draw_sheet(
        [(named, [(cut, cut)] * len(CUTS))]
    )  # a letter without a font is a warning, a bad formula an error
