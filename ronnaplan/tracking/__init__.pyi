from .frames import labelled_frames
from .readers import BEGINNING_BYTES, READERS, may_hold_readings, read_recording
from .recording import PointReading, Recording, ToolReading
from .stray import MarkerFlag, MarkerReadings, TrackedMarker, find_markers
from .told import readings_told

__all__ = [
    "BEGINNING_BYTES",
    "READERS",
    "MarkerFlag",
    "MarkerReadings",
    "PointReading",
    "Recording",
    "ToolReading",
    "TrackedMarker",
    "find_markers",
    "labelled_frames",
    "may_hold_readings",
    "read_recording",
    "readings_told",
]
