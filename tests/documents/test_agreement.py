"""A registration of other markers than there are now is found out."""

from __future__ import annotations

from ronnaplan.case.marker_edits import reject, rename
from ronnaplan.documents.agreement import disagreement
from tests import cases


def test_a_registration_agrees_with_the_markers_it_was_made_of() -> None:
    assert disagreement(cases.fiducials(), cases.registration()) is None


def test_a_marker_gone_renamed_or_moved_is_named() -> None:
    found, made = cases.fiducials(), cases.registration()
    assert "uses marker F2" in (disagreement(reject(found, "F2"), made) or "")
    assert "uses marker F3" in (disagreement(rename(found, "F3", "nose"), made) or "")
    first, *others = found.fiducials
    x, y, z = first.center
    moved = found.model_copy(
        update={"fiducials": (first.model_copy(update={"center": (x, y, z + 0.001)}), *others)}
    )
    assert "F1 at another place" in (disagreement(moved, made) or "")
    new = first.model_copy(update={"label": "F7", "center": (0.0, 0.0, 99.0)})
    more = found.model_copy(update={"fiducials": (*found.fiducials, new)})
    assert "does not know marker F7" in (disagreement(more, made) or "")
