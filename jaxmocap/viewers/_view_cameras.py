"""The cameras of the viewer's page, and the eyes of its visitors."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ._first_view import FIELD_OF_VIEW, first_view
from ._shown import Shown

_BEHIND = 3.0  # metres from the person to the picture behind it, seen through a camera
_IN_FRUSTUM, _ON_SCREEN = 320, 960  # pixels of the longer side of a camera's picture, small and looked at


class CameraViews:
    """Frusta with the images where the cameras are; and, for who looks through one, its image as a wall behind the
    person. `chosen` is called with a camera's index when its frustum is clicked."""

    def __init__(self, server: Any, shown: Shown, chosen: Callable[[int], None]):
        self._server, self._shown = server, shown
        self._middle = shown.motion.joints.mean(axis=(0, 1)).astype(float)
        self.frusta, self.screens = [], []
        blank = np.zeros((2, 2, 3), np.uint8)
        for index, name in enumerate(shown.camera_names):
            width, height = shown.motion.cameras.sizes[index]
            fov, aspect = self._fov(index), width / height
            depth = shown.frustum_depth(index)
            volume = np.cbrt(np.tan(fov / 2) ** 2 * aspect / 3)  # viser scales frusta to one volume
            look = {"fov": fov, "aspect": aspect, "scale": depth * volume, "color": (60, 60, 60)}
            frustum = server.scene.add_camera_frustum(f"/cameras/{index}", **look)
            frustum.on_click(lambda _, index=index: chosen(index))
            server.scene.add_label(f"/cameras/{index}/name", name)
            screen = server.scene.add_image(f"/screens/{index}", blank, 1.0, 1.0, visible=False)
            self.frusta.append(frustum)
            self.screens.append(screen)

    def place(self, position: int, through: int | None, with_cameras: bool) -> None:
        """Put the frusta where the cameras are at a position of the motion, and whoever looks through one there."""
        for index, frustum in enumerate(self.frusta):
            frustum.wxyz, frustum.position, _ = self._pose_of(index, position)
            frustum.visible = with_cameras and through is None
        if through is not None:
            for client in self._server.get_clients().values():
                self.lead(client, position, through)

    def read_images(self, position: int, through: int | None, with_images: bool) -> dict[int, np.ndarray]:
        """Decode what `show_images` needs of a position, by camera; nothing is drawn."""
        if not with_images:
            return {}
        sides = {through: _ON_SCREEN} if through is not None else dict.fromkeys(range(len(self.frusta)), _IN_FRUSTUM)
        read = {index: self._shown.image(index, position, side) for index, side in sides.items()}
        return {index: image for index, image in read.items() if image is not None}

    def show_images(self, position: int, through: int | None, images: dict[int, np.ndarray]) -> None:
        """Show what the cameras saw, in the frusta or behind the person for who looks `through` one."""
        for index, (frustum, screen) in enumerate(zip(self.frusta, self.screens, strict=True)):
            screen.visible = through == index and index in images
            if screen.visible:
                self._place_screen(index, position, screen, images[index])
            elif through is None:
                frustum.image = images.get(index)

    def lead(self, client: Any, position: int, through: int | None) -> None:
        """Put a visitor's eye where a camera was; or, free, where person, ground and cameras are seen from outside."""
        if through is not None:
            _, place, rotation = self._pose_of(through, position)
            target = place + rotation[:, 2] * float(np.linalg.norm(self._middle - place))
            up, fov = -rotation[:, 1], self._fov(through)
        else:
            eye = first_view(*self._shown.scene(position), float(client.camera.aspect))
            place, target, up, fov = eye.position, eye.target, eye.up, FIELD_OF_VIEW
        with client.atomic():
            client.camera.fov, client.camera.up_direction = fov, up
            client.camera.position, client.camera.look_at = place, target

    def welcome(self, client: Any, position: int, through: int | None) -> None:
        """Lead a new visitor, and anew when their window changes its shape and they have not looked round yet."""
        self.lead(client, position, through)
        led = {"aspect": client.camera.aspect, "place": client.camera.position}

        def reshaped(_: Any) -> None:
            camera = client.camera
            still = np.allclose(camera.position, led["place"], atol=1e-3)
            if still and through is None and abs(camera.aspect - led["aspect"]) > 1e-3:
                led["aspect"] = camera.aspect
                self.lead(client, position, None)
                led["place"] = camera.position

        client.camera.on_update(reshaped)

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
        world_from_cam = self._shown.world_from_cam(index, position)
        rotation = world_from_cam[:3, :3]
        return Rotation.from_matrix(rotation).as_quat(scalar_first=True), world_from_cam[:3, 3], rotation

    def _fov(self, index: int) -> float:
        """Compute the vertical field of view, radians."""
        cameras = self._shown.motion.cameras
        return float(2 * np.arctan(cameras.sizes[index][1] / (2 * float(cameras.intrinsics[index, 1, 1]))))
