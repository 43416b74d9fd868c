"""The cameras of the viewer's page, and the eyes of its visitors."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ._shown import Shown

_FRUSTUM = 0.6  # metres from a camera to its little picture
_BEHIND = 3.0  # metres from the person to the picture behind it, seen through a camera


class CameraViews:
    """Frusta with the images where the cameras are; and, for who looks through one, its image as a wall behind the
    person."""

    def __init__(self, server: Any, shown: Shown):
        self._server, self._shown = server, shown
        self._middle = shown.motion.joints.mean(axis=(0, 1)).astype(float)
        self.frusta, self.screens = [], []
        blank = np.zeros((2, 2, 3), np.uint8)
        for index, name in enumerate(shown.camera_names):
            width, height = shown.motion.cameras.sizes[index]
            look = {"fov": self._fov(index), "aspect": width / height, "scale": _FRUSTUM, "color": (60, 60, 60)}
            self.frusta.append(server.scene.add_camera_frustum(f"/cameras/{index}", **look))
            server.scene.add_label(f"/cameras/{index}/name", name)
            self.screens.append(server.scene.add_image(f"/screens/{index}", blank, 1.0, 1.0, visible=False))

    def draw(self, position: int, through: int | None, with_cameras: bool, with_images: bool) -> None:
        """Show the cameras at a position of the motion, or what the one looked `through` sees."""
        for index, (frustum, screen) in enumerate(zip(self.frusta, self.screens, strict=True)):
            frustum.wxyz, frustum.position, _ = self._pose_of(index, position)
            frustum.visible = with_cameras and through is None
            screen.visible = through == index and with_images
            image = self._shown.image(index, position) if with_images else None
            if screen.visible and image is not None:
                self._place_screen(index, position, screen, image)
            elif frustum.visible:
                frustum.image = image
        if through is not None:
            for client in self._server.get_clients().values():
                self.lead(client, position, through)

    def lead(self, client: Any, position: int, through: int | None) -> None:
        """Put a visitor's eye where a camera was; or, free, some steps before the person on the first camera's side."""
        axis = "xyz".index(self._shown.motion.up)
        if through is not None:
            _, place, rotation = self._pose_of(through, position)
            target = place + rotation[:, 2] * float(np.linalg.norm(self._middle - place))
            up, fov = -rotation[:, 1], self._fov(through)
        else:
            away = np.array([[1.0, -2.5, 2.5], [2.5, 1.0, 2.5], [2.5, -2.5, 1.0]])[axis]
            if self.frusta:
                _, place, rotation = self._pose_of(0, position)
                away = 0.75 * (place - self._middle) + 0.6 * rotation[:, 0] - 0.5 * rotation[:, 1]
            place, target, fov = self._middle + away, self._middle, 0.9
            up = np.eye(3)[axis]
        with client.atomic():
            client.camera.fov, client.camera.up_direction = fov, up
            client.camera.position, client.camera.look_at = place, target

    def _place_screen(self, index: int, position: int, screen: Any, image: np.ndarray) -> None:
        """Show the picture just as large as the camera sees it there."""
        k = np.asarray(self._shown.motion.cameras.intrinsics[index], float)
        width, height = self._shown.motion.cameras.sizes[index]
        wxyz, place, world_from_cam = self._pose_of(index, position)
        depth = float(np.linalg.norm(self._middle - place)) + _BEHIND
        centre = np.array([(width / 2 - k[0, 2]) / k[0, 0], (height / 2 - k[1, 2]) / k[1, 1], 1.0]) * depth
        screen.image = image
        screen.render_width, screen.render_height = depth * width / k[0, 0], depth * height / k[1, 1]
        screen.wxyz, screen.position = wxyz, place + world_from_cam @ centre

    def _pose_of(self, index: int, position: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a camera's rotation as a quaternion, its place, and the rotation `world_from_cam`."""
        cam_from_world = np.asarray(self._shown.motion.cameras.cam_from_world[index, position], np.float64)
        rotation = cam_from_world[:3, :3].T
        return Rotation.from_matrix(rotation).as_quat(scalar_first=True), -rotation @ cam_from_world[:3, 3], rotation

    def _fov(self, index: int) -> float:
        """Compute the vertical field of view, radians."""
        cameras = self._shown.motion.cameras
        return float(2 * np.arctan(cameras.sizes[index][1] / (2 * float(cameras.intrinsics[index, 1, 1]))))
