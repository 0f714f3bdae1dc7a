"""Results show themselves in a line, a table, a picture and a notebook, and wrong types end in one sentence."""

from __future__ import annotations

import base64
import importlib
import inspect
import logging
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Annotation

import ronnaplan
from ronnaplan import (
    CTVolume,
    Fiducials,
    Pairing,
    Registration,
    Trajectory,
    describe_layout,
    localize,
    match_points,
    read_ct,
    register_markers,
    write_as,
    write_fiducials,
    write_plan,
)
from ronnaplan import register_points as register
from ronnaplan.correspondence.pairing import Rival
from ronnaplan.ct.silhouette import silhouettes
from ronnaplan.ct.volume import SeriesSource
from ronnaplan.errors import RonnaplanError
from ronnaplan.geometry import Frame
from ronnaplan.localization import Build, Fiducial, FiducialFlag, Rejected
from ronnaplan.planning import Head, Limits, Plan, judge, measure, propose, scalp_sites
from ronnaplan.registration import doubted_marker, drift_over_time, leave_one_out, predict_tre, register_batch
from ronnaplan.robot import PivotCalibration, robot_from_ct, robot_trajectory
from ronnaplan.tracking import PointReading, Recording, find_markers, read_recording
from tests import cases
from tests.cases import ball_parameters

POINTS = np.array([[60.0, 0.0, 20.0], [-50.0, 10.0, 30.0], [5.0, 70.0, -20.0], [0.0, -60.0, 70.0]])
OFF = POINTS + np.array([[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.1], [0.1, 0, 0]])


def a_scan() -> CTVolume:
    """A scan whose slices lie on their side: voxel (k, j, i) is at LPS (2 k, -3 i, 4 j) mm, but for one corner."""
    affine = np.array([[2.0, 0, 0, -10], [0, 0, -3.0, 50], [0, 4.0, 0, 7], [0, 0, 0, 1]])
    voxels = np.full((6, 7, 8), -1000, dtype=np.int16)
    voxels[5, 1, 2] = 900
    return CTVolume.from_array(voxels, affine)


def some_fiducials() -> Fiducials:
    flags = ((), (FiducialFlag.CUT,), (), ())
    parameters = np.linspace(1.0, 2.0, 16)
    markers = tuple(
        Fiducial(f"F{n}", place, np.diag([1e-4, 4e-4, 9e-4]), np.eye(3) * 1e-4, parameters, 0.9, 0.01, flags[n])
        for n, place in enumerate(POINTS)
    )
    return Fiducials(markers, (), (11.5,), SeriesSource(), "0" * 64)


def a_plan() -> Plan:
    plan = Plan(SeriesSource())
    for name in ("left <b>", "right"):
        plan = plan.add(Trajectory(name, POINTS[0], POINTS[1]))
    return plan


def some_readings() -> Recording:
    points = [PointReading(frame, place, f"m{n}") for frame in range(30) for n, place in enumerate(POINTS)]
    return Recording("readings.csv", tuple(points))


PAIRS = np.array([[0, 2], [1, 0]])
SHOWN: dict[str, tuple[Callable[[], Any], int, str]] = {
    "fiducials": (some_fiducials, 4, "Fiducials(4 markers of 11.5 mm, 1 flagged, 0 candidates rejected)"),
    "pairing": (lambda: Pairing("unique", PAIRS, 0.999, (Rival(PAIRS, 12.3),)), 2, "unique, 2 pairs"),
    "refusal": (lambda: Pairing("ambiguous", PAIRS[:0], 0.5, reason="two fit"), 0, "ambiguous, 0 pairs"),
    "registration": (lambda: register(POINTS, OFF, np.eye(3) * 0.01), 4, "Registration(4 pairs, FRE 0.1 mm"),
    "plan": (a_plan, 2, "Plan(left <b>, right; 2 changes)"),
    "empty plan": (lambda: Plan(SeriesSource()), 0, "Plan(no trajectory; 0 changes)"),
}


