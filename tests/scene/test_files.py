"""Scenes as files hold what was shown, where it was, as other readers read them."""

from __future__ import annotations

import base64
import json
import re
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.cli import main
from ronnaplan.scene.files import gltf, html, stl, vtp
from ronnaplan.scene.shapes import ball
from ronnaplan.scene.things import Thing
from tests import cases

THINGS = [
    Thing("one <b>", ball([10.0, 20.0, 30.0], 5.0), np.array([1.0, 0.5, 0.0])),
    Thing("skin", ball([0.0, 0.0, 0.0], 50.0), np.array([0.2, 0.4, 0.6]), 0.5),
]
VOLUME_MM3 = 4 / 3 * np.pi * (5.0**3 + 50.0**3)


def test_gltf_stands_upright_in_metres() -> None:
    data = gltf(THINGS)
    magic, version, length, first = struct.unpack_from("<4sIII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    told = json.loads(data[20 : 20 + first])
    body = data[20 + first + 8 :]
    assert len(body) == told["buffers"][0]["byteLength"]
    assert [node["name"] for node in told["nodes"][:2]] == ["one <b>", "skin"]
    assert [mesh["name"] for mesh in told["meshes"]] == ["one <b>", "skin"]
    matrix = np.array(told["nodes"][told["scenes"][0]["nodes"][0]]["matrix"]).reshape(4, 4).T
    primitive = told["meshes"][0]["primitives"][0]
    place = told["accessors"][primitive["attributes"]["POSITION"]]
    view = told["bufferViews"][place["bufferView"]]
    places = np.frombuffer(body, "<f4", 3 * place["count"], view["byteOffset"]).reshape(-1, 3)
    middle = matrix @ [*(places.min(axis=0) + places.max(axis=0)) / 2, 1.0]
    assert middle[:3] == pytest.approx([0.010, 0.030, -0.020])  # left, up, front
    assert np.linalg.det(matrix[:3, :3]) > 0
    indices = told["accessors"][primitive["indices"]]
    numbers = np.frombuffer(
        body, "<u4", indices["count"], told["bufferViews"][indices["bufferView"]]["byteOffset"]
    )
    assert numbers.max() == place["count"] - 1
    assert [one.get("alphaMode") for one in told["materials"]] == [None, "BLEND"]


def test_stl_encloses_the_volume() -> None:
    data = stl(THINGS)
    count = struct.unpack_from("<I", data, 80)[0]
    facets = np.frombuffer(data[84:], dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("r", "<u2")])
    assert len(facets) == count
    corners = facets["c"].astype(float)
    enclosed = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert enclosed == pytest.approx(VOLUME_MM3, rel=0.08)


def test_vtk_reads_its_own_format(tmp_path: Path) -> None:
    (tmp_path / "scene.vtp").write_bytes(vtp(THINGS))
    told_of = "m.volume, m.n_points, *m['colours'][0], *m.bounds"
    script = f"import pyvista, sys; m = pyvista.read(sys.argv[1]); print({told_of})"
    command = [sys.executable, "-c", script, str(tmp_path / "scene.vtp")]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert float(told[0]) == pytest.approx(VOLUME_MM3, rel=0.08)
    assert int(told[1]) == sum(len(one.body.vertices_mm) for one in THINGS)
    assert told[2:5] == ["255", "128", "0"]
    assert [float(bound) for bound in told[5:]] == pytest.approx([-50, 50, -50, 50, -50, 50], abs=1.0)


def test_vtk_reads_what_gltf_and_stl_hold(tmp_path: Path) -> None:
    (tmp_path / "scene.glb").write_bytes(gltf(THINGS))
    (tmp_path / "scene.stl").write_bytes(stl(THINGS))
    script = (
        "import pyvista, sys; g = pyvista.read(sys.argv[1]).combine(); s = pyvista.read(sys.argv[2]);"
        "print(g.n_cells, *g.bounds, s.volume, *s.bounds)"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "scene.glb"), str(tmp_path / "scene.stl")]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    cells, *bounds_m, volume = map(float, told[:8])
    assert cells == sum(len(one.body.triangles) for one in THINGS)
    assert bounds_m == pytest.approx([-0.05, 0.05, -0.05, 0.05, -0.05, 0.05], abs=1e-3)
    assert volume == pytest.approx(VOLUME_MM3, rel=0.08)
    assert [float(bound) for bound in told[8:]] == pytest.approx([-50, 50, -50, 50, -50, 50], abs=1.0)


def test_a_page_holds_the_scene_and_names_no_other_host() -> None:
    page = html(THINGS, "case <1>", b"still").decode()
    assert "<title>case &lt;1&gt;</title>" in page
    assert not re.findall(r"https?://", page)
    assert "default-src 'none'" in page
    assert base64.b64encode(b"still").decode() in page
    scene = json.loads(re.findall(r'id="scene">(.*?)</script>', page, re.DOTALL)[0])
    (one, skin) = scene["things"]
    assert (one["name"], skin["opacity"]) == ("one <b>", 0.5)
    shares = np.frombuffer(base64.b64decode(one["places"]), "<u2").reshape(-1, 4)[:, :3] / 65535
    places = np.array(one["low"]) + shares * one["size"]
    assert places == pytest.approx(THINGS[0].body.vertices_mm, abs=0.002)


def test_a_case_is_exported_and_a_wrong_wish_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cases.write_case(tmp_path)
    wish = [
        "export",
        str(tmp_path),
        "--ct",
        str(cases.CT),
        "--series",
        str(cases.volume().source.series_instance_uid),
        "--to",
    ]
    vessel, tumor = (str(cases.write_label_map(tmp_path / f"{name}.nii.gz", 12)) for name in ("vessel", "tumor"))
    assert main([*wish, "gltf", "--no-go", vessel, "--labels", tumor, "-o", str(tmp_path / "scene.glb")]) == 0
    data = (tmp_path / "scene.glb").read_bytes()
    told = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    names = [node["name"] for node in told["nodes"]]
    spreads = names[6:12]
    assert all(re.fullmatch(r"95 % of F\d, \d+ times as large", one) for one in spreads)
    assert names[:-1] == [f"marker F{n}" for n in range(1, 7)] + [
        *spreads,
        "rejected",
        "path left",
        "tube left",
        "no-go vessel",
        "region tumor",
        "skull",
        "skin",
    ]
    assert main([*wish, "gltf"]) == 2
    assert main([*wish, "csv", "-o", str(tmp_path / "x")]) == 2
    assert main(["export", str(tmp_path / "fiducials.json"), "--to", "stl", "-o", str(tmp_path / "x")]) == 2
    assert "case's folder" in capsys.readouterr().err
    for kind, ending in (("gltf", ".glb"), ("stl", ".stl"), ("vtp", ".vtp"), ("html", ".html or .htm")):
        assert main([*wish, kind, "-o", str(tmp_path / "scene.gltf")]) == 2
        assert f"expected a name that ends in {ending}, by which" in capsys.readouterr().err
    assert not (tmp_path / "scene.gltf").exists()


def test_a_scene_without_the_scan_says_that_it_has_no_head(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cases.write_case(tmp_path)
    assert main(["export", str(tmp_path), "--to", "stl", "-o", str(tmp_path / "scene.stl")]) == 0
    assert "no head is shown; give it with --ct" in capsys.readouterr().err
