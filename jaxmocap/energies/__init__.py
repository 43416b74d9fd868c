from ._body import (
    BodyPart as BodyPart,
    Region as Region,
    base_buffers as base_buffers,
    body_part as body_part,
    part_jobs as part_jobs,
)
from ._contour import (
    ContourSettings as ContourSettings,
    contour_lines as contour_lines,
    contour_points as contour_points,
    edge_targets as edge_targets,
)
from ._keypoints import (
    Keypoints as Keypoints,
    LandmarkRays as LandmarkRays,
    keypoint_rays as keypoint_rays,
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
    TAU as TAU,
    ModelView as ModelView,
    covered_cost as covered_cost,
    uncovered_cost as uncovered_cost,
)
from ._posture import Posture as Posture, bend as bend
from ._search_energy import (
    Base as Base,
    PoseTerm as PoseTerm,
    Scores as Scores,
    SearchEnergy as SearchEnergy,
    SearchTerm as SearchTerm,
    prepare_base as prepare_base,
    score_particles as score_particles,
    search_energy as search_energy,
)
from ._silhouette import Silhouette as Silhouette
from ._soft_energy import SoftScore as SoftScore, soft_score as soft_score
from ._view_view import (
    Carry as Carry,
    ViewView as ViewView,
    are_near as are_near,
    carry as carry,
    partner_pixels as partner_pixels,
)