@pytest.mark.parametrize("name", SHOWN)
def test_a_result_is_a_sequence_with_line_table_and_picture(name: str) -> None:
    make, count, line = SHOWN[name]
    result = make()
    assert issubclass(type(result), Sequence)
    assert len(result) == len(list(result)) == len(result[:]) == count
    assert line in repr(result)
    assert len(repr(result)) < 130
    table = result.to_dataframe()
    assert len(table) == count
    page = result._repr_html_()
    assert page.count("<tr>") == count + 1
    assert "<b>," not in page  # a name is text, not markup
    (picture,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert base64.b64decode(picture).startswith(b"\x89PNG")


NONE = np.zeros(3, bool)
SHORT: dict[str, tuple[Callable[[], Any], str]] = {
    "markers of a tracker": (
        lambda: find_markers(some_readings()),
        "4 markers in 30 frames of OTS, 0 tracks rejected",
    ),
    "one of them": (lambda: find_markers(some_readings()).markers[0], "m0 at (60.0, 0.0, 20.0) mm, 30 readings)"),
    "readings": (some_readings, "Recording(readings.csv: 120 points, 0 poses, in OTS)"),
    "points": (lambda: some_fiducials().points, "Points(4 in CT: F0, F1, F2, F3)"),
    "a registration of markers": (
        lambda: register_markers(some_fiducials().points, some_fiducials().points, sigma_ct_mm=0.1),
        "MarkerRegistration(Pairing(unique, 4 pairs, ",
    ),
    "a registration's document": (cases.registration, "RegistrationDocument(unique, 6 pairs, FRE "),
    "fiducials' document": (cases.fiducials, "FiducialsDocument(6 markers of 11.5 mm, 1 candidate rejected)"),
    "a layout": (lambda: describe_layout(POINTS), "Layout(4 markers, nearest rival order "),
    "a marker": (
        lambda: some_fiducials()[1],
        "Fiducial(F1 at (-50.0, 10.0, 30.0) mm, error 0.037 mm RMS, diameter ",
    ),
    "a trajectory": (
        lambda: a_plan().trajectories[1],
        "Trajectory(right: (",
    ),
    "a head": (lambda: Head.of(read_ct(cases.CT)), "Head(in CTVolume(121 slices"),
    "measures": (
        lambda: measure(cases.plan().trajectories[0], Head.of(read_ct(cases.CT))),
        "Measures(Trajectory(left: (",
    ),
    "a tool's tip": (
        lambda: PivotCalibration(
            POINTS[0], np.eye(3) / 300, POINTS[1], np.eye(3), np.ones(3), NONE, 0.1, NONE, NONE
        ),
        "PivotCalibration(tip at (60.0, 0.0, 20.0) mm, error 0.1 mm RMS, by 3 of 3 poses, 1 mm RMS left)",
    ),
    "many registrations": (
        lambda: register_batch(np.stack([POINTS, POINTS]), np.stack([OFF, OFF])),
        "RegistrationBatch(2 registrations, FRE 0.1 mm in the median)",
    ),
    "a rejected place": (
        lambda: Rejected(POINTS[0], "round", "it is not round", POINTS[0], POINTS[1]),
        "Rejected(at (60.0, 0.0, 20.0) mm: it is not round)",
    ),
}


@pytest.mark.parametrize("name", SHORT)
def test_what_a_person_prints_is_a_line(name: str) -> None:
    make, line = SHORT[name]
    shown = repr(make())
    assert line in shown
    assert "\n" not in shown
    assert len(shown) < 180


def with_diameters(*diameters_mm: float, stated_mm: float = 11.0) -> Fiducials:
    flags = tuple((FiducialFlag.DIAMETER,) if abs(one - stated_mm) > 0.06 else () for one in diameters_mm)
    markers = tuple(
        replace(one, parameters=ball_parameters(radius=diameter / 2), flags=raised)
        for one, diameter, raised in zip(some_fiducials(), diameters_mm, flags, strict=False)
    )
    return Fiducials(markers, (), (stated_mm,), SeriesSource(), "0" * 64)


def test_markers_that_are_all_of_another_size_name_it() -> None:
    assert with_diameters(11.5, 11.49, 11.51).other_diameter_mm == pytest.approx(11.5)
    assert "3 markers of 11 mm, 3 flagged, all measure 11.50 mm" in repr(with_diameters(11.5, 11.49, 11.51))
    for differing in ((11.5, 11.5, 11.0), (11.5, 11.5, 11.8), (11.5, 11.5), (11.0, 11.0, 11.0), ()):
        assert with_diameters(*differing).other_diameter_mm is None
    assert "sizes_seen(volume)" in repr(with_diameters())


def test_clipped_markers_do_not_hide_which_size_the_others_have() -> None:
    found = with_diameters(11.5, 11.49, 11.51, 11.2)
    clipped = replace(found.fiducials[-1], flags=(FiducialFlag.DIAMETER, FiducialFlag.CLIPPED))
    assert found.other_diameter_mm is None
    told = replace(found, fiducials=(*found.fiducials[:3], clipped))
    assert told.other_diameter_mm == pytest.approx(11.5)
    assert "4 flagged, all that show their size measure 11.50 mm" in repr(told)


def test_the_old_name_of_a_markers_error_is_deprecated() -> None:
    with pytest.warns(DeprecationWarning, match="error_rms_mm"):
        assert some_fiducials()[0].standard_error_mm == some_fiducials()[0].error_rms_mm


def test_a_table_holds_the_figures_of_the_result() -> None:
    found = some_fiducials()
    table = found.to_dataframe()
    np.testing.assert_array_equal(table[["x_mm", "y_mm", "z_mm"]], POINTS)
    np.testing.assert_allclose(table[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]], [[0.01, 0.02, 0.03]] * 4)
    assert table["flags"].tolist() == ["", str(FiducialFlag.CUT), "", ""]
    assert found[1].label == "F1"
    assert [one.label for one in found[-2:]] == ["F2", "F3"]
    assert found[2] in found
    registration = register(POINTS, OFF)
    np.testing.assert_array_equal(registration.to_dataframe()["residual_mm"], registration.residuals_mm)
    assert list(Pairing("unique", PAIRS, 1.0)) == [(0, 2), (1, 0)]


