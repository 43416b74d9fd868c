from ._body import (
    BodyPart as BodyPart,
    GroupProblem as GroupProblem,
    base_buffers as base_buffers,
    body_part as body_part,
    part_windows as part_windows,
)
from ._contour import (
    ContourSettings as ContourSettings,
    contour_lines as contour_lines,
    contour_points as contour_points,
    edge_targets as edge_targets,
)
from ._lines import (
    LineResidual as LineResidual,
    SurfaceLines as SurfaceLines,
    barycentric_at as barycentric_at,
    join_lines as join_lines,
    rays as rays,
    surface_lines as surface_lines,
)
from ._model_view import (
    ModelView as ModelView,
    covered_cost as covered_cost,
    uncovered_cost as uncovered_cost,
)
from ._pose_terms import (
    Keypoints as Keypoints,
    LandmarkRays as LandmarkRays,
    Posture as Posture,
    bend as bend,
    keypoint_rays as keypoint_rays,
)
from ._search_energy import (
    Base as Base,
    Scores as Scores,
    SearchEnergy as SearchEnergy,
    prepare_base as prepare_base,
    score_particles as score_particles,
    search_energy as search_energy,
)
from ._silhouette import Silhouette as Silhouette
from ._soft_score import SoftScore as SoftScore, soft_score as soft_score
from ._term import (
    AbstractPoseTerm as AbstractPoseTerm,
    AbstractTerm as AbstractTerm,
    Drawn as Drawn,
    SoftDrawn as SoftDrawn,
)
from ._view_pair import (
    PixelTransfer as PixelTransfer,
    are_near as are_near,
    partner_pixels as partner_pixels,
    pixel_transfer as pixel_transfer,
)
from ._view_view import ViewView as ViewView
