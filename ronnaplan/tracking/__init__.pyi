from .frames import labelled_frames as labelled_frames
from .markers import MarkerFlag as MarkerFlag, MarkerReadings as MarkerReadings, TrackedMarker as TrackedMarker
from .readers import read_recording as read_recording
from .recording import PointReading as PointReading, Recording as Recording, ToolReading as ToolReading
from .stray import find_markers as find_markers
