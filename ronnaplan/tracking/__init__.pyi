from .frames import labelled_frames
from .readers import READERS, read_recording
from .recording import PointReading, Recording, ToolReading
from .stray import MarkerFlag, MarkerReadings, TrackedMarker, find_markers
from .told import readings_told

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
