"""From DICOM (or NIfTI, NRRD, MetaImage) files to a `CTVolume` that knows where each voxel is in the patient."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
