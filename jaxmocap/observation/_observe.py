"""From decoded images to a `FrameProblem`: the one doorway into arrays."""

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from jaxmocap._cache import cached_jit
from jaxmocap.appearance import (
    Appearance,
    ColourSettings,
    ForegroundModel,
    GridWarp,
    background_distance,
    label_image,
    plate_beside,
    warp_grid,
    warped_plate,
    whitening,
)
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture, Detections
from jaxmocap.character import Character, Pose, skin
from jaxmocap.geometry import faces_within, pack_rows
from jaxmocap.render import inverse_depth_range

from ._clean_plate import CleanPlate
from ._detections import expected_keypoints, nearest_person, stacked_keypoints
from ._draw import full_image_ids
from ._edges import background_edges, image_edges
from ._features import FeatureSettings, FrameFeatures, frame_features, match_background
from ._light import relit
from ._problem import Clusters, Edges, FrameProblem, Surface
from ._rectangle import Rectangle

GEODESIC_STEPS = 5
"""Eq. 7: partners at most five triangles apart correspond."""

LONGEST_GAP = 4
"""Frames over which a clean plate is carried on."""

DEPTH_SLACK = 0.8
"""Metres around the predicted pose that inverse depths of a frame can express."""


class FrameImages(NamedTuple):
    """One decoded frame: its position in the capture, time in seconds, and an undistorted RGB image per camera; `light`
    is what the images have been divided by to be in the light of the first one."""

    frame: int
    timestamp: float
    images: list[UInt8[np.ndarray, "height width 3"]]
    light: Float[np.ndarray, "camera 3"] | None = None

    def in_light(self, factors: Float[np.ndarray, "camera 3"]) -> "FrameImages":
        """The frame as decoded, with its images divided by these factors."""
        return self._replace(images=relit(self.images, factors), light=factors)


def facing_cosine(
    vertices: Float[np.ndarray, "vertex 3"], faces: np.ndarray, centre: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "face"]:
    """Cosine between each face's outward normal and the direction to a camera centre."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    view = centre - corners.mean(1)
    length = np.linalg.norm(normal, axis=1) * np.linalg.norm(view, axis=1)
    return (normal * view).sum(1) / np.maximum(length, 1e-12)


def surface_of(character: Character, appearance: Appearance | None, num_cameras: int) -> Surface:
    """The character's tables for scoring. Without an appearance (registration) every face is at distance tau."""
    faces = np.asarray(character.faces)
    near = jax.device_put(pack_rows(faces_within(faces, GEODESIC_STEPS)))
    if appearance is None:
        return Surface(
            jnp.ones((num_cameras, len(faces), 1), jnp.float16),
            near,
            jnp.zeros((num_cameras, len(faces), 3)),
            jnp.zeros((num_cameras, len(faces)), bool),
        )
    tables = jnp.stack([appearance.foreground_table(camera) for camera in range(num_cameras)])
    mean_colours, known, clusters = _clusters(appearance.foreground, appearance.settings.colour)
    return Surface(tables, near, mean_colours, known, clusters)


@cached_jit
def _clusters(
    foreground: ForegroundModel, colour: ColourSettings
) -> tuple[Float[Array, "camera face 3"], Bool[Array, "camera face"], Clusters]:
    clusters = Clusters(foreground.colours.means, *whitening(foreground.colours, colour), colour)
    return foreground.mean_colours(), foreground.source > 0, clusters


def simplified_surface(
    surface: Surface, faces: Int[np.ndarray, "simple 3"], nearest: Int[np.ndarray, "face"]
) -> Surface:
    """The tables of a simplified mesh (`character.simplify`): a face is as near to a colour as the nearest of the faces
    it stands for, and geodesic steps are longer."""
    count, order = len(faces), np.argsort(nearest, kind="stable")
    present, first = np.unique(nearest[order], return_index=True)
    tables, mean_colour = np.asarray(surface.colour_distance), np.asarray(surface.mean_colour)
    known_faces = np.asarray(surface.has_colour)
    merged = np.ones((tables.shape[0], count, tables.shape[2]), tables.dtype)
    colours, known = np.zeros((tables.shape[0], count, 3), np.float32), np.zeros((tables.shape[0], count), bool)
    for camera in range(len(tables)):
        merged[camera, present] = np.minimum.reduceat(tables[camera][order], first, axis=0)
        has = known_faces[camera]
        weights = np.bincount(nearest, has, minlength=count)
        known[camera] = weights > 0
        for channel in range(3):
            total = np.bincount(nearest, np.where(has, mean_colour[camera, :, channel], 0.0), minlength=count)
            colours[camera, :, channel] = total / np.maximum(weights, 1)
    steps = max(1, round(GEODESIC_STEPS * np.sqrt(count / len(nearest))))
    near = jax.device_put(pack_rows(faces_within(faces, steps)))
    return Surface(jax.device_put(merged), near, jax.device_put(colours), jax.device_put(known))


