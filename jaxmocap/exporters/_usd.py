"""USD: the skinned actor on our own joints, its clip, and the cameras as they moved."""

import errno
import importlib
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.motion import Motion

from ._exporter import ExportForm
from ._glb import GL_FROM_CV, quaternions
from ._prepare import UPRIGHT, mean_rate_of

_APERTURE = 36.0  # horizontal, millimetres: full frame
_NEAR, _FAR = 0.01, 1000.0  # clipping planes, metres


def write_usd(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write UsdSkel with time samples at the motion's own timestamps; unlike glTF's, cameras have a principal point."""
    try:
        (Tf,) = _pxr("Tf")
    except ImportError:
        raise InputError(
            f"{form.name} needs usd-core, which is not installed; run pip install 'jaxmocap[usd]', or write a .glb."
        ) from None
    try:
        _write(motion, path, form)
    except Tf.ErrorException as error:
        raise OSError(errno.EIO, str(error).strip().splitlines()[-1]) from None


def _write(motion: Motion, path: Path, form: ExportForm) -> None:
    Gf, Sdf, Usd, UsdGeom = _pxr("Gf", "Sdf", "Usd", "UsdGeom")
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, form.up.upper())
    UsdGeom.SetStageMetersPerUnit(stage, 1 / form.per_metre)
    rate = form.frame_rate or mean_rate_of(motion)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    codes = motion.timestamps * rate
    stage.SetStartTimeCode(float(codes[0]))
    stage.SetEndTimeCode(float(codes[-1]))
    world = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(world.GetPrim())
    lasting = {"generator": "jaxmocap", "frames": " ".join(map(str, motion.frames)), "status": " ".join(motion.status)}
    world.GetPrim().SetCustomData(lasting)
    _add_actor(stage, motion, form, codes)
    if motion.cameras is not None:
        poses = np.linalg.inv(np.asarray(motion.cameras.cam_from_world, np.float64))
        UsdGeom.Scope.Define(stage, "/World/Cameras")
        called = _prim_names(motion.cameras.names)
        for index, (name, size) in enumerate(zip(motion.cameras.names, motion.cameras.sizes, strict=True)):
            camera = UsdGeom.Camera.Define(stage, f"/World/Cameras/{called[index]}")
            k = np.asarray(motion.cameras.intrinsics[index], np.float64)
            _set_lens(camera, k, size, form)
            camera.GetPrim().SetCustomDataByKey("name", name)
            camera.GetPrim().SetCustomDataByKey("size", Gf.Vec2i(*size))
            distortion = [float(value) for value in np.asarray(motion.cameras.distortion[index])]
            camera.GetPrim().CreateAttribute("distortionOfRecording", Sdf.ValueTypeNames.FloatArray).Set(distortion)
            placed = camera.AddTransformOp()
            for code, pose in zip(codes, poses[index], strict=True):
                matrix = pose.copy()
                matrix[:3, :3] = pose[:3, :3] @ GL_FROM_CV
                matrix[:3, 3] *= form.per_metre
                placed.Set(Gf.Matrix4d(matrix.T.tolist()), float(code))
    stage.GetRootLayer().Save()


def _set_lens(camera: Any, k: Float[np.ndarray, "3 3"], size: tuple[int, int], form: ExportForm) -> None:
    (Gf,) = _pxr("Gf")
    width, height = size
    focal = _APERTURE * k[0, 0] / width
    upright = focal * height / k[1, 1]
    camera.CreateFocalLengthAttr(float(focal))
    camera.CreateHorizontalApertureAttr(_APERTURE)
    camera.CreateVerticalApertureAttr(float(upright))
    camera.CreateHorizontalApertureOffsetAttr(float(_APERTURE * (0.5 - k[0, 2] / width)))
    camera.CreateVerticalApertureOffsetAttr(float(upright * (k[1, 2] / height - 0.5)))
    camera.CreateClippingRangeAttr(Gf.Vec2f(_NEAR * form.per_metre, _FAR * form.per_metre))


def _add_actor(stage: Any, motion: Motion, form: ExportForm, codes: Float[np.ndarray, " frame"]) -> None:
    Gf, Sdf, UsdGeom, UsdSkel, Vt = _pxr("Gf", "Sdf", "UsdGeom", "UsdSkel", "Vt")
    character, skeleton = motion.character, motion.character.skeleton
    upright, scale = UPRIGHT[form.up], form.per_metre
    paths: list[str] = []
    for body, parent in enumerate(skeleton.parents):
        paths.append((f"{paths[parent]}/" if parent >= 0 else "") + skeleton.body_names[body])
    joints = skeleton.joints.astype(np.float64)
    bodies = motion.body_transforms.astype(np.float64)
    turns = bodies[:, :, :3, :3] @ upright.T
    places = np.einsum("tbij,bj->tbi", bodies[:, :, :3, :3], joints) + bodies[:, :, :3, 3]
    local_turns, local_places = turns.copy(), places.copy()
    rest = joints @ upright.T
    local_rest = rest.copy()
    for body, parent in list(enumerate(skeleton.parents))[1:]:
        above = turns[:, parent].swapaxes(1, 2)
        local_turns[:, body] = above @ turns[:, body]
        local_places[:, body] = np.einsum("tij,tj->ti", above, places[:, body] - places[:, parent])
        local_rest[body] = rest[body] - rest[parent]
    moved = lambda place: Gf.Matrix4d(1).SetTranslate(Gf.Vec3d(*(scale * place)))  # noqa: E731
    root = UsdSkel.Root.Define(stage, "/World/Actor")
    rig = UsdSkel.Skeleton.Define(stage, "/World/Actor/Skeleton")
    rig.CreateJointsAttr(paths)
    rig.CreateBindTransformsAttr(Vt.Matrix4dArray([moved(place) for place in rest]))
    rig.CreateRestTransformsAttr(Vt.Matrix4dArray([moved(place) for place in local_rest]))
    clip = UsdSkel.Animation.Define(stage, "/World/Actor/Clip")
    clip.CreateJointsAttr(paths)
    clip.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1)] * len(paths)))
    smooth = np.stack([quaternions(local_turns[:, body]) for body in range(len(paths))], axis=1)
    turned, shifted = clip.CreateRotationsAttr(), clip.CreateTranslationsAttr()
    for frame, code in enumerate(codes):
        values = [Gf.Quatf(float(w), float(x), float(y), float(z)) for x, y, z, w in smooth[frame]]
        turned.Set(Vt.QuatfArray(values), float(code))
        shifted.Set(Vt.Vec3fArray.FromNumpy((scale * local_places[frame]).astype(np.float32)), float(code))
    UsdSkel.BindingAPI.Apply(rig.GetPrim()).CreateAnimationSourceRel().SetTargets([clip.GetPath()])

    mesh = UsdGeom.Mesh.Define(stage, "/World/Actor/Mesh")
    points = (scale * np.asarray(character.vertices, np.float64) @ upright.T).astype(np.float32)
    faces = np.asarray(character.faces, np.int32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    weights = np.asarray(character.weights, np.float32)
    most = int(np.count_nonzero(weights, axis=1).max())
    order = np.argsort(-weights, axis=1, kind="stable")[:, :most]
    chosen = np.take_along_axis(weights, order, axis=1)
    binding.CreateJointIndicesPrimvar(False, most).Set(Vt.IntArray.FromNumpy(order.astype(np.int32).ravel()))
    binding.CreateJointWeightsPrimvar(False, most).Set(Vt.FloatArray.FromNumpy(chosen.ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    binding.CreateSkeletonRel().SetTargets([rig.GetPath()])
    reach = scale * (motion.joints.min(axis=(0, 1)) - 0.5), scale * (motion.joints.max(axis=(0, 1)) + 0.5)
    root.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(*(float(v) for v in corner)) for corner in reach]))
    root.GetPrim().CreateAttribute("userProperties:rig", Sdf.ValueTypeNames.String).Set("jaxmocap")


def _prim_names(names: Sequence[str]) -> list[str]:
    """Make identifiers of names, each once: cam-1 and cam_1 become cam_1 and cam_1_2."""
    (Tf,) = _pxr("Tf")
    found: list[str] = []
    for name in names:
        plain = str(Tf.MakeValidIdentifier(f"cam_{name}" if name[:1].isdigit() else name))
        tries = (plain if number == 1 else f"{plain}_{number}" for number in count(1))
        found.append(next(one for one in tries if one not in found))
    return found


def _pxr(*names: str) -> tuple[Any, ...]:
    """Import modules of the optional usd-core, which has no types."""
    importlib.import_module("pxr")
    return tuple(importlib.import_module(f"pxr.{name}") for name in names)
