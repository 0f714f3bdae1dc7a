"""Writing images as a DICOM series of classic CT images, in every variety that readers must cope with."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import UID, CTImageStorage, ExplicitVRLittleEndian, generate_uid

from phantoms.errors import PhantomError
from phantoms.stack import SliceStack

Order = Literal["ascending", "descending", "shuffled"]
Tag = Literal["nominal", "spacing", "pixel", "doubled", "absent"]
"""What the SliceThickness tag says: the nominal thickness, a side of the voxel, something wrong, or nothing."""
TRANSFER_SYNTAXES = {
    "explicit": "1.2.840.10008.1.2.1",
    "implicit": "1.2.840.10008.1.2",
    "deflated": "1.2.840.10008.1.2.1.99",
    "jpeg-ls": "1.2.840.10008.1.2.4.80",
    "jpeg-2000": "1.2.840.10008.1.2.4.90",
    "rle": "1.2.840.10008.1.2.5",
}
"""The (lossless) transfer syntaxes that can be written, by a short name."""
COMPRESSED = ("jpeg-ls", "jpeg-2000", "rle")


@dataclass(frozen=True)
class SeriesOptions:
    """How the series is written; everything that does not change what the scan shows."""

    order: Order = "ascending"
    """Order of file names and instance numbers relative to the acquisition."""
    slope: float = 1.0
    intercept: float = -1024.0
    padding_hu: float | None = None
    """Value outside the circle of reconstruction; None leaves what was reconstructed."""
    transfer_syntax: str = "explicit"
    """A key of `TRANSFER_SYNTAXES`."""
    tag: Tag = "nominal"
    derived: bool = False
    """Whether the images were made from other images (interpolated, reformatted)."""
    write_tilt: bool = True
    """Whether the GantryDetectorTilt tag is present."""
    kernel: str = "FAST"
    kilovolts: float = 120.0
    description: str = "Phantom"
    seed: int = 0
    """Fixes the UIDs and the shuffle."""
    scan: str = field(default="", repr=False)
    """What tells the scan from others that are written so: its UIDs are others, too."""

    def __post_init__(self) -> None:
        if self.transfer_syntax not in TRANSFER_SYNTAXES:
            raise PhantomError(
                f"unknown transfer syntax {self.transfer_syntax!r}; expected one of {', '.join(TRANSFER_SYNTAXES)}"
            )
        if self.slope == 0:
            raise PhantomError("the rescale slope is 0; expected another number")


def tagged_thickness_mm(stack: SliceStack, tag: Tag) -> float | None:
    """Return what a header says of the slices' thickness; None when it says nothing."""
    if tag == "absent":
        return None
    if tag == "spacing":
        return float(np.abs(np.diff(stack.positions_mm)).mean()) if len(stack) > 1 else stack.thickness_mm
    return {"pixel": stack.pixel_mm, "doubled": 2 * stack.thickness_mm}.get(tag, stack.thickness_mm)


def write_series(
    folder: Path, images: NDArray[np.int16], stack: SliceStack, options: SeriesOptions | None = None
) -> None:
    """Write ``images`` (K, rows, columns) in HU to ``folder``, one file a slice."""
    options = options or SeriesOptions()
    count = len(stack)
    numbers = np.arange(count)
    if options.order == "descending":
        numbers = numbers[::-1]
    elif options.order == "shuffled":
        numbers = np.random.default_rng(options.seed).permutation(count)
    origins = stack.origins_mm
    for k, number in enumerate(numbers):
        dataset = _dataset(stack, options, int(number) + 1)
        dataset.ImagePositionPatient = [_decimal(v) for v in origins[k]]
        dataset.SliceLocation = _decimal(float(stack.centers_mm[k] @ stack.normal))
        _set_pixels(dataset, _padded(images[k], options.padding_hu), options)
        dataset.save_as(folder / f"CT{number + 1:04d}.dcm", enforce_file_format=True)


