"""Opens an animation of `cape animate` in Blender's Python module, as glTF and as point caches.

usage: python blender.py DIRECTORY

DIRECTORY has glb/, pc2/ and mdd/, one animation in each format; a report.json in each. The glTF is also
exported as FBX and read back, as the book describes.
"""

import json
import pathlib
import sys

import bpy
import numpy as np

VERTICES, JOINTS = 6890, 24


def of(kind):
    return next(thing for thing in bpy.context.scene.objects if thing.type == kind)


def evaluated(thing, frame):
    """Vertices in the world, [n, 3], at a frame of the scene."""
    bpy.context.scene.frame_set(int(frame), subframe=frame - int(frame))
    mesh = thing.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    vertices = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", vertices)
    world = np.array(thing.matrix_world)
    return vertices.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]


def fresh(rate):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = rate


def imported_glb(path, report):
    rate = round(report["frames_per_second"])
    fresh(rate)
    bpy.ops.import_scene.gltf(filepath=str(path))
    body, skeleton = of("MESH"), of("ARMATURE")
    assert len(body.data.vertices) == VERTICES, len(body.data.vertices)
    assert len(skeleton.data.bones) == JOINTS, len(skeleton.data.bones)
    # The basis, and a key for each frame whose vertices are stored.
    keys = body.data.shape_keys.key_blocks
    assert len(keys) == report["keyframes"] + 1, (len(keys), report)
    action = skeleton.animation_data.action
    first, last = action.frame_range
    assert abs(last - first - (report["frames"] - 1)) < 1e-3, (first, last, report)
    frames = [first + k for k in (0, report["frames"] // 2, report["frames"] - 1)]
    posed = [evaluated(body, frame) for frame in frames]
    low, high = posed[0].min(0), posed[0].max(0)
    # Blender has z up.
    height = high[2] - low[2]
    assert 1.4 < height < 2.1 and height > 2 * (high[1] - low[1]), (low, high)
    return posed


def expect_cache(directory, extension, report, expected):
    """A point cache on its mesh gives the vertices that the glTF has, within the tolerance."""
    fresh(round(report["frames_per_second"]))
    bpy.ops.wm.obj_import(filepath=str(directory / "animation.obj"))
    body = of("MESH")
    assert len(body.data.vertices) == VERTICES, len(body.data.vertices)
    cache = body.modifiers.new("cache", "MESH_CACHE")
    cache.cache_format = extension.upper()
    cache.filepath = str(directory / f"animation.{extension}")
    cache.frame_start = 0
    for frame, wanted in zip((0, report["frames"] // 2, report["frames"] - 1), expected):
        error = np.linalg.norm(evaluated(body, frame) - wanted, axis=1).max()
        assert error < 1.5e-3, f"{extension}, frame {frame}: {error} m"


def expect_fbx(path, glb, report, expected):
    fresh(round(report["frames_per_second"]))
    # Without the shapes that show bones in Blender.
    bpy.ops.import_scene.gltf(filepath=str(glb), disable_bone_shape=True)
    bpy.ops.export_scene.fbx(filepath=str(path), object_types={"ARMATURE", "MESH"}, add_leaf_bones=False)
    fresh(round(report["frames_per_second"]))
    bpy.ops.import_scene.fbx(filepath=str(path))
    body, skeleton = of("MESH"), of("ARMATURE")
    assert len(body.data.vertices) == VERTICES, len(body.data.vertices)
    assert len(skeleton.data.bones) == JOINTS, len(skeleton.data.bones)
    assert len(body.data.shape_keys.key_blocks) == report["keyframes"] + 1
    first, last = skeleton.animation_data.action.frame_range
    assert abs(last - first - (report["frames"] - 1)) < 1, (first, last, report)
    for frame, wanted in zip((0, report["frames"] // 2, report["frames"] - 1), expected):
        error = np.linalg.norm(evaluated(body, first + frame) - wanted, axis=1).max()
        assert error < 3e-3, f"fbx, frame {frame}: {error} m"


def main():
    place = pathlib.Path(sys.argv[1])
    reports = {kind: json.loads((place / kind / "animation.json").read_text()) for kind in ("glb", "pc2", "mdd")}
    posed = imported_glb(place / "glb" / "animation.glb", reports["glb"])
    for extension in ("pc2", "mdd"):
        expect_cache(place / extension, extension, reports[extension], posed)
    expect_fbx(place / "animation.fbx", place / "glb" / "animation.glb", reports["glb"], posed)
    print(f"Blender {bpy.app.version_string}: glb, pc2, mdd and fbx as expected")


if __name__ == "__main__":
    main()
