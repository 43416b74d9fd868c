"""The sample-based search of sec. 4.1: groups, gating, scores."""

from ._body_search import BodySearch as BodySearch
from ._evidence import (
    DrawnPose as DrawnPose,
    Evidence as Evidence,
    PoseScore as PoseScore,
    uncovered_share as uncovered_share,
    without_seams as without_seams,
)
from ._gating import Gating as Gating, Retry as Retry, SearchMemory as SearchMemory
from ._group_search import (
    ROOT_REACH as ROOT_REACH,
    GroupSearch as GroupSearch,
    Reach as Reach,
    group_searches as group_searches,
)
from ._plan import SearchPlan as SearchPlan
from ._polish import PolishPlan as PolishPlan, downhill as downhill, fitted as fitted, polish as polish