def test_a_silhouette_stands_where_its_voxels_are() -> None:
    images = silhouettes(a_scan())
    for (across, up), (image, (left, right, bottom, top)) in images.items():
        rows, columns = image.shape
        row, column = np.unravel_index(np.argmax(image), image.shape)
        place = np.array([0.0, 44.0, 11.0])  # of the voxel (5, 1, 2)
        width, height = (right - left) / columns, (top - bottom) / rows
        assert left + column * width <= place[across] <= left + (column + 1) * width
        assert bottom + row * height <= place[up] <= bottom + (row + 1) * height
        assert image.max() == 900
    assert a_plan()._repr_html_() != Plan(SeriesSource())._repr_html_()


def test_three_views_show_all_at_one_scale_and_name_paths_at_their_entries() -> None:
    plan = a_plan()
    panes = plan.plot().axes
    widths = {
        round(float(abs(np.ptp(limits))), 6) for axes in panes for limits in (axes.get_xlim(), axes.get_ylim())
    }
    assert len(widths) == 1
    assert panes[0].yaxis_inverted()
    names = [text for text in panes[1].findobj(Annotation) if text.get_text() == plan[0].name]
    assert [text.xy for text in names] == [(plan[0].entry_mm[0], plan[0].entry_mm[2])]
    for axes, (across, up) in zip(panes, ((0, 1), (0, 2), (1, 2)), strict=True):
        for place in (plan[0].entry_mm, plan[0].target_mm):
            assert min(axes.get_xlim()) < place[across] < max(axes.get_xlim())
            assert min(axes.get_ylim()) < place[up] < max(axes.get_ylim())


