"""ITK transform files (.tfm), with 3D Slicer's conventions.

ITK works in LPS and its transforms map points of the *fixed* (output) space to the *moving* one; Slicer, reading a
.tfm, takes it as "from parent". A file that should move CT data into the tracker's space in Slicer therefore holds
``ct_from_ots``, the inverse of what is applied to points. See Slicer's documentation, "Transforms: file formats".
"""

from __future__ import annotations

from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import invert

HEADER = "#Insight Transform File V1.0"


def itk_transform(document: RegistrationDocument) -> str:
    """Return the registration as .tfm text: loaded in Slicer and put on the CT, it shows the CT in tracker space.

    Read with ITK or SimpleITK, the transform maps tracker points to CT points.
    """
    return tfm(invert(document.pose.matrix))


def tfm(moving_from_fixed: FloatArray) -> str:
    """Return ITK's text for the rigid ``moving_from_fixed`` (4, 4), in LPS mm, centered on the origin."""
    numbers = [*moving_from_fixed[:3, :3].ravel(), *moving_from_fixed[:3, 3]]
    lines = (
        HEADER,
        "#Transform 0",
        "Transform: AffineTransform_double_3_3",
        "Parameters: " + " ".join(repr(float(number)) for number in numbers),
        "FixedParameters: 0 0 0",
        "",
    )
    return "\n".join(lines)
