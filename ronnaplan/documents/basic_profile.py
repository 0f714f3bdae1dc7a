"""What becomes of each attribute of a DICOM file that is to name nobody (PS3.15, Annex E, basic profile).

Only what is listed here is kept, so that an attribute that nobody thought of, a private one or one of a later edition
of the standard goes, too. `ronnaplan.documents.deidentify` goes by these lists.
"""

from __future__ import annotations

from typing import Final

from ronnaplan.ct.uids import CT_IMAGE, ENHANCED_CT, LEGACY_ENHANCED_CT


def _names(text: str) -> frozenset[str]:
    return frozenset(text.split())


KEPT: Final = _names(
    """
    SpecificCharacterSet ImageType SOPClassUID Modality ConversionType PresentationIntentType
    ReferencedSOPClassUID CodeValue CodingSchemeDesignator CodingSchemeVersion CodeMeaning MappingResource
    LossyImageCompression LossyImageCompressionRatio LossyImageCompressionMethod BodyPartExamined SliceThickness
    KVP DataCollectionDiameter ReconstructionDiameter DistanceSourceToDetector DistanceSourceToPatient
    GantryDetectorTilt TableHeight RotationDirection ExposureTime XRayTubeCurrent Exposure FilterType
    GeneratorPower FocalSpots ConvolutionKernel PatientPosition SpiralPitchFactor TotalCollimationWidth
    SingleCollimationWidth TableSpeed TableFeedPerRotation RevolutionTime ScanOptions AcquisitionNumber
    InstanceNumber SeriesNumber ImagePositionPatient ImageOrientationPatient SliceLocation
    PositionReferenceIndicator ImagesInAcquisition NumberOfTemporalPositions TemporalPositionIdentifier
    TemporalPositionIndex StackID InStackPositionNumber FrameLaterality InConcatenationNumber
    InConcatenationTotalNumber ConcatenationFrameOffsetNumber DimensionIndexValues DimensionIndexPointer
    FunctionalGroupPointer DimensionOrganizationType FrameAcquisitionNumber FrameType PresentationLUTShape
    AcquisitionDuration FrameAcquisitionDuration ContentQualification MultienergyCTAcquisition AcquisitionType
    TubeAngle ConstantVolumeFlag FluoroscopyFlag TablePosition DataCollectionCenterPatient
    ReconstructionTargetCenterPatient DistanceSourceToDataCollectionCenter ConvolutionKernelGroup
    ReconstructionFieldOfView ReconstructionPixelSpacing ReconstructionAngle ImageFilter ExposureTimeInms
    XRayTubeCurrentInmA ExposureInmAs ExposureModulationType EstimatedDoseSaving CTDIvol FilterMaterial
    PixelPresentation VolumetricProperties VolumeBasedCalculationTechnique ReconstructionAlgorithm
    SamplesPerPixel PhotometricInterpretation PlanarConfiguration NumberOfFrames Rows Columns PixelSpacing
    PixelAspectRatio BitsAllocated BitsStored HighBit PixelRepresentation SmallestImagePixelValue
    LargestImagePixelValue PixelPaddingValue PixelPaddingRangeLimit BurnedInAnnotation WindowCenter WindowWidth
    RescaleIntercept RescaleSlope RescaleType FloatPixelPaddingValue DoubleFloatPixelPaddingValue PixelData
    FloatPixelData DoubleFloatPixelData FrameOfReferenceTransformationMatrixType
    FrameOfReferenceTransformationMatrix ShapeType NumberOfContourPoints ContourData ContourUncertaintyRadius
    """
)
"""Attributes that stay as they are: what images show and where, how they were made."""

ENTERED: Final = _names(
    """
    SharedFunctionalGroupsSequence PerFrameFunctionalGroupsSequence PlanePositionSequence
    PlaneOrientationSequence PixelMeasuresSequence PixelValueTransformationSequence FrameContentSequence
    CTImageFrameTypeSequence CTReconstructionSequence CTXRayDetailsSequence ModalityLUTSequence
    FrameVOILUTSequence DimensionOrganizationSequence DimensionIndexSequence FiducialSetSequence
    FiducialSequence RegistrationSequence MatrixRegistrationSequence MatrixSequence FrameAnatomySequence
    AnatomicRegionSequence RegistrationTypeCodeSequence IrradiationEventIdentificationSequence
    CTAcquisitionTypeSequence CTAcquisitionDetailsSequence CTTableDynamicsSequence CTPositionSequence
    CTGeometrySequence CTExposureSequence CTDIPhantomTypeCodeSequence
    """
)
"""Sequences whose items are treated likewise."""

EMPTIED: Final = _names(
    "UnassignedSharedConvertedAttributesSequence UnassignedPerFrameConvertedAttributesSequence"
)
"""Sequences that an object that had them must have, with an empty item: what else a legacy conversion found."""

REPLACED: Final = _names(
    """
    SOPInstanceUID StudyInstanceUID SeriesInstanceUID FrameOfReferenceUID ReferencedSOPInstanceUID
    DimensionOrganizationUID ConcatenationUID SOPInstanceUIDOfConcatenationSource FiducialUID
    ReferencedFrameOfReferenceUID IrradiationEventUID
    """
)
"""UIDs that get a new one."""

EMPTY: Final = (
    *("StudyDate", "StudyTime", "AccessionNumber", "ReferringPhysicianName", "StudyID"),
    *("PatientBirthDate", "PatientSex"),
)
"""What every object must have and here has nothing in."""

CONTENT: Final = ("ContentDescription", "ContentCreatorName", "AcquisitionContextSequence")
"""What an object that had it must have, with nothing in it."""

DUMMIES: Final = {
    "ContentDate": "19000101",
    "ContentTime": "000000",
    "AcquisitionDateTime": "19000101000000",
    "FrameAcquisitionDateTime": "19000101000000",
    "FrameReferenceDateTime": "19000101000000",
    "Manufacturer": "DEIDENTIFIED",
    "ManufacturerModelName": "DEIDENTIFIED",
    "DeviceSerialNumber": "DEIDENTIFIED",
    "SoftwareVersions": "DEIDENTIFIED",
    "ContentLabel": "DEIDENTIFIED",
    "FiducialIdentifier": "F",
}
"""What an object that had it must have, with something in it: this, and fiducials are numbered."""

TAKEN: Final = {
    *(CT_IMAGE, ENHANCED_CT, LEGACY_ENHANCED_CT),
    *("1.2.840.10008.5.1.4.1.1.66.1", "1.2.840.10008.5.1.4.1.1.66.2"),
}
"""Classes whose attributes are known here: CT, Spatial Registration, Spatial Fiducials."""