SCAN = a_scan()
WRONG: dict[str, Callable[[], object]] = {
    "a path for a scan": lambda: localize("scan", diameter_mm=11.5),  # type: ignore[arg-type]
    "voxels for a scan": lambda: localize(SCAN.voxels_hu, diameter_mm=11.5),  # type: ignore[arg-type]
    "text for a diameter": lambda: localize(SCAN, diameter_mm="11.5"),  # type: ignore[arg-type]
    "a word for a number": lambda: localize(SCAN, diameter_mm=11.5, expected="six"),  # type: ignore[arg-type]
    "half a marker": lambda: localize(SCAN, diameter_mm=11.5, expected=6.5),  # type: ignore[arg-type]
    "a path for a template": lambda: localize(SCAN, diameter_mm=11.5, template="t.json"),  # type: ignore[arg-type]
    "text for a marker": lambda: localize(SCAN, diameter_mm=11.5, marker="solid"),  # type: ignore[arg-type]
    "a number for a path": lambda: read_ct(3),  # type: ignore[arg-type]
    "fiducials for points": lambda: match_points(some_fiducials(), POINTS),  # type: ignore[arg-type]
    "text for covariances": lambda: match_points(POINTS, POINTS, covariances_ct_mm2="x"),
    "text for a probability": lambda: match_points(POINTS, POINTS, least_probability="x"),  # type: ignore[arg-type]
    "text for a spread": lambda: match_points(POINTS, POINTS, spread_mm="x"),  # type: ignore[arg-type]
    "a number for labels": lambda: register(POINTS, OFF, labels=5),  # type: ignore[arg-type]
    "text for a frame": lambda: register(POINTS, OFF, moving_frame="CT"),  # type: ignore[arg-type]
    "text for a batch": lambda: register_batch("x", "y"),
    "text for errors": lambda: predict_tre(POINTS, "x", POINTS),
    "an array for a map": lambda: register(POINTS, OFF).tre_map(POINTS),  # type: ignore[arg-type]
    "a number for a name": lambda: Trajectory(5, POINTS[0], POINTS[1]),  # type: ignore[arg-type]
    "an instrument's name": lambda: Trajectory("a", POINTS[0], POINTS[1], instrument="pointer"),  # type: ignore[arg-type]
    "a frame's name": lambda: Trajectory("a", POINTS[0], POINTS[1], frame="CT"),  # type: ignore[arg-type]
    "a word for a trajectory": lambda: Plan(SeriesSource()).add("left"),  # type: ignore[arg-type]
    "a path for a plan's scan": lambda: Plan.of_scan("scan"),  # type: ignore[arg-type]
    "text for a trajectory": lambda: measure("a", "b"),  # type: ignore[arg-type]
    "a path for a recording": lambda: find_markers("readings.csv"),  # type: ignore[arg-type]
    "a number for readings": lambda: read_recording(3),  # type: ignore[arg-type]
    "a result for its document": lambda: write_as("x.csv", some_fiducials(), "csv"),  # type: ignore[arg-type]
    "a path for what was found": lambda: write_fiducials("x.json", "found"),  # type: ignore[arg-type]
    "markers for their points": lambda: register_markers(some_fiducials(), some_fiducials().points),  # type: ignore[arg-type]
    "readings for their points": lambda: register_markers(some_fiducials().points, some_readings()),  # type: ignore[arg-type]
    "several results for points": lambda: describe_layout(some_readings()),  # type: ignore[arg-type]
    "a trajectory for targets": lambda: register(POINTS, OFF).tre(a_plan().trajectories[0]),  # type: ignore[arg-type]
    "auto for a diameter": lambda: localize(SCAN, diameter_mm="auto"),  # type: ignore[arg-type]
    "pairs for a registration": lambda: doubted_marker("marks"),  # type: ignore[arg-type]
    "text to leave out of": lambda: leave_one_out("marks"),  # type: ignore[arg-type]
    "a recording for frames": lambda: drift_over_time(some_fiducials().points, some_readings()),  # type: ignore[arg-type]
    "a registration for its pose": lambda: robot_from_ct(register(POINTS, OFF), None),  # type: ignore[arg-type]
    "a matrix for a moment": lambda: robot_from_ct(register(POINTS, OFF).pose, np.eye(4)),  # type: ignore[arg-type]
    "a matrix for R from CT": lambda: robot_trajectory("a", POINTS[0], POINTS[1], np.eye(4), frame=Frame("CT")),  # type: ignore[arg-type]
    "a scan for a head": lambda: scalp_sites(SCAN),  # type: ignore[arg-type]
    "a path for a head": lambda: Head.of("scan"),  # type: ignore[arg-type]
    "limits for measures": lambda: judge(Limits(), None),  # type: ignore[arg-type]
    "a scan to propose in": lambda: propose(POINTS[0], SCAN, Limits()),  # type: ignore[arg-type]
    "a field that no trajectory has": lambda: a_plan().edit("right", target=POINTS[0]),
    "text for a depth": lambda: a_plan().trajectories[0].at_depth("deep"),
    "a path for a plan": lambda: write_plan("plan.json", "plan"),  # type: ignore[arg-type]
    "a number for a marker": lambda: Build.parse(1),  # type: ignore[arg-type]
    "text for an affine": lambda: CTVolume.from_array(np.zeros((2, 2, 2)), "x"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_type_ends_in_one_sentence(name: str) -> None:
    with pytest.raises(RonnaplanError) as told:
        WRONG[name]()
    sentence = str(told.value)
    assert "\n" not in sentence
    assert len(sentence) < 250


@pytest.mark.parametrize(
    "diameters_mm", [[8.0, 11.5], (8, 11.5), np.array([8.0, 11.5]), np.array([8, 11.5], np.float32)]
)
def test_diameters_come_in_any_sequence(diameters_mm: Any) -> None:
    assert localize(SCAN, diameter_mm=diameters_mm).diameters_mm == (8.0, 11.5)


ROOMS = ("", ".localization", ".tracking", ".correspondence", ".registration", ".planning", ".documents", ".robot")


@pytest.mark.parametrize("room", ROOMS)
def test_no_function_goes_on_with_what_is_none_of_its_arguments(room: str, tmp_path: Path) -> None:
    """Some ended deep within, in words of NumPy or of an attribute that nobody had asked for."""
    module = importlib.import_module(f"ronnaplan{room}")
    for name in dir(module):
        function = getattr(module, name)
        if not inspect.isfunction(function):
            continue
        needed = [one for one in inspect.signature(function).parameters.values() if one.default is one.empty]
        for wrong in (str(tmp_path / "x"), None, 3):
            named = {one.name: wrong for one in needed if one.kind is one.KEYWORD_ONLY}
            with pytest.raises(RonnaplanError):
                function(*[wrong] * (len(needed) - len(named)), **named)


def test_the_face_lists_what_it_offers() -> None:
    offered = {"CTVolume", "Fiducials", "Pairing", "Plan", "Registration", "Trajectory", "describe_layout"}
    offered |= {"find_markers", "localize", "match_points", "read_ct", "read_recording", "register_markers"}
    offered |= {"read_fiducials", "read_plan", "read_registration", "register_points"}
    offered |= {"write_as", "write_fiducials", "write_plan", "write_registration"}
    assert set(dir(ronnaplan)) == offered
    from ronnaplan import robot

    assert {"calibrate_pivot", "robot_from_ct", "locate_sphere"} <= set(dir(robot))
    assert all(getattr(module, name) for module in (ronnaplan, robot) for name in dir(module))


def test_each_step_is_told_to_a_logger_that_is_silent_until_asked(caplog: pytest.LogCaptureFixture) -> None:
    registration = register(POINTS, OFF)
    assert not caplog.records
    with caplog.at_level(logging.DEBUG, "ronnaplan"):
        match_points(POINTS, OFF)
        assert isinstance(register(POINTS, OFF), Registration)
    lines = caplog.messages
    assert any("paired 4 CT with 4 tracker points: Pairing(" in line for line in lines)
    assert f"registered moving onto fixed: {registration!r}" in lines
    assert any(line.startswith("1 is left 0.") for line in lines)


def test_nothing_heavy_is_imported_before_it_is_needed() -> None:
    code = "import sys, ronnaplan; print(*sorted({name.split('.')[0] for name in sys.modules}))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parents[1]
    )
    assert not {"numpy", "scipy", "numba", "pydicom", "matplotlib", "cv2"} & set(done.stdout.split())
