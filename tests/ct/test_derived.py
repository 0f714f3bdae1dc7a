from pathlib import Path

import pytest
from pydicom.dataset import Dataset

from ronnaplan.ct import VolumeFlag, find_series, read_ct
from ronnaplan.errors import InputError
from tests.ct.makers import enhanced, save, write_series

DERIVED, REFORMATTED, VIRTUAL = VolumeFlag.DERIVED, VolumeFlag.REFORMATTED, VolumeFlag.VIRTUAL_VALUES


@pytest.mark.parametrize(
    ("image_type", "description", "reason"),
    [
        ("DERIVED\\SECONDARY\\AXIAL\\MIP", "", "maximum or minimum intensity projection"),
        ("DERIVED\\SECONDARY\\MPR\\CSA MIP", "", "maximum or minimum intensity projection"),
        ("DERIVED\\SECONDARY\\PROJECTION IMAGE", "", "maximum or minimum intensity projection"),
        ("DERIVED\\PRIMARY\\VOLUME\\MAXIMUM", "", "maximum or minimum intensity projection"),
        ("DERIVED\\SECONDARY\\REFORMATTED", "Head thick MIPs 10 mm", "maximum or minimum intensity projection"),
        ("DERIVED\\SECONDARY\\OTHER\\VRT", "", "a rendered view"),
        ("DERIVED\\SECONDARY\\CURVED_MPR", "", "a curved reformat"),
        ("ORIGINAL\\PRIMARY\\LOCALIZER\\CT_SOM5 TOP", "", "a localizer"),
    ],
)
def test_projections_and_renderings_are_never_slices(
    tmp_path: Path, image_type: str, description: str, reason: str
) -> None:
    def change(made: Dataset, k: int) -> None:
        made.ImageType, made.SeriesDescription = image_type.split("\\"), description

    with pytest.raises(InputError, match=reason):
        read_ct(write_series(tmp_path, change=change))


@pytest.mark.parametrize(
    ("image_type", "description", "flags"),
    [
        ("ORIGINAL\\PRIMARY\\AXIAL", "for MIP and MPR", ()),
        ("ORIGINAL\\PRIMARY\\AXIAL\\CT_SOM5 SPI", "", ()),
        ("DERIVED\\PRIMARY\\AXIAL", "", (DERIVED,)),
        ("ORIGINAL\\SECONDARY\\AXIAL", "", (DERIVED,)),
        ("DERIVED\\SECONDARY\\REFORMATTED\\AVERAGE", "", (DERIVED, REFORMATTED)),
        ("DERIVED\\SECONDARY\\MPR", "", (DERIVED, REFORMATTED)),
        ("DERIVED\\SECONDARY\\AXIAL", "Iodine map", (DERIVED, VIRTUAL)),
        ("DERIVED\\SECONDARY\\AXIAL", "MonoE 40 keV", (DERIVED, VIRTUAL)),
        ("DERIVED\\PRIMARY\\AXIAL\\VMI", "", (DERIVED, VIRTUAL)),
        ("ORIGINAL\\PRIMARY\\AXIAL\\MAT_SPECIFIC", "", (VIRTUAL,)),
        ("DERIVED\\PRIMARY\\AXIAL\\ELECTRON_DENSITY", "", (DERIVED, VIRTUAL)),
    ],
)
def test_what_was_computed_from_other_images_is_flagged(
    tmp_path: Path, image_type: str, description: str, flags: tuple[VolumeFlag, ...]
) -> None:
    def change(made: Dataset, k: int) -> None:
        made.ImageType, made.SeriesDescription = image_type.split("\\"), description

    assert read_ct(write_series(tmp_path, change=change)).flags == flags


def test_one_derived_slice_among_originals_flags_the_volume(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        if k == 3:
            made.ImageType = ["DERIVED", "SECONDARY", "AXIAL"]

    (series,) = find_series(write_series(tmp_path, change=change)).usable
    assert series.notes == (DERIVED,)


def test_frames_that_are_projections_are_refused_and_reformats_flagged(tmp_path: Path) -> None:
    def kind(value: str, technique: str) -> Path:
        def change(groups: Dataset, k: int) -> None:
            frame_type = Dataset()
            frame_type.FrameType = ["DERIVED", "PRIMARY", "VOLUME", value]
            frame_type.VolumeBasedCalculationTechnique = technique
            groups.CTImageFrameTypeSequence = [frame_type]

        path = tmp_path / f"{value} {technique}"
        save(enhanced(4, change), path)
        return path

    for value, technique in (("MAXIMUM", "NONE"), ("NONE", "MAX_IP")):
        with pytest.raises(InputError, match="its frame 1 is a maximum or minimum intensity projection"):
            read_ct(kind(value, technique))
    assert read_ct(kind("NONE", "MPR")).flags == (DERIVED, REFORMATTED)
