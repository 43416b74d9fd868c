"""Background and body as one scene for the bundle adjustment, and by how far each can be trusted."""

import numpy as np
from jaxtyping import Float

from jaxmocap.capture import Capture

from ._joint_scene import JointScene
from ._tracked_body import BodySightings
from ._tracks import Tracks

_LEAST_KEYPOINT, _LEAST_BACKGROUND = 1.0, 0.1  # pixels at a width of 960
_MAD_TO_SIGMA = 1.4826


def make_scene(capture: Capture, tracks: Tracks, body: BodySightings) -> JointScene:
    """Both together; a body point is sighted in the image of its frame, which the model must have."""
    intrinsics = np.asarray(capture.cameras.intrinsics, float)
    seconds = np.array(
        [
            capture.indices[camera].seconds[min(frame, capture.indices[camera].num_frames - 1)]
            + capture.offsets[camera]
            - capture.offsets[0]
            for camera, frame in zip(tracks.camera, tracks.frame, strict=True)
        ]
    )
    places = zip(tracks.camera.tolist(), tracks.frame.tolist(), strict=True)
    rows = {place: row for row, place in enumerate(places)}
    wanted = [
        rows.get((camera, int(capture.video_frames[camera, position])), -1)
        for camera, position in zip(body.camera.tolist(), body.position.tolist(), strict=True)
    ]
    pose_of = np.array(wanted)
    there = pose_of >= 0
    return JointScene(
        cam_from_world=tracks.cam_from_world,
        camera=tracks.camera,
        seconds=seconds,
        focal=intrinsics[:, [0, 1], [0, 1]],
        centre=intrinsics[:, :2, 2],
        points=np.concatenate([body.points, tracks.points]),
        body=body.body,
        pose_of=np.concatenate([pose_of[there], tracks.pose_of]),
        point_of=np.concatenate([body.point_of[there], len(body.points) + tracks.point_of]),
        pixels=np.concatenate([body.pixels[there], tracks.pixels]),
        sigma=np.ones(int(there.sum()) + len(tracks.pose_of)),
    )


def weighed(scene: JointScene, errors: Float[np.ndarray, "sighting 2"], alike: float) -> JointScene:
    """The scene with deviations as the residuals (pixels) of the body and of the background have them, by their median.

    Errors that are alike count as one, so deviations grow by the root of how many they are: of the body those of
    `alike` neighbouring frames, for a detector errs the same way for a while; of the background all sightings of
    one point by one camera, for they are the texture's.
    """
    camera = scene.camera[scene.pose_of]
    scale = scene.centre.max(axis=1)[camera] / 480  # pixels of a picture 960 wide
    body, sigma = scene.point_of < scene.num_body, np.ones(len(camera))
    for rows, floor in ((body, _LEAST_KEYPOINT), (~body, _LEAST_BACKGROUND)):
        if not rows.any():
            continue
        sightings, points = int(rows.sum()), len(np.unique(scene.point_of[rows]))
        tracks = len(np.unique(np.stack([camera[rows], scene.point_of[rows]]), axis=1).T)
        freedom = max(1 - 1.5 * points / sightings, 0.05)  # three unknowns a point, two numbers a sighting
        found = _MAD_TO_SIGMA * float(np.median(np.abs(errors[rows] / scale[rows, None]))) / np.sqrt(freedom)
        together = alike if floor == _LEAST_KEYPOINT else sightings / tracks
        sigma[rows] = max(found, floor) * np.sqrt(together) * scale[rows]
    return scene._replace(sigma=sigma)
