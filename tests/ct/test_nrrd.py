"""NRRD headers, changed field by field; SimpleITK's own reading is the independent check of what is sound."""

import bz2
import gzip
from pathlib import Path

import numpy as np
import pytest
import SimpleITK

from ronnaplan.ct import read_ct
from ronnaplan.errors import InputError
from tests.ct.test_images import VOXELS, changed, places, write

CORNERS = np.array([[0, 0, 0], [3, 0, 0], [0, 7, 0], [0, 0, 9], [3, 7, 9]], dtype=float)


def header_and_voxels(path: Path) -> tuple[bytes, bytes]:
    header, _, voxels = write(path).read_bytes().partition(b"\n\n")
    return header, voxels


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"space: left-posterior-superior", b"space dimension: 3", "gives the space 'none'"),
        (b"kinds:", b'space units\xa0: "cm" "cm" "cm"\nkinds:', "expected a name in printable ASCII"),
        (b"sizes: 10 8", "sizes: 10\u20038".encode(), "as its sizes, expected 3 whole numbers"),
        (b"sizes: 10 8", b"sizes: 10\x1c8", "as its sizes, expected 3 whole numbers"),
        (b"space: left-posterior-superior", b"space: scanner-xyz", "gives the space 'scanner-xyz'"),
        (
            b"kinds:",
            b'space units: "cm" "cm" "cm"\nkinds:',
            r"its space units are .*, expected \"mm\" three times",
        ),
        (b"kinds:", b'space units: "m" "m" "m"\nkinds:', "its space units are"),
        (b"kinds:", b'space units: "mm" "mm"\nkinds:', "its space units are"),
        (b"kinds:", b"space units: mm mm mm\nkinds:", "its space units are"),
        (b"kinds:", b"spacings: 1 1 1\nkinds:", "'spacings' beside its space directions"),
        (b"kinds:", b"axis mins: 0 0 0\nkinds:", "'axis mins' beside its space directions"),
        (b"kinds:", b'units: "cm" "cm" "cm"\nkinds:', "'units' beside its space directions"),
        (b"kinds:", b'sample units: "Gy"\nkinds:', "its values are in 'Gy'"),
        (b"kinds:", b"old min: 0\nkinds:", "quantized"),
        (b"kinds: domain domain domain", b"kinds: domain domain time", "'time', not places in space"),
        (b"kinds:", b"space dimension: 2\nkinds:", "its space has '2' dimensions"),
        (b"kinds:", b"modality:=DWMRI\nkinds:", "its modality is DWMRI, not CT"),
        (b"kinds:", b"DICOM_0008_0060_Modality:=PT\nkinds:", "its modality is PT, not CT"),
        (
            b"kinds:",
            b"ITK_non_uniform_sampling_deviation:=1.35714\nkinds:",
            "unevenly spaced, off by up to 1.36 mm",
        ),
        (b"kinds:", b"ITK_non_uniform_sampling_deviation:=x\nkinds:", "expected 1 number"),
        (b"kinds:", b"modality: MR\nkinds:", "the field 'modality', which the format does not know"),
        (b"kinds:", b"space: RAS\nkinds:", "gives 'space' twice"),
        (b"kinds:", b"Dimension: 3\nkinds:", "gives 'dimension' twice"),
        (b"kinds:", b"nonsense\nkinds:", "has the line 'nonsense'"),
        (b"kinds:", b"semicolons; too\nkinds:", "'semicolons; too', expected 'field: value'"),
        (
            b"kinds:",
            b'sample units: "Gy;1"\nkinds:',
            r"in 'Gy;1', not in Hounsfield units",
        ),
        (b"NRRD0004", b"NRRD0009", "not an NRRD file"),
        (b"type: short", b"type: block", "its type is 'block'"),
        (b"endian: little", b"endian: middle", "its endian is 'middle'"),
        (b"endian: little\n", b"", "gives no endian"),
        (b"encoding: raw", b"encoding: hex", "its encoding is 'hex'"),
        (b"encoding: raw", b"encoding: raw\nbyte skip: 2", "cannot be read to its end"),
        (b"encoding: raw", b"encoding: raw\nline skip: 2", "skips 2 lines"),
        (b"encoding: raw", b"encoding: gzip", "cannot be read to its end"),
        (b"encoding: raw", b"encoding: raw\ndata file: LIST", "in several files"),
        (b"encoding: raw", b"encoding: raw\ndata file: a%03d.raw 1 4 1", "in several files"),
        (b"sizes: 10 8 4", b"sizes: 10 8", "expected 3 whole numbers"),
        (b"sizes: 10 8 4", b"sizes: 10 8 5", "cannot be read to its end"),
        (b"sizes: 10 8 4", b"sizes: 10 8 3", "its header declares 480"),
        (b"sizes: 10 8 4", b"sizes: 1e1 8 4", "expected 3 whole numbers"),
        (b"sizes: 10 8 4", "sizes: ١٠ 8 4".encode(), "expected 3 whole numbers"),
        (b"dimension: 3", b"dimension: 03x", "expected 1 whole number"),
        (b"(-10,-20,30)", b"(-10,-20,nan)", "as its space origin, expected 1 number"),
        (b"(-10,-20,30)", b"(-10,-20)", r"space origin, expected 1 of \(x,y,z\)"),
        (b"(0,0,2)", b"none", r"space directions, expected 3 of \(x,y,z\)"),
        (b"(0,0,2)", b"(0,0,1_0)", "as its space directions"),
        (b"(0,0,2)", b"(0,0,inf)", "as its space directions"),
        (b"(0,0,2)", b"(0,0,0)", "expected 0.01 to 100"),
    ],
)
def test_a_header_that_leaves_a_voxel_or_a_value_open_is_refused(
    tmp_path: Path, old: bytes, new: bytes, reason: str
) -> None:
    with pytest.raises(InputError, match=f"{reason}.*; (convert|copy|give|state|use) "):
        read_ct(changed(tmp_path / "head.nrrd", old, new))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"kinds:", b'space units: "mm" "mm" "mm"\nkinds:'),
        (b"kinds:", b'sample units: "HU"\nkinds:'),
        (b"kinds:", b"modality:=CT\nkinds:"),
        (b"kinds:", b"DICOM_0008_0060_Modality:=CT\nkinds:"),
        (b"kinds:", b"ITK_non_uniform_sampling_deviation:=0.00521739\nkinds:"),
        (b"kinds:", b"# a comment: of any kind\nkinds:"),
        (b"kinds:", b"spacings: nan nan nan\nkinds:"),
        (b"type: short", b"TYPE: signed short int"),
        (b"encoding: raw", b"encoding: raw\nbyte skip: -1"),
        (b"encoding: raw", b"encoding: raw\nbyteskip: -1"),
        (b"left-posterior-superior", b"LPS"),
    ],
)
def test_what_the_format_allows_is_read(tmp_path: Path, old: bytes, new: bytes) -> None:
    volume = read_ct(changed(tmp_path / "head.nrrd", old, new))
    assert np.array_equal(volume.voxels_hu, VOXELS)
    assert np.allclose(volume.grid.positions_mm(np.array([3.0, 2, 1])), [-10 + 0.75, -20 + 1, 36])


