"""USD exports, posed by Pixar's own UsdSkel."""

from dataclasses import replace

import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.exporters import export

pxr = pytest.importorskip("pxr")


@pytest.mark.parametrize(("name", "form"), [("dance.usda", {}), ("dance.usdc", {"units": "cm", "up": "z"})])
def test_the_skin_and_the_cameras_are_the_motion_s(motion, tmp_path, name, form):
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(export(motion, tmp_path / name, **form)))
    per_metre = 100 if form else 1
    assert UsdGeom.GetStageUpAxis(stage) == form.get("up", "y").upper()
    assert UsdGeom.GetStageMetersPerUnit(stage) == pytest.approx(1 / per_metre)
    rate = stage.GetTimeCodesPerSecond()
    assert rate == pytest.approx(5 / 0.167)
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if form else np.eye(3)
    cache = UsdSkel.Cache()
    root = UsdSkel.Root.Get(stage, "/World/Actor")
    cache.Populate(root, Usd.PrimDefaultPredicate)
    mesh = UsdGeom.Mesh.Get(stage, "/World/Actor/Mesh")
    query = cache.GetSkinningQuery(mesh.GetPrim())
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton.Get(stage, "/World/Actor/Skeleton"))
    for frame in (0, 3, 5):
        code = motion.timestamps[frame] * rate
        points = mesh.GetPointsAttr().Get()
        assert query.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(code), points, code)
        np.testing.assert_allclose(np.array(points) / per_metre, motion.vertices(frame) @ turn.T, atol=1e-4)
        for index, view in enumerate(motion.cameras.names):
            frustum = UsdGeom.Camera.Get(stage, f"/World/Cameras/{view}").GetCamera(code).frustum
            seen = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
            for joint in motion.joints[frame, ::7].astype(float):
                x, y, _ = seen.Transform((per_metre * turn @ joint).tolist())
                width, height = motion.cameras.sizes[index]
                pixel = np.asarray(motion.cameras.intrinsics[index], float) @ (
                    np.asarray(motion.cameras.cam_from_world[index, frame], float)[:3] @ [*joint, 1]
                )
                expected = pixel[:2] / pixel[2]
                np.testing.assert_allclose([(x + 1) * width / 2, (1 - y) * height / 2], expected, atol=0.05)


@pytest.mark.parametrize(
    ("names", "called"),
    [
        (("1", "2"), ("cam_1", "cam_2")),
        (("cam-1", "cam_1"), ("cam_1", "cam_1_2")),
        (("Actor", "cam 1"), ("Actor", "cam_1")),
    ],
)
def test_cameras_of_any_name_have_a_place_of_their_own(motion, tmp_path, names, called):
    from pxr import Usd

    renamed = replace(motion, cameras=replace(motion.cameras, names=names))
    stage = Usd.Stage.Open(str(export(renamed, tmp_path / "dance.usda")))
    cameras = stage.GetPrimAtPath("/World/Cameras").GetChildren()
    assert [camera.GetName() for camera in cameras] == list(called)
    assert [camera.GetCustomDataByKey("name") for camera in cameras] == list(names)
    assert stage.GetPrimAtPath("/World/Actor").GetTypeName() == "SkelRoot"


def test_without_usd_core_the_sentence_says_what_to_install(motion, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pxr", None)
    with pytest.raises(InputError, match=r"pip install 'jaxmocap\[usd\]'"):
        export(motion, tmp_path / "dance.usd")
    assert list(tmp_path.iterdir()) == []
