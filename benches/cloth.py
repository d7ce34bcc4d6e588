#!/usr/bin/env python3
"""Simulates a T-shirt and trousers on a walking body with cape and with Blender's cloth, in one run.

    pip install bpy==4.2.22 numpy        # Python 3.11
    python3.11 benches/cloth.py [--edge 18.7] [--frames 30] [--quality 5 15]

Prints seconds per frame of 1/30 s, and, of every fourth frame after one second of run-up: mean and
largest strain, depth and vertices inside the body by an independent measure (`cape_cloth::Penetration`),
and edges through cloth. Blender's cloth has the parameters of its cotton preset; waistbands are pinned
where cape's are. `--cargo` is the command that builds.
"""
import argparse, json, pathlib, shlex, struct, subprocess, sys, tempfile, time

ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
ap.add_argument('--edge', type=float, default=18.7, help='length of edges, mm')
ap.add_argument('--frames', type=int, default=30, help='frames after the run-up')
ap.add_argument('--steps', type=int, default=8, nargs='*', help="cape's steps a frame")
ap.add_argument('--quality', type=int, default=[5, 15], nargs='*', help="Blender's quality steps")
ap.add_argument('--cargo', default='cargo')
ap.add_argument('--out', type=pathlib.Path, help='directory of scene and frames')
ap.add_argument('--blender', type=int, help=argparse.SUPPRESS)
a = ap.parse_args()


def cache(path, frames):
    """Writes vertices `[frames, vertices, 3]` as a point cache (PC2)."""
    header = struct.pack('<12siiffi', b'POINTCACHE2\0', 1, frames.shape[1], 0.0, 1.0, frames.shape[0])
    path.write_bytes(header + frames.astype('<f4').tobytes())


def blender(root, quality):
    """Simulates the scene in `root` with Blender, and writes `blender_QUALITY.npy`."""
    import bpy
    import numpy as np

    load = lambda name: np.load(root / f'{name}.npy')
    body, faces, rest, ours, band = map(load, ('body', 'faces', 'rest', 'ours', 'waistband'))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = 30
    scene.frame_start, scene.frame_end = 1, len(body)
    scene.gravity = (0.0, -9.81, 0.0)

    def add(name, vertices, triangles, frames):
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(vertices.tolist(), [], triangles.tolist())
        item = bpy.data.objects.new(name, mesh)
        scene.collection.objects.link(item)
        path = root / f'{name}.pc2'
        cache(path, frames)
        modifier = item.modifiers.new('cache', 'MESH_CACHE')
        modifier.cache_format, modifier.filepath = 'PC2', str(path)
        modifier.frame_start = 1
        return item

    obstacle = add('body', body[0], load('body_faces'), body)
    obstacle.modifiers.new('collision', 'COLLISION')
    obstacle.collision.thickness_outer = 0.003
    obstacle.collision.cloth_friction = 5.0
    placed = np.repeat(rest[None], len(body), 0)
    placed[1:, band] = ours[1:, band]
    worn = add('cloth', rest, faces, placed)
    pins = worn.vertex_groups.new(name='waistband')
    pins.add(band.tolist(), 1.0, 'REPLACE')
    cloth = worn.modifiers.new('cloth', 'CLOTH')
    settings, collisions = cloth.settings, cloth.collision_settings
    settings.quality = quality
    settings.mass = 0.3
    settings.tension_stiffness = settings.compression_stiffness = settings.shear_stiffness = 15.0
    settings.tension_damping = settings.compression_damping = settings.shear_damping = 5.0
    settings.bending_stiffness, settings.bending_damping = 0.5, 0.5
    settings.vertex_group_mass = 'waistband'
    collisions.distance_min = 0.003
    collisions.use_self_collision = True
    collisions.self_distance_min = 0.003
    cloth.point_cache.frame_start, cloth.point_cache.frame_end = 1, len(body)
    out = np.empty((len(body), len(rest), 3), np.float32)
    seconds = 0.0
    for frame in range(len(body)):
        start = time.perf_counter()
        scene.frame_set(frame + 1)
        mesh = worn.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        seconds += time.perf_counter() - start
        mesh.vertices.foreach_get('co', out[frame].reshape(-1))
    np.save(root / f'blender_{quality}.npy', out)
    (root / f'blender_{quality}.json').write_text(json.dumps({'seconds': seconds / len(body)}))


if a.blender is not None:
    blender(a.out, a.blender)
    sys.exit()

EXAMPLE = shlex.split(a.cargo) + ['run', '--quiet', '--release', '-p', 'cape-cloth', '--example', 'walking', '--']


def example(*command):
    return json.loads(subprocess.run([*EXAMPLE, *map(str, command)], check=True, stdout=subprocess.PIPE).stdout)


with tempfile.TemporaryDirectory() as temporary:
    root = (a.out or pathlib.Path(temporary)).resolve()
    print(f'| simulator | s a frame | strain, mean | largest | deepest inside the body, mm | vertices inside | edges through cloth |')
    print('|---|---|---|---|---|---|---|', flush=True)

    def row(label, seconds, name):
        found = example('measure', root, name)
        print(f'| {label} | {seconds:.3f} | {found["mean_strain"]:.2%} | {found["largest_strain"]:.0%} | '
              f'{found["penetration_mm"]:.1f} | {found["vertices_inside"]} | {found["crossings"]} |', flush=True)

    for steps in a.steps if isinstance(a.steps, list) else [a.steps]:
        result = example('simulate', root, a.edge, a.frames, steps)
        row(f'cape, {steps} steps a frame, {result["vertices"]} vertices', result['seconds'], 'ours')
    for quality in a.quality:
        subprocess.run([sys.executable, __file__, '--out', root, '--blender', str(quality)], check=True,
                       stdout=subprocess.DEVNULL)
        seconds = json.loads((root / f'blender_{quality}.json').read_text())['seconds']
        row(f'Blender 4.2, quality {quality}', seconds, f'blender_{quality}')
