"""room.toml: the example is a room, and what is no room is refused by name."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.documents.room import read_room
from ronnaplan.documents.room_example import EXAMPLE
from ronnaplan.errors import InputError
from ronnaplan.robot.placement.room import Parking

TABLES_IN_LISTS = "x = " + ("{" + "a." * 99 + "a = [\n") * 30 + "]}" * 30
"""Three thousand levels, of which no line shows more than a hundred."""


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_the_example_is_read_as_it_is_annotated(tmp_path: Path, encoding: str) -> None:
    """Some editors put a byte order mark before it."""
    (tmp_path / "room.toml").write_text(EXAMPLE, encoding)
    room = read_room(tmp_path / "room.toml")
    assert [box.name for box in room.boxes] == ["table", "patient"]
    assert (room.floor.trolley[0].name, room.capsules[0].radius_mm) == ("trolley", 20)
    assert room.tool.marker is not None
    assert room.parking == Parking()
    np.testing.assert_allclose(room.head.room_from_ct(np.zeros(3))[:3, 1], [0, 0, -1], atol=1e-12)


def test_what_does_not_change_is_told_by_one_number(tmp_path: Path) -> None:
    """As the height of a trolley that is not raised."""
    text = EXAMPLE
    for name, ends, one in (("x", "-1100, 700", -900), ("z", "800, 1000", 860), ("turn_deg", "-180, 180", 30.5)):
        assert f"{name} = [{ends}]" in text
        text = text.replace(f"{name} = [{ends}]", f"{name} = {one}")
    (tmp_path / "room.toml").write_text(text)
    floor = read_room(tmp_path / "room.toml").floor
    assert (floor.x_mm, floor.z_mm, floor.turn_deg) == ((-900, -900), (860, 860), (30.5, 30.5))
    assert floor.y_mm == (-1100, 1100)


def with_arm_body(example: str) -> str:
    """Return the example with the capsule about a link that it shows as a comment."""
    before, after = example.split("# [[arm_body]]")
    return before + "[[arm_body]]" + re.sub("^# ", "", after, flags=re.MULTILINE)


def test_the_example_shows_how_an_arm_of_meshes_is_told(tmp_path: Path) -> None:
    (tmp_path / "room.toml").write_text(with_arm_body(EXAMPLE))
    ((link, body),) = read_room(tmp_path / "room.toml").arm_bodies
    assert (link, body.name, body.end_mm, body.radius_mm) == (2, "upper arm", (455.0, 0.0, 0.0), 95.0)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("version = 1", "version = 2", "version"),
        ("version = 1", "version = true", "version: is no whole number"),
        ("version = 1", "version = 1.0", "version: is no whole number"),
        ("nearest_mm = 950", "nearest = 950", "tracker.nearest: no field"),
        ("x = [-1100, 700]", "x = [700, -1100]", "x goes from 700 to -1100"),
        (
            "z = [800, 1000]",
            "z = [860]",
            "base.z: is a list of 1; expected the least and the greatest, or one number",
        ),
        ("z = [800, 1000]", "z = true", "base.z"),
        ("z = [800, 1000]", "height_mm = 860", "base.height_mm: no field of this document, which lacks base.z"),
        ("z = [800, 1000]", "z = [0.8, 1.0]", "base: z goes from 0.8 to 1 mm; is it in metres"),
        ("z = [800, 1000]", "z = 0.8", "base: trolley would end 799 mm beneath the floor .* in metres"),
        ("x = [-1100, 700]", "x = [-1.1, 0.7]", "base: x goes from -1.1 to 0.7 mm; is it in metres"),
        (
            "start = [0, 0, 120]",
            "start = [0, 0, 0.12]",
            "tool.start: is .* of the flange's middle; is it in metres",
        ),
        ("at = [0, 110, 10]", "at = [0, 0.11, 0.01]", "tool.marker.at: is .* is it in metres"),
        ("tcp = [0, 0, 280]", "tcp = [0, 0, 0.28]", "camera.tcp: is .* is it in metres"),
        ("clearance_mm = 20", "clearance_mm = 0.02", "margins.clearance_mm: is 0.02 mm; is it in metres"),
        ("sigma_mm = 20", "sigma_mm = 0.02", "parking.sigma_mm: is 0.02 mm; is it in metres"),
        ("standoff_mm = 30", "standoff_mm = 0.03", "tool.standoff_mm: is 0.03 mm; is it in metres"),
        ("beam_mm = 30", "beam_mm = 0.03", "tracker.beam_mm: is 0.03 mm; is it in metres"),
        ("farthest_mm = 2400", "farthest_mm = 2.4", "tracker: it sees up to 2.4 mm far; is that in metres"),
        ("center = [0, 0, 1050]", 'center = [0, 0, "1050"]', "head.center.2"),
        ("normal = [0, 1, -1]", "normal = [0, 0, 0]", "points somewhere"),
        ("radius = 20", "radius = 0", "capsule.0.radius"),
        ("# x_axis = [1, 0, 0] ", "x_axis = [0, 1, 1] ", "tool: the tool's x_axis .* are not perpendicular"),
        ("direction = [0, 0, 1]", "direction = [1e-200, 0, 0]", "tool.direction: is .* points somewhere"),
        ("superior = [-1, 0, 0]", "superior = [0, 0, 0]", "head.superior: is .* points somewhere"),
        (
            "superior = [-1, 0, 0]",
            "superior = [-1, 0, 1]",
            r"room\.toml is no room .head: .* are not perpendicular",
        ),
        (
            "standoff_mm = 30",
            "standoff_mm = 100000",
            "tool.standoff_mm: Input should be less than or equal to 1000",
        ),
        (
            "standoff_mm = 50",
            "standoff_mm = 1001",
            "camera.standoff_mm: Input should be less than or equal to 1000",
        ),
        (
            "standoff_mm = 50",
            "standoff_mm = 0",
            "camera.standoff_mm: Input should be greater than or equal to 1",
        ),
        ("nearest_mm = 950", "nearest_mm = 3000", "tracker: it sees from 3000 to 2400 mm; expected farthest_mm"),
        ('name = "patient"', 'name = "table"', "two boxes or capsules have the same name"),
        ('name = "head holder"', 'name = "table"', "two boxes or capsules have the same name"),
        ('name = "trolley"', 'name = "table"', "two boxes or capsules have the same name"),
        ("sigma_mm = 20", "sigma_mm = nan", "sigma_mm|JSON|finite"),
        ("sigma_mm = 20", "sigma_mm = 1979-05-27", "is no room"),
        ("[margins]", "[margins", "is no room"),
        ("size = [1700, 500, 120]", "size = [1.7, 0.5, 0.12]", r"box.0: table is 1.7 mm long; is it in metres\?"),
        (
            "start = [60, -90, 960]\nend = [60, 90, 960]\nradius = 20",
            "start = [0.06, -0.09, 0.96]\nend = [0.06, 0.09, 0.96]\nradius = 0.02",
            r"capsule.0: head holder is 0.22 mm long; is it in metres\?",
        ),
        ("radius = 20", "radius = 0.02", r"capsule.0: head holder has a radius of 0.02 mm; is it in metres\?"),
        (
            "center = [0, 0, 1050]",
            "center = [0, 0, 1.05]",
            r"head.center: is .*, 1.05 mm above the floor; is it in",
        ),
        (
            "[-970, 1340, 1010]",
            "[-0.97, 1.34, 1.01]",
            r"tracker.position: is .*, 1.01 mm above the floor; is it in",
        ),
    ],
)
def test_what_is_no_room_is_refused(old: str, new: str, sentence: str, tmp_path: Path) -> None:
    assert old in EXAMPLE
    (tmp_path / "room.toml").write_text(EXAMPLE.replace(old, new, 1))
    with pytest.raises(InputError, match=sentence):
        read_room(tmp_path / "room.toml")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("x = " + "[" * 20_000, "is no room .it is nested too deeply"),
        (f"x = {'[' * 300}{']' * 300}", "is no room .it is nested too deeply"),
        (TABLES_IN_LISTS, "is no room .it is nested too deeply"),
        (f"version = 1\n{'.'.join('a' * 3_000)} = 1", "is no room .line 2 holds more than 600 dots"),
        (f"x = {{{'.'.join('a' * 3_000)} = 1}}", "is no room .line 1 holds more than 600 dots"),
        ("#" * 300_000, "is larger than 262144 bytes; expected a room"),
    ],
)
def test_what_would_take_a_reader_long_or_down_is_refused(text: str, sentence: str, tmp_path: Path) -> None:
    (tmp_path / "room.toml").write_text(text)
    with pytest.raises(InputError, match=sentence):
        read_room(tmp_path / "room.toml")


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_a_room_of_another_encoding_is_told_to_be_saved_anew(encoding: str, tmp_path: Path) -> None:
    """As editors of some systems save umlauts."""
    (tmp_path / "room.toml").write_text(EXAMPLE.replace("# What", "# W\xe4s"), encoding=encoding)
    with pytest.raises(InputError, match=r"is no room .line 1 is not UTF-8; save it as UTF-8"):
        read_room(tmp_path / "room.toml")
