"""The actor: skeleton, pose and skinning (Eqs 1, 2 and 4), and its loading from skinned files."""

from ._body_shape import (
    GIRTHS as GIRTHS,
    LENGTHS as LENGTHS,
    BodyShape as BodyShape,
    bone_lengths as bone_lengths,
    scaled as scaled,
    stature as stature,
)
from ._build import (
    REQUIRED as REQUIRED,
    angles_at_rest as angles_at_rest,
    build_skeleton as build_skeleton,
    search_hints as search_hints,
    skeleton_of as skeleton_of,
)
from ._capsules import Capsules as Capsules, capsules as capsules
from ._character import (
    VERTICES_STEP as VERTICES_STEP,
    Character as Character,
    dominant_bodies as dominant_bodies,
    filled_up as filled_up,
    simplify as simplify,
)
from ._dof_table import (
    BODIES as BODIES,
    Dof as Dof,
    SkeletonTable as SkeletonTable,
    human_table as human_table,
    known_dofs as known_dofs,
)
from ._gltf import (
    Document as Document,
    has_skin as has_skin,
    local_matrix as local_matrix,
    parents_first as parents_first,
    parents_of as parents_of,
)
from ._kinematics import (
    blend as blend,
    body_transforms as body_transforms,
    landmark_positions as landmark_positions,
    offset_landmarks as offset_landmarks,
    points_and_jacobian as points_and_jacobian,
    skin as skin,
)
from ._map_joints import Source as Source
from ._pose import (
    Pose as Pose,
    away_from_limits as away_from_limits,
    ball_joints as ball_joints,
    clamp as clamp,
    difference as difference,
    equivalent_angles as equivalent_angles,
    nearest_equivalent as nearest_equivalent,
    pelvis_position as pelvis_position,
    pose_from_vector as pose_from_vector,
    pose_vector as pose_vector,
    rest_pose as rest_pose,
    retract as retract,
    rewritten_increments as rewritten_increments,
    with_limb as with_limb,
)
from ._read_skin import RawSkin as RawSkin, read_skin as read_skin
from ._rig import Rig as Rig, read_rig as read_rig, rest_frame as rest_frame, rig_of as rig_of
from ._save_glb import GlbBuffer as GlbBuffer, glb_bytes as glb_bytes
from ._skeleton import ROOT_DOFS as ROOT_DOFS, Skeleton as Skeleton, is_limb as is_limb
