from .layout import Layout as Layout, describe_layout as describe_layout
from .matching import match_points as match_points
from .pairing import Pairing as Pairing, Rival as Rival
from .similarity import match_by_similarity as match_by_similarity