def build_problem(
    images: list[UInt8[np.ndarray, "height width 3"]],
    rectangle: Rectangle,
    cameras: Cameras,
    frame: int,
    vertices: Float[np.ndarray, "vertex 3"],
    surface: Surface,
    labels: list[np.ndarray] | None = None,
    background: list[np.ndarray] | None = None,
    edges: list[tuple[np.ndarray, np.ndarray]] | None = None,
    keypoints: Float[np.ndarray, "camera 25 3"] | None = None,
) -> FrameProblem:
    """Assemble the arrays of one frame. `vertices` (any pose near the answer) place the range of depths."""
    # arrays of the host by `device_put`: JAX 0.10 compiles a copy for every shape that `jnp.asarray` meets
    view = cameras.at(frame)
    crops = [rectangle.crop(image, camera) for camera, image in enumerate(images)]
    edges = [image_edges(crop) for crop in crops] if edges is None else edges
    shape = (len(crops), rectangle.height, rectangle.width)
    ranges = [inverse_depth_range(vertices, pose, DEPTH_SLACK) for pose in np.asarray(view.cam_from_world)]
    labels = [np.zeros(shape[1:], np.int32)] * len(crops) if labels is None else labels
    background = [np.ones(shape[1:], np.float32)] * len(crops) if background is None else background
    return FrameProblem(
        intrinsics=view.intrinsics,
        cam_from_world=view.cam_from_world,
        origins=jax.device_put(np.asarray(rectangle.origins, np.int32)),
        image=jax.device_put(np.stack(crops).astype(np.float32) / 255),
        labels=jax.device_put(np.stack(labels).astype(np.int32)),
        background=jax.device_put(np.stack(background).astype(np.float32)),
        depth_range=jax.device_put(np.stack(ranges)),
        area=jax.device_put(np.float32(rectangle.area)),
        edges=Edges(
            jax.device_put(np.stack([e[0] for e in edges])),
            jax.device_put(np.stack([e[1] for e in edges]).astype(np.float32)),
        ),
        surface=surface,
        keypoints=jax.device_put(
            np.zeros((len(crops), 25, 3), np.float32) if keypoints is None else np.asarray(keypoints, np.float32)
        ),
    )


