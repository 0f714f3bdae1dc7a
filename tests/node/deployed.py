"""Kills a node that runs as it is deployed, in a container or by systemd, amid scans, and counts what was lost.

    python -m tests.node.deployed FOLDER --kill COMMAND [--start COMMAND] [--series 6]

The node has the configuration that ``ronnaplan node --init`` writes, but for the addresses (and the answer "pdf", where
there is no Chromium), and keeps its scans in FOLDER, seen from here. `data/synthetic_ct` is sent as so many series of
as many patients, each of which says how many instances it has; amid each one command kills the node, and the other
starts it again, where nothing else does. In the end each instance that was acknowledged must lie in the folder with its
pixels, and each series must have been answered exactly once: one object of each kind, with the markers of the scan.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from pydicom import Dataset, dcmread
from pydicom.uid import UID, CTImageStorage, JPEGLSLossless, SpatialFiducialsStorage, generate_uid
from pynetdicom import AE

from ronnaplan import localize, read_ct
from tests.node.killing import send_all
from tests.node.peers import Archive

SCAN = Path("data/synthetic_ct")
DIAMETER_MM = 11.5
KILLED_WITHIN_S = 2.0
"""Of when the first instance is sent; less than sending takes."""

WAIT_S = 300.0
"""For the next answer."""

SECOND_ANSWER_S = 10.0
"""Within which a second answer would come, which there must not be."""

CLOSE_MM = 1e-3
"""Another machine's arithmetic moves a marker less."""


def scan_of(patient: int) -> list[Any]:
    """Return the scan as another patient's."""
    files = [dcmread(path) for path in sorted(SCAN.glob("*.dcm"))]
    study, series = generate_uid(), generate_uid()
    for number, made in enumerate(files, start=1):
        made.PatientID, made.StudyInstanceUID, made.SeriesInstanceUID = f"P{patient}", study, series
        made.SOPInstanceUID = made.file_meta.MediaStorageSOPInstanceUID = UID(f"{series[:56]}.{number}")
        made.NumberOfSeriesRelatedInstances = len(files)
    return files


def sha256_of(made: Dataset) -> str:
    return hashlib.sha256(made.PixelData).hexdigest()


def fault(answers: list[Dataset], kinds: int, centers_mm: np.ndarray) -> str | None:
    """Return what is wrong with a study's answers."""
    classes = {str(one.SOPClassUID) for one in answers}
    if len(answers) != kinds or len(classes) != kinds:
        return f"{len(answers)} answers of {len(classes)} kinds"
    (made,) = (one for one in answers if one.SOPClassUID == SpatialFiducialsStorage)
    points = [one.ContourData for one in made.FiducialSetSequence[0].FiducialSequence]
    if np.shape(points) != centers_mm.shape or np.abs(np.array(points, float) - centers_mm).max() > CLOSE_MM:
        return "other markers"
    return None


def main() -> int:
    """Send, kill, wait; print what was found and return 1 where something was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kill", required=True)
    parser.add_argument("--start", default="true")
    parser.add_argument("--series", type=int, default=6)
    parser.add_argument("--kinds", type=int, default=3)
    parser.add_argument("--port", type=int, default=11112)
    parser.add_argument("--archive", type=int, default=4242)
    parser.add_argument("--listen", default="127.0.0.1")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    chance = random.Random(given.seed)
    centers_mm = localize(read_ct(SCAN), diameter_mm=DIAMETER_MM).centers
    archive = Archive("ORTHANC", lambda made: str(made.StudyInstanceUID), given.listen, given.archive)
    entity = AE("CT1")
    entity.add_requested_context(CTImageStorage, JPEGLSLossless)

    def strike() -> None:
        subprocess.run(given.kill, shell=True, check=True, stdout=subprocess.DEVNULL)
        subprocess.run(given.start, shell=True, check=True, stdout=subprocess.DEVNULL)

    acknowledged: dict[str, str] = {}
    studies = []
    for patient in range(given.series):
        scan = scan_of(patient)
        studies.append(str(scan[0].StudyInstanceUID))
        killer = threading.Timer(chance.uniform(0.0, KILLED_WITHIN_S), strike)
        killer.start()
        for made in send_all(entity, given.port, scan):
            acknowledged[str(made.SOPInstanceUID)] = sha256_of(made)
        killer.join()
    archive.wait_for(given.series, given.kinds, WAIT_S)
    time.sleep(SECOND_ANSWER_S)
    archive.stop()
    faults = {study: fault([*archive.got.get(study, {}).values()], given.kinds, centers_mm) for study in studies}
    wrong = [f"study {study}: {what}" for study, what in faults.items() if what is not None]
    kept = {
        str(made.SOPInstanceUID): sha256_of(made)
        for made in map(dcmread, (given.folder / "instances").rglob("*.dcm"))
    }
    wrong += [
        f"acknowledged instance {uid} is not there" for uid, sha in acknowledged.items() if kept.get(uid) != sha
    ]
    told = {"killed": given.series, "acknowledged": len(acknowledged), "answers": archive.count(), "wrong": wrong}
    print(json.dumps(told))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
