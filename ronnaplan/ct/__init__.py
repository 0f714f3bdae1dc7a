"""From DICOM (or NIfTI, NRRD, MetaImage) files to a `CTVolume` that knows where each voxel is in the patient."""

from ronnaplan.ct.volume import CTVolume, SeriesSource, SliceGrid, VolumeFlag

__all__ = ["CTVolume", "SeriesSource", "SliceGrid", "VolumeFlag"]
