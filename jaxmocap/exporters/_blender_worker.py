"""Run by Blender or by a Python that has its module, in a process of its own: `_blender_worker.py JOB.json`.

The job names a GLB (`scene`), the file to write (`out`, `.fbx` or `.blend`), its `rate` and number of `frames`, and of
every camera, by its object in the GLB, the `name` it gets, `size` and `intrinsics`. Blender's world has z up; FBX is
written with y up, in metres.
"""

import json
import sys
from pathlib import Path
from typing import Any

import bpy  # pyright: ignore[reportMissingImports]
import numpy

if "bool" not in vars(numpy):
    numpy.bool = bool  # the importer of Blender 3.4 expects an older NumPy than Debian 12 runs it with


def set_lens(camera: Any, size: tuple[int, int], intrinsics: list[list[float]]) -> None:
    """Give a camera the focal length and the principal point of its videos, which glTF has no place for."""
    width, height = size
    camera.sensor_fit = "HORIZONTAL"
    camera.lens = intrinsics[0][0] / width * camera.sensor_width
    camera.shift_x = 0.5 - intrinsics[0][2] / width
    camera.shift_y = (intrinsics[1][2] - height / 2) / width


def known(operator: Any, **options: Any) -> dict[str, Any]:
    """Keep the options that this version of Blender knows."""
    names = operator.get_rna_type().properties.keys()
    return {name: value for name, value in options.items() if name in names}


job = json.loads(Path(sys.argv[-1]).read_text(encoding="utf-8"))
bpy.ops.wm.read_factory_settings(use_empty=True)
for addon in ("io_scene_gltf2", "io_scene_fbx"):
    if addon not in bpy.context.preferences.addons:
        bpy.ops.preferences.addon_enable(module=addon)
scene = bpy.context.scene
scene.render.fps = max(round(job["rate"]), 1)
scene.render.fps_base = scene.render.fps / job["rate"]
load = bpy.ops.import_scene.gltf
load(filepath=job["scene"], **known(load, disable_bone_shape=True))
for each in list(scene.objects):
    if any(collection.name.startswith("glTF_not_exported") for collection in each.users_collection):
        bpy.data.objects.remove(each)  # what older importers draw bones with
cameras = [bpy.data.objects[name] for name in job["cameras"]]
for camera, lens in zip(cameras, job["cameras"].values(), strict=True):
    set_lens(camera.data, lens["size"], lens["intrinsics"])
    camera.name = camera.data.name = lens["name"]
if cameras:
    scene.camera = cameras[0]
    scene.render.resolution_x, scene.render.resolution_y = next(iter(job["cameras"].values()))["size"]
scene.frame_start, scene.frame_end = 0, job["frames"] - 1
scene.frame_set(0)
if job["out"].endswith(".blend"):
    bpy.ops.wm.save_as_mainfile(filepath=job["out"], compress=True)
else:
    save = bpy.ops.export_scene.fbx
    save(
        filepath=job["out"],
        **known(
            save,
            object_types={"ARMATURE", "MESH", "CAMERA"},
            add_leaf_bones=False,
            bake_anim=True,
            bake_anim_use_all_bones=True,
            bake_anim_use_nla_strips=False,
            bake_anim_use_all_actions=False,
            bake_anim_simplify_factor=0.0,
            path_mode="COPY",
            embed_textures=True,
        ),
    )
print("done")
