from .frames import labelled_frames as labelled_frames
from .readers import read_recording as read_recording
from .recording import PointReading as PointReading, Recording as Recording, ToolReading as ToolReading
from .stray import MarkerFlag as MarkerFlag, MarkerReadings as MarkerReadings
from .stray import TrackedMarker as TrackedMarker, find_markers as find_markers
