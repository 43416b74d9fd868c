"""A complete synthetic capture in memory: images, cameras, actor, and everything that is true about them."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.capture import KEYPOINT_NAMES
from jaxmocap.character import Character, Pose
from jaxmocap.motion import Motion

from ._actor import bind_markers, make_actor, marker_positions, passing, posed
from ._body import TEMPLATE_HEIGHT
from ._cameras import BODY_FRACTION, FOCAL_PER_WIDTH, VIEW_ANGLE, filming_distance, handheld_paths, intrinsics_of
from ._clothes import Outfit, Style, Subject
from ._motion import Routine, ground_path, perform, recorded
from ._render import Rendered, film, render_view
from ._scene import Scenery, make_scene

NUM_MARKERS = 44
VIEW_ANGLE_DEGREES = float(np.degrees(VIEW_ANGLE))
_SHUTTER = 0.5  # open for half of the frame interval
_OPENPOSE_PLACES = {"pelvis": "mid_hip"}


@dataclass(frozen=True, eq=False)
class SyntheticCapture:
    """A synthetic capture in memory; metres, y up.

    Attributes:
        name: of the capture.
        fps: frames per second.
        timestamps: of the frames, seconds.
        images: RGB.
        masks: of the actor, at each frame's own time.
        cameras: true ones.
        character: the actor.
        poses: true ones, at each frame's own time, with a leading frame axis.
        markers: true places of points of the skin.
        marker_faces: the face that each marker lies on.
        marker_barycentrics: where on its face.
        joints: true places.
        joint_names: of `joints`.
        selected_frames: those with keypoints.
        keypoints: BODY_25 as x, y, confidence with noise, at the selected frames only; pixels.
    """

    name: str
    fps: float
    timestamps: Float[np.ndarray, "frame"]
    images: UInt8[np.ndarray, "frame camera height width 3"]
    masks: Bool[np.ndarray, "frame camera height width"]
    cameras: Cameras
    character: Character
    poses: Pose
    markers: Float[np.ndarray, "frame marker 3"]
    marker_faces: Int[np.ndarray, "marker"]
    marker_barycentrics: Float[np.ndarray, "marker 3"]
    joints: Float[np.ndarray, "frame joint 3"]
    joint_names: tuple[str, ...]
    selected_frames: tuple[int, ...]
    keypoints: Float[np.ndarray, "selected camera 25 3"]

    @property
    def num_frames(self) -> int:
        return len(self.images)

    @property
    def num_cameras(self) -> int:
        return self.images.shape[1]

    @property
    def size(self) -> tuple[int, int]:
        """Tell the (width, height) of the images."""
        return self.images.shape[3], self.images.shape[2]

    def pose(self, frame: int) -> Pose:
        """Return the true pose at one frame."""
        return Pose(root=self.poses.root[frame], angles=self.poses.angles[frame])


def make_capture(
    num_frames: int = 30,
    size: tuple[int, int] = (480, 270),
    num_cameras: int = 2,
    seed: int = 0,
    *,
    fps: float = 30.0,
    height: float = TEMPLATE_HEIGHT,
    motion_scale: float = 1.0,
    camera_shake: float = 1.0,
    clothes: Style = "patterned",
    routine: Routine = "dance",
    scenery: Scenery = "bricks",
    view_angle_degrees: float = VIEW_ANGLE_DEGREES,
    sensor_noise: float = 0.006,
    keypoint_noise: float = 2.5,
    illumination_change: float = 0.0,
    sub_frames: int = 1,
    supersampling: int = 2,
    selected_frames: Sequence[int] | None = None,
    motion: Motion | None = None,
    focal_per_width: float = FOCAL_PER_WIDTH,
    body_fraction: float = BODY_FRACTION,
    bystander: bool = False,
) -> SyntheticCapture:
    """Film the actor dancing on a square with handheld cameras 27 degrees apart; equal arguments give equal bytes.

    `motion_scale` multiplies the amplitudes of the actor's motion and `camera_shake` those of the hands, 0 giving
    tripods that only turn; `view_angle_degrees` is how far neighbouring cameras stand apart. `size` is (width, height)
    in pixels, both even. `clothes="uniform"` dresses arms and torso alike, `"plain sleeves"` the arms in one colour
    beside a patterned shirt. `routine` is how the actor moves (`perform`), and `scenery="skin"` paints ground and walls
    in the colour of the arms. `sensor_noise` is a fraction of full scale, `keypoint_noise` a standard deviation in
    pixels at 960 pixels width. `illumination_change` brightens and dims the scene by that fraction over the capture.
    `sub_frames` > 1 averages that many instants of a half-open shutter (motion blur), and every picture is the mean of
    `supersampling` times as many pixels each way. `selected_frames` default to the first and the middle one. Instead of
    dancing, the actor moves as in `motion`, a motion of `make_actor(height)` that lasts as long, such as
    `jm.read_motion("clip.bvh", make_actor())`. `focal_per_width` is the focal length in widths of the image, and
    `body_fraction` how much of its height the actor fills. With `bystander` somebody in other clothes walks past behind
    the actor. Raises `InputError` for arguments out of range.
    """
    _check(num_frames, size, num_cameras, sub_frames, supersampling)
    selected = tuple(selected_frames) if selected_frames is not None else tuple(sorted({0, num_frames // 2}))
    if any(not 0 <= frame < num_frames for frame in selected):
        raise InputError(f"selected_frames are {selected}; choose frames from 0 to {num_frames - 1}.")
    timestamps = np.arange(num_frames) / fps
    instants = _SHUTTER / fps * ((np.arange(sub_frames) + 0.5) / sub_frames - 0.5)
    times = np.concatenate([timestamps[:, None], timestamps[:, None] + instants], axis=1).reshape(-1)

    character = make_actor(height)
    if motion is None:
        poses, path = perform(routine, character.skeleton, times, motion_scale), ground_path(times, motion_scale)
    else:
        _check_motion(motion, character, timestamps[-1])
        poses, path = recorded(motion, times)
    vertices, joints = posed(character, poses)
    angle = np.radians(view_angle_degrees)
    distance = filming_distance(size, height, focal_per_width, body_fraction)
    paths = handheld_paths(times, path, distance, num_cameras, seed, camera_shake, height, angle)

    every = 1 + sub_frames
    intrinsics, scene = intrinsics_of(size, focal_per_width), make_scene(seed, scenery)
    faces, other = np.asarray(character.faces), passing(seed, times, path) if bystander else None
    rest = np.asarray(character.vertices, np.float32) * np.float32(TEMPLATE_HEIGHT / height)
    subject = Subject(rest, faces, Outfit.make(seed, clothes))

    def draw(camera: int, instant: int) -> Rendered:
        others = [] if other is None else [(other[0], other[1][instant])]
        view = (intrinsics, paths[camera, instant], size, supersampling)
        return render_view(scene, subject, vertices[instant], *view, others)

    images, masks = film(draw, num_frames, num_cameras, sub_frames, seed, sensor_noise, illumination_change)
    marker_faces, barycentrics = bind_markers(np.asarray(character.vertices, float), faces, NUM_MARKERS, seed)
    cameras = Cameras(
        names=tuple(f"cam{camera}" for camera in range(num_cameras)),
        sizes=(size,) * num_cameras,
        intrinsics=jnp.asarray(np.tile(intrinsics, (num_cameras, 1, 1)), jnp.float32),
        distortion=jnp.zeros((num_cameras, 5), jnp.float32),
        cam_from_world=jnp.asarray(paths[:, ::every], jnp.float32),
    )
    joints = joints[::every]
    names = character.skeleton.landmark_names
    return SyntheticCapture(
        name="synthetic",
        fps=fps,
        timestamps=timestamps,
        images=images,
        masks=masks,
        cameras=cameras,
        character=character,
        poses=jax.tree.map(lambda leaf: leaf[::every], poses),
        markers=marker_positions(vertices[::every], faces, marker_faces, barycentrics).astype(np.float32),
        marker_faces=marker_faces,
        marker_barycentrics=barycentrics,
        joints=joints.astype(np.float32),
        joint_names=names,
        selected_frames=selected,
        keypoints=_keypoints(joints, names, paths[:, ::every], intrinsics, size, selected, keypoint_noise, seed),
    )


def body_25(
    capture: SyntheticCapture, frames: Sequence[int], noise: float
) -> Float[np.ndarray, "selected camera 25 3"]:
    """Make BODY_25 points of any frames as a detector would; `noise` is the `keypoint_noise` of `make_capture`."""
    paths = np.asarray(capture.cameras.cam_from_world, np.float64)
    joints = capture.joints.astype(np.float64)
    intrinsics = np.asarray(capture.cameras.intrinsics[0], np.float64)
    return _keypoints(joints, capture.joint_names, paths, intrinsics, capture.size, tuple(frames), noise, seed=0)


def _check(num_frames: int, size: tuple[int, int], num_cameras: int, sub_frames: int, supersampling: int) -> None:
    if num_frames < 1:
        raise InputError(f"num_frames is {num_frames}; at least 1 is needed.")
    if min(size) < 16 or size[0] % 2 or size[1] % 2:
        raise InputError(f"size is {size}; width and height must be even numbers of at least 16 pixels.")
    if not 1 <= num_cameras <= 8:
        raise InputError(f"num_cameras is {num_cameras}; choose 1 to 8.")
    if sub_frames < 1 or supersampling < 1:
        raise InputError(f"sub_frames is {sub_frames} and supersampling {supersampling}; both must be at least 1.")


def _check_motion(motion: Motion, character: Character, duration: float) -> None:
    theirs, ours = motion.character.vertices, character.vertices
    if theirs.shape != ours.shape or not np.allclose(theirs, ours, atol=1e-5):
        raise InputError(f"the motion is one of '{motion.character.name}'; a motion of make_actor(height) is needed.")
    lasts = motion.timestamps[-1] - motion.timestamps[0]
    if lasts < duration - 1e-6:
        raise InputError(f"the motion lasts {lasts:.3g} s; {duration:.3g} s are to be filmed: ask for fewer frames.")


def _keypoints(
    joints: np.ndarray,
    names: tuple[str, ...],
    paths: np.ndarray,
    intrinsics: np.ndarray,
    size: tuple[int, int],
    selected: tuple[int, ...],
    noise: float,
    seed: int,
) -> np.ndarray:
    """Make BODY_25 points of the selected frames as a detector would, confidence 1."""
    columns = [names.index(_OPENPOSE_PLACES.get(name, name)) for name in KEYPOINT_NAMES]
    points = np.ones((len(selected), len(paths), len(columns), 3))
    for row, frame in enumerate(selected):
        for camera, path in enumerate(paths):
            in_camera = joints[frame, columns] @ path[frame, :3, :3].T + path[frame, :3, 3]
            projected = in_camera @ intrinsics.T
            rng = np.random.default_rng([seed, 5, camera, frame])
            error = noise * size[0] / 960 * rng.standard_normal((len(columns), 2))
            points[row, camera, :, :2] = projected[:, :2] / projected[:, 2:] + error
    return points
