"""One marker, of which others are made."""

from __future__ import annotations

import pytest

from ronnaplan.localization.examine import Examined, examine
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, scan, small_stack


@pytest.fixture(scope="module")
def scanned() -> Scan:
    return Scan(scan(balls([(1.0, 2.0, 3.0)]), small_stack()))


@pytest.fixture(scope="module")
def ball(scanned: Scan) -> Examined:
    return next(one for one in examine(scanned, (11.5,)) if one.is_marker)
