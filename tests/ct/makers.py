"""CT files for tests, made with pydicom: a plain axial head scan, with whatever oddity a test asks for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.uid import UID, CTImageStorage, ExplicitVRLittleEndian, generate_uid

ROWS, COLUMNS = 8, 10
STUDY, SERIES, FRAME = "1.2.3.1", "1.2.3.2", "1.2.3.3"
Change = Callable[[Dataset, int], None]


def pattern(k: int, rows: int = ROWS, columns: int = COLUMNS) -> NDArray[np.int16]:
    """Return stored values (J, I) that differ in every voxel and slice."""
    return (np.arange(rows * columns, dtype=np.int16).reshape(rows, columns) + 100 * k).astype(np.int16)


def dataset(
    k: int, *, stored: NDArray[np.generic] | None = None, syntax: UID = ExplicitVRLittleEndian
) -> FileDataset:
    """Return slice ``k`` of a scan with 0.5 x 0.75 mm pixels every 2 mm, HU = stored - 1024."""
    pixels = pattern(k) if stored is None else stored
    meta = FileMetaDataset()
    meta.TransferSyntaxUID = syntax
    meta.MediaStorageSOPClassUID = CTImageStorage
    meta.MediaStorageSOPInstanceUID = generate_uid(entropy_srcs=[str(k)])
    made = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    made.SOPClassUID, made.SOPInstanceUID = CTImageStorage, meta.MediaStorageSOPInstanceUID
    made.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
    made.Modality, made.PatientName, made.SeriesDescription = "CT", "Doe^Jane", "Head 2 mm"
    made.StudyInstanceUID, made.SeriesInstanceUID, made.FrameOfReferenceUID = STUDY, SERIES, FRAME
    made.SliceThickness, made.ConvolutionKernel = 2, "H30"
    made.AcquisitionNumber, made.InstanceNumber = 1, k + 1
    made.ImagePositionPatient = [-10, -20, 30 + 2 * k]
    made.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
    made.PixelSpacing = [0.5, 0.75]
    made.SamplesPerPixel, made.PhotometricInterpretation = 1, "MONOCHROME2"
    made.Rows, made.Columns = pixels.shape
    made.BitsAllocated = made.BitsStored = 8 * pixels.dtype.itemsize
    made.HighBit, made.PixelRepresentation = made.BitsStored - 1, int(pixels.dtype.kind == "i")
    made.RescaleSlope, made.RescaleIntercept = 1, -1024
    made.PixelData = pixels.tobytes()
    made["PixelData"].VR = "OW" if pixels.dtype.itemsize > 1 else "OB"
    return made


def write_series(folder: Path, count: int = 4, change: Change | None = None, prefix: str = "") -> Path:
    """Write ``count`` slices, each after ``change(dataset, k)``, and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(count):
        made = dataset(k)
        if change is not None:
            change(made, k)
        made.save_as(folder / f"{prefix}{k:03d}", enforce_file_format=True)
    return folder
