from ._background import Background as Background, BackgroundModel as BackgroundModel
from ._cut_person import (
    CutSettings as CutSettings,
    cut_person as cut_person,
    person_prior as person_prior,
    signed_distance as signed_distance,
)
from ._detections import (
    BODY_25 as BODY_25,
    FACE as FACE,
    DetectorOffsets as DetectorOffsets,
    carriers as carriers,
    expected_keypoints as expected_keypoints,
    nearest_person as nearest_person,
    stacked_keypoints as stacked_keypoints,
)
from ._edges import (
    image_edges as image_edges,
    mask_edges as mask_edges,
    unit_gradient as unit_gradient,
)
from ._features import (
    FeatureSettings as FeatureSettings,
    FrameFeatures as FrameFeatures,
    frame_features as frame_features,
    match_background as match_background,
)
from ._flow import (
    dense_flow as dense_flow,
    flow_agrees as flow_agrees,
    flow_both_ways as flow_both_ways,
    sample_picture as sample_picture,
    squared_length as squared_length,
)
from ._light import (
    LightMeter as LightMeter,
    light_change as light_change,
    relit as relit,
)
from ._mask_confidence import (
    MaskConfidence as MaskConfidence,
    mask_confidence as mask_confidence,
    outline_contrast as outline_contrast,
)
from ._observe import (
    Observations as Observations,
    Registered as Registered,
    check_key_poses as check_key_poses,
    key_poses_of as key_poses_of,
    observe as observe,
)
from ._problem import (
    Edges as Edges,
    Frame as Frame,
    FrameImages as FrameImages,
    FrameProblem as FrameProblem,
    build_problem as build_problem,
    draw as draw,
    full_image_ids as full_image_ids,
)
from ._rectangle import (
    Rectangle as Rectangle,
    frame_rectangle as frame_rectangle,
    place_rectangle as place_rectangle,
    projected_box as projected_box,
)
from ._standing_still import OtherFrame as OtherFrame, other_frame as other_frame, standing_still as standing_still
from ._surface import (
    Clusters as Clusters,
    Surface as Surface,
    filled_surface as filled_surface,
    simplified_surface as simplified_surface,
    surface_of as surface_of,
)
