"""The built extension in a real Blender, named by HOLOPATH_BLENDER.

It is installed from its file, used on the command line and in the background, and last in a window: that
needs a display, or a HOLOPATH_BLENDER that brings one.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.in_blender.conftest import BLENDER
from tests.patience import NEVER, SOON
from tests.real_blender import Blender

ROOT = Path(__file__).parents[2]
WINDOW = Path(__file__).with_name("window.py")
LIFECYCLE = Path(__file__).with_name("lifecycle.py")

pytestmark = [pytest.mark.blender, pytest.mark.slow]


def test_installs_and_enables(blender):
    code = (
        "import bpy, addon_utils\n"
        "name = 'bl_ext.user_default.holopath'\n"
        "print('enabled', name in bpy.context.preferences.addons, all(addon_utils.check(name)))\n"
        "print('registered', hasattr(bpy.types.Scene, 'holopath'))\n"
        "addon_utils.disable(name)\n"
        "print('gone', not hasattr(bpy.types.Scene, 'holopath'))\n"
    )
    status, output = blender("--background", "--python-exit-code", "3", "--python-expr", code)
    assert status == 0, output
    for line in ("enabled True True", "registered True", "gone True"):
        assert line in output, output


def test_command_line(blender):
    status, output = blender("--command", "holopath", "devices")
    assert status == 0, output
    assert "llvm_ad_rgb" in output
    status, output = blender("--command", "holopath", "cache")
    assert status == 0, output
    assert blender.environment["BLENDER_USER_RESOURCES"] in output, output


PIPE = """
import subprocess
process = subprocess.Popen(["true"], stdin=subprocess.PIPE, bufsize=0)
process.wait()
try:
    process.stdin.write(b"a picture")
except BrokenPipeError:
    print("raised")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGPIPE")
def test_a_program_that_ends_does_not_end_blender(blender):
    """A write to a closed display window, a stopped ffmpeg or a dead worker raises an exception."""
    status, output = blender("--background", "--python-exit-code", "3", "--python-expr", PIPE)
    assert status == 0 and "raised" in output, (status, output)


def test_the_census_is_that_of_this_blender(blender):
    script = Path(__file__).with_name("census.py")
    _, output = blender("--background", "--factory-startup", "--python", script)
    assert "properties of types" in output and "of nodes" in output, output


# A lit mesh on a textured plane, with settings under which nothing depends on how fast this machine is.
MAKE = """
import bpy, sys
path, texture = sys.argv[-2:]
scene = bpy.context.scene
bpy.data.objects.remove(bpy.data.objects["Cube"])
scene.camera.location, scene.camera.rotation_euler = (0, 0, 2), (0, 0, 0)
bpy.data.objects["Light"].location, bpy.data.objects["Light"].data.energy = (0.5, 0.6, 2), 40
bpy.ops.mesh.primitive_monkey_add(size=0.5, location=(0, 0, 1.2))
bpy.ops.mesh.primitive_plane_add(size=3)
material = bpy.data.materials.new("Grid")
if bpy.app.version < (5, 0, 0):
    material.use_nodes = True
tree = material.node_tree
principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
picture = tree.nodes.new(texture)
if texture == "ShaderNodeTexImage":
    picture.image = bpy.data.images.new("Grid", 64, 64)
    picture.image.generated_type = "COLOR_GRID"
tree.links.new(picture.outputs["Color"], principled.inputs["Base Color"])
bpy.context.object.data.materials.append(material)
props = scene.holopath
props.resolution_x = props.resolution_y = 96
props.depth_far_mm, props.depth_near_mm = 1.25, 1.875
props.frames, props.quality, props.method, props.seed = 2, "preview", "full", 3
bpy.ops.wm.save_as_mainfile(filepath=path)
"""


def difference(folder, other):
    """Largest difference of two stored wave fields, in parts of the largest amplitude; 0: every bit is the same."""
    first, second = (np.load(Path(f) / "wavefield" / "field.npy") for f in (folder, other))
    assert first.shape == second.shape and abs(first).max() > 0
    return float(abs(first - second).max() / abs(first).max())


@pytest.mark.parametrize("texture", ["ShaderNodeTexImage", "ShaderNodeTexNoise"])
def test_the_same_field_without_a_window(blender, tmp_path, texture):
    """Fields of --background, --command and the button are the same; also of the bpy module, except baked textures.

    There the atlas differs: its charts come from another build of xatlas, or from none.
    """
    scene = tmp_path / "scene.blend"
    (tmp_path / "make.py").write_text(MAKE)
    status, output = blender(
        "--background", "--python-exit-code", "3", "--python", tmp_path / "make.py", "--", scene, texture
    )
    assert status == 0, output
    words = ["render", scene, "--focus", "1m", "--quiet", "--out"]
    status, output = blender("--command", "holopath", *words, tmp_path / "command")
    assert status == 0, output
    package = Path(blender.environment["BLENDER_USER_EXTENSIONS"]) / "user_default" / "holopath"
    for name, main in (("tree", ROOT / "holopath_addon"), ("installed", package)):
        main = main / "__main__.py"
        status, output = blender("--background", scene, "--python", main, "--", *words, tmp_path / name)
        assert status == 0, output
        assert difference(tmp_path / "command", tmp_path / name) == 0
    press = f"bpy.ops.holopath.render_hologram(); bpy.ops.holopath.save_field(directory={str(tmp_path / 'button')!r})"
    status, output = blender(
        "--background", scene, "--python-exit-code", "3", "--python-expr", f"import bpy; {press}"
    )
    assert status == 0, output
    assert difference(tmp_path / "command", tmp_path / "button") == 0
    if texture == "ShaderNodeTexImage":
        command = [sys.executable, "-m", "holopath_addon", *map(str, words), str(tmp_path / "module")]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=NEVER, check=False)
        assert done.returncode == 0, done.stderr
        assert difference(tmp_path / "command", tmp_path / "module") == 0