@dataclass
class Observations:
    """The frames of a capture as problems, made one by one while tracking: memory does not grow with length (host).

    `detections` are keypoints for `Tracker.detections`; without them every frame is judged by its pixels alone.
    Remembers the selected frames' features and the last warps, which the next frame starts from.
    """

    capture: Capture
    cameras: Cameras
    character: Character
    appearance: Appearance
    key_poses: dict[int, Pose]
    features: FeatureSettings = field(default_factory=FeatureSettings)
    detections: Detections | None = None

    def __post_init__(self) -> None:
        self.surface = surface_of(self.character, self.appearance, self.cameras.num_cameras)
        self._tables: dict[tuple[int, int], np.ndarray] = {}
        self._selected: dict[tuple[int, int], FrameFeatures] = {}
        self._plates: dict[int, CleanPlate] = {}
        self._warps: dict[tuple[int, int], GridWarp] = {}
        self._last: dict[tuple[int, int], tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]] = {}

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[FrameImages]:
        """Decode frames in order, streaming."""
        for frame, images in self.capture.frames(start, stop):
            yield FrameImages(frame, float(self.capture.timestamps[frame]), images)

    def _selected_picture(self, camera: int, selected: int) -> tuple[np.ndarray, np.ndarray]:
        """Image and person mask of a selected frame; without a mask the registered mesh takes its place."""
        frame = self.appearance.selected_frames[selected]
        mask = self.capture.mask(camera, frame)
        if mask is None:
            vertices = skin(self.character, self.key_poses[frame])
            mask = full_image_ids(self.character, vertices, self.cameras, frame)[camera] >= 0
        return self.capture.image(camera, frame), mask

    def _selected_features(self, camera: int, selected: int) -> FrameFeatures:
        if (camera, selected) not in self._selected:
            image, mask = self._selected_picture(camera, selected)
            self._selected[camera, selected] = frame_features(image, mask, self.features.mask_growth, self.features)
        return self._selected[camera, selected]

    def _plate(self, camera: int, frame: int, image: np.ndarray, person: np.ndarray) -> CleanPlate:
        """The camera's plate at a frame: carried on from the frame before, or put together from the selected ones."""
        known = self._plates.get(camera)
        if known is None or abs(known.frame - frame) > LONGEST_GAP:
            selected = self.appearance.selected_frames
            plate = None
            for s in sorted(range(len(selected)), key=lambda s: (abs(selected[s] - frame), s)):
                beside = plate_beside(*self._selected_picture(camera, s), self.appearance.settings.plate)
                warp = self._warp(camera, s, frame, image, person)
                carried = warped_plate(beside, warp, self.appearance.settings.grid)
                plate = carried if plate is None else plate.filled_from(carried)
            assert plate is not None
            known = CleanPlate(self.appearance.settings, frame, plate, image, person)
        self._plates[camera] = known.at(frame, image, person)
        return self._plates[camera]

    def learn(self, shown: FrameImages, rectangle: Rectangle, pose: Pose) -> None:
        """Renew the clean plates after a frame has been tracked, so that the next frame finds what it has shown."""
        if self.appearance.settings.behind != "plate":
            return
        people = full_image_ids(self.character, skin(self.character, pose), self.cameras, shown.frame)
        cameras = [camera for camera, plate in self._plates.items() if plate.frame == shown.frame]

        def learnt(camera: int) -> CleanPlate:
            return self._plates[camera].learnt(people[camera] >= 0, rectangle.window(camera))

        with ThreadPoolExecutor(max_workers=2) as pool:
            self._plates.update(zip(cameras, pool.map(learnt, cameras), strict=True))

    def restart(self) -> None:
        """Forget what earlier frames have shown: the next frame is the first of a sequence."""
        self._plates, self._warps, self._last = {}, {}, {}

    def state(self) -> dict[str, Any]:
        """What earlier frames have shown."""
        return {"plates": self._plates, "warps": self._warps, "last": self._last}

    def restore(self, state: dict[str, Any]) -> None:
        """Take over what `state` said."""
        self._plates, self._warps, self._last = state["plates"], state["warps"], state["last"]

    def _warp(self, camera: int, selected: int, frame: int, image: np.ndarray, person: np.ndarray) -> GridWarp:
        """The background grid of a selected frame carried to this frame (sec. 4.1)."""
        where = (camera, selected)
        size = image.shape[:2]
        if frame == self.appearance.selected_frames[selected]:
            nothing = np.zeros((0, 2))
            return warp_grid(nothing, nothing, size, self.appearance.settings.warp, grid=self.appearance.settings.grid)
        matches = match_background(
            self._selected_features(camera, selected),
            None,
            image,
            person,
            self.features,
            previous=self._last.get(where),
        )
        settings = self.appearance.settings
        warp = warp_grid(*matches, size, settings.warp, self._warps.get(where), grid=settings.grid)
        self._warps[where], self._last[where] = warp, (image, matches)
        return warp

    def problem(
        self,
        shown: FrameImages,
        rectangle: Rectangle,
        pose: Pose,
        edges: Literal["canny", "background"] = "canny",
        warps: list[list[tuple[int, GridWarp]]] | None = None,
    ) -> FrameProblem:
        """The problem of one frame, `pose` being the prediction. `edges` says where contours look for their edge: in
        the Canny picture (the paper) or at the outline of what is not background. `warps` are those of
        `background_warps`."""
        behind = self.appearance.settings.behind
        vertices = np.asarray(skin(self.character, pose))
        people = full_image_ids(self.character, jnp.asarray(vertices), self.cameras, shown.frame)
        labels = [
            np.asarray(label_image(self.appearance.palette, rectangle.crop(image, camera)))
            for camera, image in enumerate(shown.images)
        ]

        def distance(camera: int) -> np.ndarray:
            person = people[camera] >= 0
            if behind == "none":
                return np.ones((rectangle.height, rectangle.width), np.float32)
            if behind == "plate":
                plate = self._plate(camera, shown.frame, shown.images[camera], person)
                return plate.distance(rectangle.window(camera))
            carried = warps[camera] if warps is not None else self._carried(camera, shown, person)
            return self._grid_distance(camera, carried, shown.images[camera], rectangle, labels[camera])

        with ThreadPoolExecutor(max_workers=2) as pool:
            background = list(pool.map(distance, range(len(shown.images))))
        known = edges == "background" and behind != "none"
        outlines = [background_edges(distance) for distance in background] if known else None
        return build_problem(
            shown.images,
            rectangle,
            self.cameras,
            shown.frame,
            vertices,
            self.surface,
            labels,
            background,
            outlines,
            self._detected(shown.frame, pose),
        )

    def _detected(self, frame: int, pose: Pose) -> Float[np.ndarray, "camera 25 3"] | None:
        """The detections of the person whom `pose` predicts."""
        if self.detections is None:
            return None
        people = [self.detections.people(camera, frame) for camera in range(self.cameras.num_cameras)]
        expected = expected_keypoints(self.character, pose, self.cameras.at(frame))
        return stacked_keypoints([nearest_person(*each) for each in zip(people, expected, strict=True)])

    def _grid_distance(
        self,
        camera: int,
        carried: list[tuple[int, GridWarp]],
        image: np.ndarray,
        rectangle: Rectangle,
        labels: np.ndarray,
    ) -> Float[np.ndarray, "height width"]:
        """psi_b in the rectangle from the colour models of the warped grids (the paper)."""
        rows, columns = rectangle.window(camera)
        distances = []
        for selected, warp in carried:
            if (camera, selected) not in self._tables:
                self._tables[camera, selected] = np.asarray(self.appearance.background_table(camera, selected))
            distances.append(
                background_distance(
                    self.appearance.background[camera, selected],
                    warp.vertices,
                    image[rows, columns],
                    origin=(rows.start, columns.start),
                    grid=self.appearance.settings.grid,
                    colour=self.appearance.settings.colour,
                    rest=warp.rest,
                    palette=self.appearance.palette,
                    table=self._tables[camera, selected],
                    labels=labels,
                )
            )
        return np.min(distances, axis=0)

    def _carried(self, camera: int, shown: FrameImages, person: np.ndarray) -> list[tuple[int, GridWarp]]:
        serving = self.appearance.selected_for(shown.frame)
        return [(s, self._warp(camera, s, shown.frame, shown.images[camera], person)) for s in serving]

    def background_warps(self, shown: FrameImages, pose: Pose) -> list[list[tuple[int, GridWarp]]]:
        """Per camera, the selected frames that serve this frame and their grids carried to it."""
        people = full_image_ids(self.character, skin(self.character, pose), self.cameras, shown.frame)
        return [self._carried(camera, shown, person >= 0) for camera, person in enumerate(people)]


class Registered(Protocol):
    """Anything that holds a registered pose."""

    @property
    def pose(self) -> Pose: ...


def key_poses_of(registrations: Mapping[int, Registered] | Mapping[int, Pose]) -> dict[int, Pose]:
    """The poses of registered frames."""
    return {frame: r if isinstance(r, Pose) else r.pose for frame, r in registrations.items()}


def observe(
    capture: Capture,
    cameras: Cameras,
    character: Character,
    appearance: Appearance,
    key_poses: Mapping[int, Registered] | Mapping[int, Pose],
    detections: Detections | None = None,
) -> Observations:
    """The capture's frames as problems, decoded one at a time while they are tracked."""
    return Observations(capture, cameras, character, appearance, key_poses_of(key_poses), detections=detections)
