"""Pictures of results."""

from __future__ import annotations

from ronnaplan.figures import Picture
from tests.names import ANY_NAME


def test_a_picture_shows_names_in_any_script_and_by_the_letter() -> None:
    picture = Picture(2.0, 1.0)
    picture.text(0.1, 0.5, ANY_NAME)
    assert picture.png()  # a letter without a font is a warning, a bad formula an error
