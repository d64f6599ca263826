"""The same .blend gives the same wave field by the button and on the command line, in another process."""

import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np

from holopath_addon.operators import session
from tests.patience import NEVER

ROOT = Path(__file__).parents[2]


def test_the_same_bits(lit, tmp_path):
    material = lit.objects["Wall"].active_material
    tree, picture = material.node_tree, bpy.data.images.new("Grid", 64, 64)
    picture.generated_type = "COLOR_GRID"
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = picture
    tree.links.new(texture.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    settings = lit.holopath
    settings.resolution_x = settings.resolution_y = 96
    settings.frames, settings.seed = 2, 3
    settings.method = "full"  # auto decides by measured speeds
    path = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
    words = ["render", path, "--focus", "0.5m", "--out", tmp_path / "out", "--quiet"]
    command = subprocess.Popen([sys.executable, "-m", "holopath_addon", *map(str, words)], cwd=ROOT)
    assert bpy.ops.holopath.render_hologram() == {"FINISHED"}
    assert command.wait(NEVER) == 0
    field = session.current.field.data
    assert field.shape == (2, 3, 96, 96) and abs(field).max() > 0
    np.testing.assert_array_equal(np.load(tmp_path / "out" / "wavefield" / "field.npy"), field)
