from ._masks import intersection_over_union as intersection_over_union
from ._mesh import (
    face_adjacency as face_adjacency,
    face_areas as face_areas,
    face_components as face_components,
    faces_within as faces_within,
    facing_cosine as facing_cosine,
    pack_rows as pack_rows,
    uniform_laplacian as uniform_laplacian,
    unit as unit,
    unit_vectors as unit_vectors,
    vertex_normals as vertex_normals,
)
from ._residuals import (
    huber as huber,
    huber_weight as huber_weight,
)
from ._similarity import (
    IDENTITY as IDENTITY,
    Similarity as Similarity,
    align_cameras as align_cameras,
    camera_centres as camera_centres,
    camera_residuals as camera_residuals,
    fit_similarity as fit_similarity,
)
from ._surface_nets import SignedDistance as SignedDistance, surface_nets as surface_nets
from ._transforms import (
    hat as hat,
    inverse as inverse,
    matmul as matmul,
    rigid as rigid,
    se3_exp as se3_exp,
    so3_exp as so3_exp,
    so3_left_jacobian as so3_left_jacobian,
    so3_log as so3_log,
    transform as transform,
)
