from __future__ import annotations

from pathlib import Path

import pytest

from phantoms.errors import PhantomError
from phantoms.scene_file import read_scene

WHOLE = """
name = "everything"
seed = 4

[head]
size = 0.95
infusion_tube = true
ear_rings = true
lifelike = true
hair = true
braces = true
dental_metal = [2, 9]
electrodes = [[-0.95, 0.1, 0.1]]

[[part]]
shape = "sphere"
center = [0, 10, 50]
diameter = 20
material = "water"

[[part]]
shape = "box"
center = [0, 10, 50]
size = [4, 5, 6]
direction = [1, 1, 0]
material = "acrylic"

[[part]]
shape = "sphere"
center = [110, 0, 60]
diameter = 10
material = "ceramic"
marker = "C1"

[[part]]
shape = "cone"
start = [115, -40, 20]
direction = [1, 0, 0]
length = 10
diameter = 8
material = "nylon"

[[part]]
shape = "cylinder"
start = [-120, -60, 20]
direction = [0, 0, 1]
length = 30
diameter = 4
material = "steel"

[[part]]
shape = "ellipsoid"
center = [-125, -30, 60]
semi_axes = [4, 5, 8]
material = "PEEK"

[[part]]
shape = "half-space"
point = [0, 190, 0]
outward = [0, -1, 0]
material = "water"

[[marker]]
label = "M1"
direction = [0.5, -0.6, 0.6]

[[marker]]
label = "M2"
kind = "steel"
place = [-120, 40, 40]
outward = [-1, 0, 0]

[[frame]]
direction = [-0.1, -0.3, 0.95]

[[decoy]]
kind = "capsule"
direction = [-0.8, -0.1, 0.5]

[scan]
spacing = 0.5
thickness = 1.0
tilt = 5
field_of_view = 300

[scanner]
kernel = "bone"
dose = 0.5
"""

MINIMAL = """
[[part]]
shape = "sphere"
center = [0, 0, 0]
diameter = 30
material = "water"

[scan]
start = -5
stop = 5
"""


@pytest.fixture
def write(tmp_path: Path):  # type: ignore[no-untyped-def]
    def write(text: str) -> Path:
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_whole_scene_is_read(write) -> None:  # type: ignore[no-untyped-def]
    examination = read_scene(write(WHOLE))
    assert [one.label for one in examination.scene.markers] == ["C1", "X1", "X2", "X3", "X4", "M1", "M2"]
    assert [one.kind for one in examination.scene.decoys] == ["eye"] * 2 + ["calcification"] * 3 + ["capsule"]
    assert (examination.scene.name, examination.seed) == ("everything", 4)
    assert (examination.stack.thickness_mm, examination.stack.tilt_deg) == (1.0, 5.0)
    assert (examination.scanner.kernel, examination.scanner.dose) == ("bone", 0.5)
    assert examination.stack.holds_whole(examination.scene.markers[0].center_mm, 10)


@pytest.mark.parametrize(
    ("broken", "sentence"),
    [
        (MINIMAL.replace('"water"', '"watre"'), "unknown material 'watre'; expected one of"),
        (MINIMAL.replace('"sphere"', '"spere"'), "part.0: input tag 'spere'"),
        (MINIMAL.replace("diameter = 30", "radius = 15"), r"part.0.sphere.diameter: field required"),
        (MINIMAL + "slices = 5\n", "scan.slices: no such key; see docs"),
        (MINIMAL.replace("30", "-3"), "diameter: input should be greater than 0"),
        (MINIMAL.replace("stop = 5", ""), "no marker to scan around; give 'start' and 'stop'"),
        (MINIMAL.replace("stop = 5", "stop = -9"), "no slice lies between"),
        (MINIMAL + '[scanner]\nkernel = "sharp"\n', "unknown kernel 'sharp'; expected one of very soft"),
        (MINIMAL + '[[marker]]\nlabel = "M1"\n', "needs either 'direction', or both 'place' and 'outward'"),
        (MINIMAL + '[[marker]]\nlabel = "M1"\nkind = "wax"\ndirection = [0, 0, 1]\n', "unknown marker kind 'wax'"),
        (MINIMAL + '[[decoy]]\nkind = "egg"\ndirection = [0, 0, 1]\n', "unknown decoy 'egg'"),
        ("name = ", "is not TOML"),
        ("x = " + "[" * 20_000, "is nested too deeply; expected a scene file"),
        (f"x = {'[' * 300}{']' * 300}", "is nested too deeply; expected a scene file"),
        ("x = " + ("{" + "a." * 99 + "a = [\n") * 30 + "]}" * 30, "is nested too deeply; expected a scene file"),
        (f"{'.'.join('a' * 3_000)} = 1", "has a line of more than 600 dots; expected a scene file"),
        ("#" * 300_000, "is larger than 262144 bytes; expected a scene file"),
        ("", "empty"),
    ],
)
def test_a_faulty_scene_gets_one_clear_sentence(write, broken: str, sentence: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(PhantomError, match=sentence) as caught:
        read_scene(write(broken))
    assert "scene.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(PhantomError, match=r"cannot read .*none\.toml"):
        read_scene(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("there", "instead"),
    [
        ("diameter = 20", 'diameter = "20"'),
        ("diameter = 20", "diameter = true"),
        ("diameter = 20", "diameter = nan"),
        ("diameter = 20", "diameter = 2030-01-31"),
        ("center = [0, 10, 50]", 'center = "123"'),
        ("center = [0, 10, 50]", "center = [inf, 10, 50]"),
        ("center = [0, 10, 50]", 'center = ["0", 10, 50]'),
        ("seed = 4", "seed = true"),
        ("hair = true", "hair = 1"),
    ],
)
def test_nothing_passes_for_what_it_is_not(there: str, instead: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(WHOLE.replace(there, instead, 1))
    with pytest.raises(PhantomError, match=there.split(" ", maxsplit=1)[0]):
        read_scene(path)