def _dataset(stack: SliceStack, options: SeriesOptions, number: int) -> Dataset:
    """Return everything of one image but its position and pixels."""
    dataset = Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.file_meta.MediaStorageSOPClassUID = CTImageStorage
    dataset.file_meta.MediaStorageSOPInstanceUID = _uid(options, f"image {number}")
    dataset.SpecificCharacterSet = "ISO_IR 192"
    dataset.ImageType = ["DERIVED", "SECONDARY", "MPR"] if options.derived else ["ORIGINAL", "PRIMARY", "AXIAL"]
    dataset.SOPClassUID = CTImageStorage
    dataset.SOPInstanceUID = dataset.file_meta.MediaStorageSOPInstanceUID
    dataset.StudyDate = dataset.SeriesDate = dataset.AcquisitionDate = dataset.ContentDate = "20260101"
    dataset.StudyTime = dataset.SeriesTime = dataset.AcquisitionTime = dataset.ContentTime = "120000"
    dataset.AccessionNumber = dataset.ReferringPhysicianName = ""
    dataset.StudyID = "1"
    dataset.BodyPartExamined = "HEAD"
    dataset.Modality = "CT"
    dataset.Manufacturer = "ronnaplan phantoms"
    dataset.ManufacturerModelName = "simulated scanner"
    dataset.StudyDescription = "Synthetic CT"
    dataset.SeriesDescription = options.description
    dataset.PatientName = "PHANTOM^SYNTHETIC"
    dataset.PatientID = "PHANTOM"
    dataset.PatientBirthDate = dataset.PatientSex = dataset.PositionReferenceIndicator = ""
    dataset.PatientIdentityRemoved = "YES"
    dataset.DeidentificationMethod = "never a patient"
    dataset.StudyInstanceUID = _uid(options, "study")
    dataset.SeriesInstanceUID = _uid(options, "series")
    dataset.FrameOfReferenceUID = _uid(options, "frame")
    dataset.SeriesNumber = dataset.AcquisitionNumber = 1
    dataset.InstanceNumber = number
    dataset.PatientPosition = "HFS"
    dataset.KVP = options.kilovolts
    dataset.ConvolutionKernel = options.kernel
    if options.write_tilt:
        dataset.GantryDetectorTilt = stack.tilt_deg
    tagged = tagged_thickness_mm(stack, options.tag)
    dataset.SliceThickness = None if tagged is None else _decimal(tagged)
    dataset.PixelSpacing = [_decimal(stack.pixel_mm)] * 2
    directions = np.concatenate([stack.column_direction, stack.row_direction])
    dataset.ImageOrientationPatient = [_decimal(v) for v in directions]
    return dataset


def _set_pixels(dataset: Dataset, image: NDArray[np.float64], options: SeriesOptions) -> None:
    stored = np.round((image - options.intercept) / options.slope)
    if stored.min() < -32768 or stored.max() > 32767:
        raise PhantomError(
            f"values from {image.min():g} to {image.max():g} HU do not fit 16 bits with slope {options.slope:g} "
            f"and intercept {options.intercept:g}; choose another rescale"
        )
    dataset.SamplesPerPixel = 1
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.Rows, dataset.Columns = image.shape
    dataset.BitsAllocated = dataset.BitsStored = 16
    dataset.HighBit, dataset.PixelRepresentation = 15, 1
    dataset.RescaleSlope, dataset.RescaleIntercept = _decimal(options.slope), _decimal(options.intercept)
    dataset.RescaleType = "HU"
    dataset.WindowCenter, dataset.WindowWidth = 40, 400
    if options.padding_hu is not None:
        dataset.PixelPaddingValue = round((options.padding_hu - options.intercept) / options.slope)
    dataset.PixelData = stored.astype("<i2").tobytes()
    dataset["PixelData"].VR = "OW"
    if options.transfer_syntax in COMPRESSED:
        dataset.compress(TRANSFER_SYNTAXES[options.transfer_syntax], generate_instance_uid=False)
    else:
        dataset.file_meta.TransferSyntaxUID = UID(TRANSFER_SYNTAXES[options.transfer_syntax])


def _padded(image: NDArray[np.int16], padding_hu: float | None) -> NDArray[np.float64]:
    """Return the image with everything outside its inscribed circle replaced by ``padding_hu``."""
    values = image.astype(np.float64)
    if padding_hu is not None:
        v, u = np.indices(image.shape)
        middle = (np.array(image.shape) - 1) / 2
        values[np.hypot(v - middle[0], u - middle[1]) > min(image.shape) / 2] = padding_hu
    return values


def _decimal(value: float) -> str:
    """Format for a decimal string (DS): at most 16 characters, as many digits as fit."""
    value = float(value)
    for digits in range(12, 0, -1):
        text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
        if len(text) <= 16:
            return "0" if text == "-0" else text
    raise PhantomError(f"{value} does not fit a DICOM decimal string of 16 characters")


def _uid(options: SeriesOptions, role: str) -> UID:
    """Return a UID that depends on the options alone: the same scan is written with the same UIDs."""
    key = zlib.crc32(f"{options!r}{options.scan}".encode())
    return generate_uid(entropy_srcs=["ronnaplan phantoms", str(key), role])
