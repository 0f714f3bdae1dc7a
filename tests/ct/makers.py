"""CT files for tests, made with pydicom: a plain axial head scan, with whatever oddity a test asks for."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydicom import dcmread, dcmwrite
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.uid import UID, CTImageStorage, EnhancedCTImageStorage, ExplicitVRLittleEndian, generate_uid

from ronnaplan.cohort.places import Fetched
from ronnaplan.ct.frames import images_of
from ronnaplan.ct.header import read_header
from ronnaplan.ct.limits import Limits
from ronnaplan.ct.slices import SliceImage, instance_from_header

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
        save(made, folder / f"{prefix}{k:03d}")
    return folder


def save(made: FileDataset, target: Path | BytesIO, syntax: str | None = None) -> None:
    """Write ``made`` in ``syntax`` (its own if None), swapping the pixels' bytes for big endian."""
    if syntax is not None:
        made.file_meta.TransferSyntaxUID = UID(syntax)
    written = made.file_meta.TransferSyntaxUID
    if not written.is_little_endian:
        made = deepcopy(made)
        made.PixelData = np.frombuffer(made.PixelData, "<i2").astype(">i2").tobytes()
    dcmwrite(
        target,
        made,
        implicit_vr=written.is_implicit_VR,
        little_endian=written.is_little_endian,
        enforce_file_format=True,
    )


def compress(made: FileDataset, syntax: str, folder: Path) -> FileDataset:
    """Return ``made`` with its pixels compressed by pydicom, or by GDCM for JPEG."""
    if not UID(syntax).startswith("1.2.840.10008.1.2.4.5") and syntax != "1.2.840.10008.1.2.4.70":
        options: dict[str, dict[str, Any]] = {
            "1.2.840.10008.1.2.4.81": {"jls_error": 2},
            "1.2.840.10008.1.2.4.91": {"j2k_cr": [4]},
        }
        made.compress(syntax, generate_instance_uid=False, **options.get(syntax, {}))
        return made
    import gdcm

    before, after = folder / "before.tmp", folder / "after.tmp"
    made.save_as(before)
    reader, writer = gdcm.ImageReader(), gdcm.ImageWriter()
    reader.SetFileName(str(before))
    change = gdcm.ImageChangeTransferSyntax()
    change.SetTransferSyntax(gdcm.TransferSyntax(gdcm.TransferSyntax.GetTSType(syntax)))
    assert reader.Read()
    change.SetInput(reader.GetImage())
    assert change.Change()
    writer.SetFileName(str(after))
    writer.SetFile(reader.GetFile())
    writer.SetImage(change.GetOutput())
    assert writer.Write()
    content = after.read_bytes()
    before.unlink()
    after.unlink()
    return dcmread(BytesIO(content))


def enhanced(count: int = 4, change: Change | None = None, stacks: int = 1) -> FileDataset:
    """Return one multi-frame file of the same scan; ``change(frame's functional groups, k)`` may alter a frame."""
    made = dataset(0, stored=np.concatenate([pattern(k) for k in range(count)]))
    made.Rows = ROWS
    made.SOPClassUID = made.file_meta.MediaStorageSOPClassUID = EnhancedCTImageStorage
    made.NumberOfFrames = count
    values = Dataset()
    values.RescaleSlope, values.RescaleIntercept, values.RescaleType = 1, -1024, "HU"
    measures = Dataset()
    measures.PixelSpacing, measures.SliceThickness = [0.5, 0.75], 2
    shared = Dataset()
    shared.PixelValueTransformationSequence, shared.PixelMeasuresSequence = [values], [measures]
    made.SharedFunctionalGroupsSequence = [shared]
    made.PerFrameFunctionalGroupsSequence = [_frame_groups(k, k * stacks // count + 1) for k in range(count)]
    for keyword in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing", "SliceThickness"):
        delattr(made, keyword)
    del made.RescaleSlope, made.RescaleIntercept
    if change is not None:
        for k, groups in enumerate(made.PerFrameFunctionalGroupsSequence):
            change(groups, k)
    return made


def _frame_groups(k: int, stack: int) -> Dataset:
    position, orientation, content, groups = Dataset(), Dataset(), Dataset(), Dataset()
    position.ImagePositionPatient = [-10, -20, 30 + 2 * k]
    orientation.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
    content.StackID, content.InStackPositionNumber = str(stack), k + 1
    groups.PlanePositionSequence, groups.PlaneOrientationSequence = [position], [orientation]
    groups.FrameContentSequence = [content]
    return groups


def slice_image(made: FileDataset) -> SliceImage:
    """Return the reader's own record of ``made``."""
    stream = BytesIO()
    save(made, stream)
    blob = Fetched("memory", stream.getvalue())
    (image,) = images_of(instance_from_header(blob, read_header(blob, Limits())))
    return image
