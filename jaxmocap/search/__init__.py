"""The sample-based search of sec. 4.1: groups, stages, gating, scores."""

from ._body_search import BodySearch as BodySearch
from ._evidence import (
    Seen as Seen,
    look_at as look_at,
    mean_costs as mean_costs,
    seen_shares as seen_shares,
    unexplained as unexplained,
)
from ._gating import Gating as Gating, Retry as Retry
from ._group_search import GroupSearch as GroupSearch, Stage as Stage, group_searches as group_searches
from ._plan import Effort as Effort, SearchPlan as SearchPlan
from ._polish import PolishPlan as PolishPlan, polish as polish
from ._score import PoseScore as PoseScore