def test_bad_input_without_a_window(blender, tmp_path):
    words = ["render", tmp_path / "missing.blend", "--out", tmp_path / "out"]
    script = ["--python", ROOT / "holopath_addon" / "__main__.py", "--", *words]
    for way in (
        ["--background", *script],
        ["--background", "--python-exit-code", "5", *script],
        ["--command", "holopath", *words],
    ):
        status, output = blender(*way)
        assert status == 2, output
        assert "holopath: The scene" in output and "Traceback" not in output


def test_renders_in_the_background(blender, tmp_path):
    target = tmp_path / "picture.exr"
    code = (
        "import bpy\n"
        "scene = bpy.context.scene\n"
        "scene.render.engine = 'HOLOPATH'\n"
        "scene.render.resolution_x = scene.render.resolution_y = 128\n"
        "scene.render.image_settings.file_format = 'OPEN_EXR'\n"
        "scene.holopath.depth_far_mm, scene.holopath.depth_near_mm = 2, 3\n"
        "scene.holopath.frames = 2\n"
        "scene.holopath.quality = 'preview'\n"
        f"scene.render.filepath = {str(target)!r}\n"
        "bpy.ops.render.render(write_still=True)\n"
        "image = bpy.data.images.load(scene.render.filepath)\n"
        "print('size', *image.size, 'light', max(image.pixels[:][0::4]) > 0.05)\n"
    )
    status, output = blender("--background", "--python-exit-code", "3", "--python-expr", code)
    assert status == 0, output
    assert "size 128 128 light True" in output, output


def test_window(blender, tmp_path):
    """Steps of a user in the window, see window.py; the field is that of the command line for the same file."""
    target = tmp_path / "result.json"
    status, output = blender(
        "--enable-event-simulate", "--python-exit-code", "3", "--python", WINDOW, "--", target
    )
    assert target.exists(), output
    result = json.loads(target.read_text(encoding="utf-8"))
    print(json.dumps(result, indent=1))
    assert "error" not in result, f"{result}\n{output}"
    assert status == 0, output
    steps = "rendered refocused encoded canceled undone deleted not opened reopened dragged f12 alive"
    assert " ".join(result["steps"]) == steps
    assert result["pressed"] == ["RUNNING_MODAL"] and result["twice"] is False
    assert result["size"] == [256, 256] and result["middle"] > 5 * result["corners"]
    # A window that waited for the work would stand still in one gap, as long as all of it.
    again = result["gaps_again"]
    assert again["longest"][0][0] < again["seconds"] / 2 and again["count"] > 3
    assert result["refocus"] < SOON and result["canceled"] < SOON
    assert result["played"] > 2 and result["stopped"] is True
    assert result["phases"] == [4, True, True]
    assert result["kept"] is True
    assert result["undone"] == "" and result["deleted"] == ["", True] and result["reopened"] == [True, True]
    # baked by the button, and by F12 from its own thread
    assert result["f12"] is True and [len(notes) for notes in result["baked"]] == [1, 1]
    assert result["scenes"] == 1
    assert "camera" in result["without_camera"]
    assert result["broken"] == [True, True]
    assert result["estimating"] and result["estimated"] > 0
    half_way, undone = result["dragged"]
    assert half_way > 0.1 and undone < 1e-6
    assert 3 < result["f12_focus"] < 6  # the cube's distance

    scene, window, command = (f"{target}{end}" for end in (".blend", "", ".command"))
    words = ["render", scene, "--quiet", "--focus", "1m", "--out", command]
    status, output = blender("--command", "holopath", *words)
    assert status == 0, output
    first = np.load(f"{window}.wavefield/field.npy")
    assert np.array_equal(first, np.load(f"{command}/wavefield/field.npy"))


def test_life_cycle(blender, tmp_path):
    """Rendering, canceling, disabling, reloading and uninstalling leave nothing behind."""
    target, own = tmp_path / "result.json", tmp_path / "user"
    shutil.copytree(blender.folder, own, symlinks=True)
    status, output = Blender(own, [BLENDER])("--python-exit-code", "3", "--python", LIFECYCLE, "--", target)
    assert target.exists(), output
    result = json.loads(target.read_text(encoding="utf-8"))
    assert "error" not in result, f"{result}\n{output}"
    assert status == 0, output
    assert result["steps"] == ["rendered", *3 * ["Cancelled"], "rendered", "rendered"]
    # the scene that was rendered last is kept, for an encoding that wants references of it
    assert (result["tasks"], result["held"]) == (5, 1), "exported scenes stay in memory"
    assert result["held_disabled"] == 0
    assert "class HOLOPATH_OT_render_hologram" in result["enabled"]
    assert result["enabled_again"] == result["reloaded"] == result["enabled"]
    assert result["disabled"] == result["disabled_again"] == result["uninstalled"] == []
    assert result["modules"] == result["known"] == result["wheels"] == []
    assert "Traceback" not in output, output
