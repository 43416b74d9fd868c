"""Psi_b of Eq. 3 frame by frame: selected frames' backgrounds warped to the frame, and clean plates warped along."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from jaxmocap._runtime import cores
from jaxmocap.appearance import (
    Appearance,
    GridWarp,
    background_distance,
    plate_beside,
    warp_grid,
    warped_plate,
)
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture
from jaxmocap.character import Character, Pose, skin

from ._clean_plate import CleanPlate
from ._features import FeatureSettings, FrameFeatures, frame_features, match_background
from ._flow import FlowAhead
from ._problem import FrameImages, full_image_ids
from ._rectangle import Rectangle

LONGEST_GAP = 4
"""Frames over which a clean plate is warped on."""

Matches = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class CameraBackground:
    """What the frames so far have told of one camera's background: the clean plate, and by number of the selected frame
    the last warp of its grid, with the image and the matches that led to it."""

    plate: CleanPlate | None = None
    warps: dict[int, GridWarp] = field(default_factory=dict)
    matches: dict[int, tuple[np.ndarray, Matches]] = field(default_factory=dict)


Background = tuple[CameraBackground, ...]
"""One per camera. It is part of the tracking state: nothing here remembers a frame that was tracked."""


class BackgroundModel:
    """Tells how unlike the background each pixel is (host).

    What it keeps, features and colour tables of the selected frames, follows from its inputs alone; what grows from
    frame to frame goes in and comes out as a `Background`.
    """

    def __init__(
        self,
        capture: Capture,
        cameras: Cameras,
        character: Character,
        appearance: Appearance,
        key_poses: dict[int, Pose],
        features: FeatureSettings,
        ahead: FlowAhead | None = None,
    ):
        self.capture = capture
        self.cameras = cameras
        self.character = character
        self.appearance = appearance
        self.key_poses = key_poses
        self.features = features
        self.ahead = FlowAhead() if ahead is None else ahead
        self._tables: dict[tuple[int, int], np.ndarray] = {}
        self._selected: dict[tuple[int, int], FrameFeatures] = {}

    def start(self) -> Background:
        """Begin a sequence with nothing seen yet: the next frame is its first."""
        return (CameraBackground(),) * self.cameras.num_cameras

    def distances(
        self, known: Background, shown: FrameImages, rectangle: Rectangle, pose: Pose, labels: list[np.ndarray]
    ) -> tuple[list[Float[np.ndarray, "height width"]], Background]:
        """Compute psi_b in every view's rectangle, and what is known of the background with this frame.

        `pose` is the prediction, `labels` are the palette's colours in the rectangles.
        """
        settings = self.appearance.settings
        if settings.behind == "none":
            return [np.ones((rectangle.height, rectangle.width), np.float32) for _ in shown.images], known
        people = full_image_ids(self.character, skin(self.character, pose), self.cameras, shown.frame)

        def one(camera: int) -> tuple[np.ndarray, CameraBackground]:
            image, person = shown.images[camera], people[camera] >= 0
            if settings.behind == "plate":
                plate, after = self._plate(known[camera], camera, shown.frame, image, person)
                return plate.distance(rectangle.window(camera)), after
            warps, after = [], known[camera]
            for selected in self.appearance.selected_for(shown.frame):
                warp, after = self._warp(after, camera, selected, shown.frame, image, person)
                warps.append((selected, warp))
            return self._grid_distance(camera, warps, rectangle, labels[camera]), after

        with ThreadPoolExecutor(cores()) as pool:
            found = list(pool.map(one, range(len(shown.images))))
        return [distance for distance, _ in found], tuple(after for _, after in found)

    def learn(self, known: Background, shown: FrameImages, rectangle: Rectangle, pose: Pose) -> Background:
        """Update the background after a frame has been tracked: its clean plates show what the frame has uncovered."""
        if self.appearance.settings.behind != "plate":
            return known
        people = full_image_ids(self.character, skin(self.character, pose), self.cameras, shown.frame)

        def learnt(camera: int) -> CameraBackground:
            plate = known[camera].plate
            if plate is None or plate.frame != shown.frame:
                return known[camera]
            return replace(known[camera], plate=plate.learnt(people[camera] >= 0, rectangle.window(camera)))

        with ThreadPoolExecutor(cores()) as pool:
            return tuple(pool.map(learnt, range(len(known))))

    def _selected_picture(self, camera: int, selected: int) -> tuple[np.ndarray, np.ndarray]:
        """Image and person mask of a selected frame; without a mask the registered mesh takes its place."""
        frame = self.appearance.selected_frames[selected]
        mask = self.capture.mask(camera, frame)
        if mask is None:
            vertices = skin(self.character, self.key_poses[frame])
            mask = full_image_ids(self.character, vertices, self.cameras, frame)[camera] >= 0
        return self.capture.image(camera, frame), mask

    def _plate(
        self,
        known: CameraBackground,
        camera: int,
        frame: int,
        image: np.ndarray,
        person: Bool[np.ndarray, "height width"],
    ) -> tuple[CleanPlate, CameraBackground]:
        """Make the camera's plate at a frame: warped on from the frame before, or built from the selected ones."""
        before, settings = known.plate, self.appearance.settings
        if before is None or abs(before.frame - frame) > LONGEST_GAP:
            selected = self.appearance.selected_frames
            plate = None
            for s in sorted(range(len(selected)), key=lambda s: (abs(selected[s] - frame), s)):
                around = plate_beside(*self._selected_picture(camera, s), settings.plate)
                warp, known = self._warp(known, camera, s, frame, image, person)
                warped = warped_plate(around, warp, settings.grid)
                plate = warped if plate is None else plate.filled_from(warped)
            assert plate is not None
            before = CleanPlate(settings, frame, plate, image, person)
        now = before.at(frame, image, person, partial(self.ahead.between, camera))
        return now, replace(known, plate=now)

    def _warp(
        self,
        known: CameraBackground,
        camera: int,
        selected: int,
        frame: int,
        image: np.ndarray,
        person: Bool[np.ndarray, "height width"],
    ) -> tuple[GridWarp, CameraBackground]:
        """Warp the background grid of a selected frame to this frame (sec. 4.1)."""
        settings, size = self.appearance.settings, image.shape[:2]
        if frame == self.appearance.selected_frames[selected]:
            nothing = np.zeros((0, 2))
            return warp_grid(nothing, nothing, size, settings.warp, grid=settings.grid), known
        if (camera, selected) not in self._selected:
            picture, mask = self._selected_picture(camera, selected)
            self._selected[camera, selected] = frame_features(picture, mask, self.features.mask_growth, self.features)
        matches = match_background(
            self._selected[camera, selected],
            None,
            image,
            person,
            self.features,
            previous=known.matches.get(selected),
        )
        warp = warp_grid(*matches, size, settings.warp, known.warps.get(selected), grid=settings.grid)
        return warp, replace(
            known, warps={**known.warps, selected: warp}, matches={**known.matches, selected: (image, matches)}
        )

    def _grid_distance(
        self,
        camera: int,
        warps: list[tuple[int, GridWarp]],
        rectangle: Rectangle,
        labels: np.ndarray,
    ) -> Float[np.ndarray, "height width"]:
        """Psi_b in the rectangle from the colour models of the warped grids (the paper)."""
        rows, columns = rectangle.window(camera)
        distances = []
        for selected, warp in warps:
            if (camera, selected) not in self._tables:
                self._tables[camera, selected] = np.asarray(self.appearance.background_table(camera, selected))
            distances.append(
                background_distance(
                    self._tables[camera, selected],
                    warp,
                    labels,
                    origin=(rows.start, columns.start),
                    grid=self.appearance.settings.grid,
                )
            )
        return np.min(distances, axis=0)
