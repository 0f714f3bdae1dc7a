"""Decisions about markers keep the fitted values and never make a marker without a covariance."""

from __future__ import annotations

from typing import Any

import pytest

from ronnaplan.case.marker_edits import BY_HAND, accept, carried_over, named, reject, rename
from ronnaplan.documents.agreement import disagreement
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.registration import LabelPair, RivalEntry
from ronnaplan.errors import RefusedError, UsageError
from tests import cases


def test_a_rejected_marker_can_be_taken_back_as_it_was() -> None:
    document = cases.fiducials()
    rejected = reject(document, "F2")
    assert "F2" not in [one.label for one in rejected.fiducials]
    assert rejected.rejected[0].reason == BY_HAND
    written = FiducialsDocument.model_validate_json(rejected.model_dump_json())
    assert named(accept(written, 0), "F2") == named(document, "F2")
    assert accept(written, 0).rejected == document.rejected


def test_what_the_localizer_rejected_cannot_be_used() -> None:
    with pytest.raises(RefusedError, match="not round"):
        accept(cases.fiducials(), 0)


def test_a_name_is_neither_empty_nor_used_twice() -> None:
    assert named(rename(cases.fiducials(), "F1", " nose "), "nose").center == cases.fiducials().fiducials[0].center
    known = rename(rename(cases.fiducials(), "F2", "left HC"), "F3", "Caf\u00e9")
    for bad in ("", "  ", "F4", "left  HC", "Cafe\u0301"):  # the last two read as names that are in use
        with pytest.raises(UsageError, match="cannot be the marker's name"):
            rename(known, "F1", bad)
    assert named(rename(known, "left HC", "left  HC"), "left  HC")
    with pytest.raises(UsageError, match="no marker F9"):
        reject(cases.fiducials(), "F9")


def test_of_many_markers_a_sentence_names_ten() -> None:
    one = cases.fiducials().fiducials[0]
    many = tuple(one.model_copy(update={"label": f"{n} {'x' * 300}"}) for n in range(40))
    with pytest.raises(UsageError, match=r"no marker F9; there are 0 x+…x+, 1 x.* and 30 more$") as refused:
        named(cases.fiducials().model_copy(update={"fiducials": many}), "F9")
    assert len(str(refused.value)) < 800


def test_a_marker_is_not_taken_back_over_another_of_its_name() -> None:
    for label, other in (("F2", "F2"), ("left HC", "left  HC")):
        before = rename(cases.fiducials(), "F2", label)
        document = rename(reject(before, label), "F1", other)
        with pytest.raises(UsageError, match=f"another marker {other}"):
            accept(document, 0)


def test_a_registration_goes_with_markers_that_are_renamed_and_stays_as_it_is_else() -> None:
    before = cases.fiducials()
    rival = RivalEntry(pairs=(LabelPair(ct="F2", ots="1"), LabelPair(ct="F1", ots="2")), log_evidence_below=9.0)
    kept = cases.registration().model_copy(update={"rivals": (rival,), "unpaired_ct": ("F6",), "notes": ()})
    kept = kept.model_copy(update={"pairs": kept.pairs[:5]})
    exchanged = rename(rename(rename(before, "F1", "F0"), "F2", "F1"), "F6", "nose")
    found = carried_over(kept, before, exchanged)
    assert disagreement(exchanged, found) is None
    assert [pair.ct for pair in found.pairs[:3]] == ["F0", "F1", "F3"]
    assert [pair.center for pair in found.pairs] == [pair.center for pair in kept.pairs]
    assert [(pair.ct, pair.ots) for pair in found.rivals[0].pairs] == [("F1", "1"), ("F0", "2")]
    assert found.unpaired_ct == ("nose",)
    assert carried_over(found, exchanged, before) == kept


@pytest.mark.parametrize(
    "changes",
    [{"doubt": "F1 lies 2 mm off"}, {"notes": ("marker F1 was left out",)}, {"unpaired_ct": ("F9",)}],
    ids=["a sentence names it", "a note does", "it knows another"],
)
def test_a_registration_that_may_tell_of_the_marker_by_its_name_is_to_be_made_anew(
    changes: dict[str, Any],
) -> None:
    kept = cases.registration().model_copy(update={"notes": (), "doubt": None} | changes)
    renamed = rename(cases.fiducials(), "F1", "nose")
    assert carried_over(kept, cases.fiducials(), renamed) is kept
    assert "F1, which is no longer there" in (disagreement(renamed, kept) or "")


def test_a_registration_of_other_places_is_not_given_new_names() -> None:
    before, kept = cases.fiducials(), cases.registration()
    moved = before.model_copy(
        update={
            "fiducials": (
                before.fiducials[0].model_copy(update={"center": (1.0, 2.0, 3.0)}),
                *before.fiducials[1:],
            )
        }
    )
    assert carried_over(kept, before, rename(moved, "F1", "nose")) is kept
    assert carried_over(kept, moved, rename(moved, "F1", "nose")) is kept
