"""Run by Blender, not by pytest: `blender -b -P read_in_blender.py -- FILE FRAMES_PER_SECOND SECONDS OUT.json`.

Imports a GLB, BVH or FBX, or opens a .blend file, and writes what stands where at SECONDS: heads of bones, vertices of
meshes, cameras. Blender's world has z up; its importers stand files with y up upright.
"""

import builtins
import json
import sys

import bpy
import numpy

# The importers of Blender 3.4 expect an older NumPy and an older Python than Debian 12 runs them with.
if "bool" not in vars(numpy):
    numpy.bool = bool


def open_as_before(file, mode="r", **options):
    return builtins.open(file, mode.replace("U", ""), **options)


path, rate, seconds, out = sys.argv[sys.argv.index("--") + 1 :]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = int(rate)
frame = float(seconds) * int(rate)
if path.endswith(".bvh"):
    from io_anim_bvh import import_bvh

    import_bvh.open = open_as_before
    bpy.ops.import_anim.bvh(filepath=path, axis_forward="-Z", axis_up="Y", frame_start=1)
    frame = 1 + float(seconds) * int(rate)
elif path.endswith(".fbx"):
    bpy.ops.import_scene.fbx(filepath=path, anim_offset=0.0)
elif path.endswith(".blend"):
    bpy.ops.wm.open_mainfile(filepath=path)
    scene = bpy.context.scene
else:
    bpy.ops.import_scene.gltf(filepath=path)
scene.frame_set(int(frame // 1), subframe=frame % 1)
graph = bpy.context.evaluated_depsgraph_get()
found = {"bones": {}, "vertices": {}, "cameras": {}}
for each in scene.objects:
    if each.type == "ARMATURE":
        for bone in each.evaluated_get(graph).pose.bones:
            found["bones"][bone.name] = list(each.matrix_world @ bone.head)
    elif each.type == "MESH" and any(modifier.type == "ARMATURE" for modifier in each.modifiers):
        posed = each.evaluated_get(graph)
        found["vertices"][each.name] = [list(posed.matrix_world @ v.co) for v in posed.to_mesh().vertices]
    elif each.type == "CAMERA":
        here = each.evaluated_get(graph)
        pose = [list(row) for row in here.matrix_world]
        lens = {"focal": here.data.lens / here.data.sensor_width, "shift": [here.data.shift_x, here.data.shift_y]}
        found["cameras"][each.name] = {"pose": pose, "angle_y": here.data.angle_y, **lens}
with open(out, "w") as file:
    json.dump(found, file)
