"""Optical tracker readings: from files and live streams to markers with covariance."""

from ronnaplan.tracking.frames import labelled_frames
from ronnaplan.tracking.readers import READERS, read_recording
from ronnaplan.tracking.recording import PointReading, Recording, ToolReading
from ronnaplan.tracking.stray import MarkerFlag, MarkerReadings, TrackedMarker, find_markers
from ronnaplan.tracking.told import readings_told

__all__ = [
    "READERS",
    "MarkerFlag",
    "MarkerReadings",
    "PointReading",
    "Recording",
    "ToolReading",
    "TrackedMarker",
    "find_markers",
    "labelled_frames",
    "read_recording",
    "readings_told",
]