@pytest.mark.parametrize(("name", "pack"), [("gzip", gzip.compress), ("bz2", bz2.compress)])
def test_packed_voxels_are_read_to_their_checksum(tmp_path: Path, name: str, pack: object) -> None:
    header, voxels = header_and_voxels(tmp_path / "head.nrrd")
    packed = pack(voxels)  # type: ignore[operator]
    path = tmp_path / "packed.nrrd"
    path.write_bytes(header.replace(b"raw", name.encode()) + b"\n\n" + packed)
    assert np.array_equal(read_ct(path).voxels_hu, VOXELS)
    for broken in (packed[:-5], packed[:50] + bytes([packed[50] ^ 0x55]) + packed[51:], pack(voxels[:-2])):  # type: ignore[operator]
        path.write_bytes(header.replace(b"raw", name.encode()) + b"\n\n" + broken)
        with pytest.raises(InputError, match="cannot be read to its end"):
            read_ct(path)
    path.write_bytes(header.replace(b"raw", name.encode()) + b"\n\n" + pack(voxels + b"ab"))  # type: ignore[operator]
    with pytest.raises(InputError, match="more voxels than its header declares"):
        read_ct(path)


@pytest.mark.parametrize("between", [b"", b"\0" * 100])
def test_gzip_of_several_members_is_read(tmp_path: Path, between: bytes) -> None:
    header, voxels = header_and_voxels(tmp_path / "head.nrrd")
    path = tmp_path / "packed.nrrd"
    packed = between.join(gzip.compress(part) for part in (voxels[:101], voxels[101:102], voxels[102:]))
    path.write_bytes(header.replace(b"raw", b"gzip") + b"\n\n" + packed + between)
    assert np.array_equal(read_ct(path).voxels_hu, VOXELS)


def test_a_detached_header_finds_its_voxels_beside_it(tmp_path: Path) -> None:
    header, voxels = header_and_voxels(tmp_path / "head.nrrd")
    (tmp_path / "other.raw").write_bytes(b"12345" + voxels)
    path = tmp_path / "head.nhdr"
    path.write_bytes(header + b"\nbyteskip: 5\ndatafile: other.raw\n")
    volume = read_ct(path)
    assert np.array_equal(volume.voxels_hu, VOXELS)
    assert np.array_equal(volume.voxels_hu, SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(path))))
    assert np.allclose(volume.grid.positions_mm(CORNERS), places(path, CORNERS), atol=1e-4)


def test_big_endian_voxels_are_read(tmp_path: Path) -> None:
    header, voxels = header_and_voxels(tmp_path / "head.nrrd")
    path = tmp_path / "big.nrrd"
    path.write_bytes(
        header.replace(b"little", b"big") + b"\n\n" + np.frombuffer(voxels, "<i2").byteswap().tobytes()
    )
    assert np.array_equal(read_ct(path).voxels_hu, VOXELS)


def test_the_tilt_of_a_sheared_nrrd_is_kept(tmp_path: Path) -> None:
    path = write(tmp_path / "head.nrrd", direction=np.eye(3))
    path.write_bytes(path.read_bytes().replace(b"(0,0,2)", b"(0,0.5,2)"))
    grid = read_ct(path).grid
    assert np.allclose(grid.positions_mm(np.array([3.0, 0, 0])), [-10, -18.5, 36])
    assert grid.tilt_deg == pytest.approx(np.degrees(np.arctan2(0.5, 2)))


def test_right_anterior_superior_nrrd_is_turned_to_lps(tmp_path: Path) -> None:
    path = write(tmp_path / "head.nrrd", direction=np.eye(3))
    path.write_bytes(path.read_bytes().replace(b"left-posterior-superior", b"right-anterior-superior"))
    assert np.allclose(read_ct(path).grid.positions_mm(np.array([0, 2, 1.0])), [10 - 0.75, 20 - 1.0, 30])


def test_spacings_without_directions_leave_the_orientation_open(tmp_path: Path) -> None:
    path = changed(tmp_path / "head.nrrd", b"space directions:", b"spacings: 1 1 1\n# no")
    path.write_bytes(path.read_bytes().replace(b"space: left-posterior-superior\n", b""))
    with pytest.raises(InputError, match="gives the space 'none'"):
        read_ct(path)
