"""Readings files that tests write."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


AWAY = np.eye(4)
"""A pose that can have been measured, unlike the identity; of numbers that four bytes hold."""
AWAY[:3, 3] = 10, -20, -1500


def turned(k: int) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0.1 * k, 0.5, -0.3]).as_matrix()
    matrix[:3, 3] = 10 * k, -20, -1500
    return matrix


def matrix_rows(first: int, rows: int) -> str:
    names = [f"m{r}{c}" for r in range(first, first + rows) for c in range(first, first + 4)]
    lines = [
        f"{1378476416922755200 + k * 10**9}," + ",".join(map(repr, turned(k)[:rows].ravel().tolist()))
        for k in range(3)
    ]
    return "\n".join(["timestamp_ns," + ",".join(names), *lines])


NDI = (
    "#Tools,ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,#Markers,State,Tx,Ty,Tz\n"
    "1,8700339 s/n:1,100,0A,0,OK,0.5,0.5,0.5,0.5,10,20,-1000,0.12,4,"
    "OK,1,2,3,OK,4,5,6,Missing,,,,OutOfVolume,7,8,9\n"
    "1,8700339 s/n:1,101,0A,0,Missing,,,,,,,,,4,OK,1,2,3,OK,4,5,6,OK,7,8,9,OK,1,1,1\n"
)


def sequence(frames: list[tuple[str, str]]) -> str:
    lines = ["ObjectType = Image", "NDims = 3", "DimSize = 1 1 2", "ElementType = MET_UCHAR"]
    for k, (matrix, status) in enumerate(frames):
        lines += [
            f"Seq_Frame{k:04d}_StylusToTrackerTransform = {matrix}",
            f"Seq_Frame{k:04d}_StylusToTrackerTransformStatus = {status}",
            f"Seq_Frame{k:04d}_Timestamp = {0.05 * k}",
        ]
    return "\n".join([*lines, "ElementDataFile = LOCAL", ""])


def plus(matrix: np.ndarray) -> str:
    return " ".join(f"{value:.6g}" for value in matrix.ravel())


def as_nrrd(text: str) -> str:
    fields = [line.replace(" = ", ":=") for line in text.splitlines() if line.startswith("Seq_Frame")]
    head = [
        "NRRD0004",
        "# a comment",
        "type: uchar",
        "dimension: 4",
        "sizes: 1 1 1 2",
        "kinds: domain domain domain list",
    ]
    return "\n".join([*head, "encoding: raw", *fields, "", "\0\0"])


POINT = '{"label": "F", "position": [1, 2, 3], "positionStatus": "defined"}'
MARKUPS = f'{{"markups": [{{"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": [{POINT}]}}]}}'
