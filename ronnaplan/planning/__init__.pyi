from .head import Head as Head
from .labels import read_label_map as read_label_map
from .landmarks import Landmarks as Landmarks
from .limits import Limits as Limits, Verdict as Verdict, judge as judge
from .measures import Measures as Measures, measure as measure
from .placement import Placement as Placement, place_markers as place_markers
from .plan import Plan as Plan
from .proposals import Proposals as Proposals, propose as propose
from .rulers import Ruler as Ruler
from .sites import PlacementRules as PlacementRules, Sites as Sites, scalp_sites as scalp_sites
from .trajectory import INSTRUMENTS as INSTRUMENTS, Instrument as Instrument, Trajectory as Trajectory
from .uncertainty import ExpectedPose as ExpectedPose
