"""Poses of an animated scene after an import into Blender (`pip install bpy`)."""

import os
import subprocess
import sys

import numpy as np
import pytest

from evo_cpg.view.gltf_film import gltf_film
from evo_cpg.view.scene import Panel
from view import synthetic

# An interpreter with bpy. Each bpy version supports a single Python version.
_PYTHON = os.environ.get("BLENDER_PYTHON", sys.executable)
_PLAY = """
import os, sys, numpy as np, bpy
path, out, *names = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=path)
scene, times, found = bpy.context.scene, np.load(out), []
for time in times:
    frame = float(time) * scene.render.fps
    scene.frame_set(int(frame), subframe=frame - int(frame))
    found.append([np.array(bpy.data.objects[name].matrix_world) for name in names])
np.save(out, np.array(found))
os._exit(0)  # bpy may crash at exit
"""


def test_blender_shows_the_recorded_poses(tmp_path):
    if subprocess.run([_PYTHON, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("Blender's Python module bpy is not installed")
    creature, recording = synthetic.swimmer(), synthetic.swim(4.0)
    scene, out = tmp_path / "scene.glb", tmp_path / "times.npy"
    scene.write_bytes(gltf_film(Panel(creature, recording, "a title")))
    some = slice(None, None, max(1, len(recording.time) // 10))
    np.save(out, recording.time[some])
    names = [body.name for body in creature.bodies]
    subprocess.run([_PYTHON, "-c", _PLAY, scene, out, *names], check=True, capture_output=True)
    found = np.load(out)
    np.testing.assert_allclose(found[..., :3, 3], recording.position[some], atol=1e-5)
    # The import rotates the contents of each node to Blender's axes.
    turned = recording.rotation[some] @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    np.testing.assert_allclose(found[..., :3, :3], turned, atol=1e-5)
