"""Bare meshes become characters: repair, skeleton embedding and skinning weights (Sec. 3.1)."""

from ._bind import turned_out as turned_out
from ._body import body as body, check_height as check_height
from ._picture_cameras import (
    CAMERAS_FILE as CAMERAS_FILE,
    mesh_for_pictures as mesh_for_pictures,
    metres_per_unit_of as metres_per_unit_of,
)
from ._read_mesh import Mesh as Mesh
from ._rig import (
    RiggedMesh as RiggedMesh,
    brings_skin as brings_skin,
    open_actor as open_actor,
    refuse_number_of_triangles as refuse_number_of_triangles,
    refuse_unreadable_actor as refuse_unreadable_actor,
    rig as rig,
)
