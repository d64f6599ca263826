"""Cameras along all axes, level, upright and rolled, one after another in a process with other sizes between.

Their axes are full of zeros and ones, which Dr.Jit 1.5 takes for literals and may widen (docs/theory.md).
"""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.cli import sources

ROOT = Path(__file__).parents[1]
GREEN = 516.5e-9
VIEWS = {  # forward, up
    "forward": ((0, 1, 0), (0, 0, 1)),
    "backward": ((0, -1, 0), (0, 0, 1)),
    "right": ((1, 0, 0), (0, 0, 1)),
    "left": ((-1, 0, 0), (0, 0, 1)),
    "up": ((0, 0, 1), (0, 1, 0)),
    "down": ((0, 0, -1), (0, 1, 0)),
    "on its side": ((0, 1, 0), (1, 0, 0)),
    "upside down": ((1, 0, 0), (0, 0, -1)),
    "rolled": ((0, 1, 0), (1, 0, 1)),
    "level, between axes": ((1, 1, 0), (0, 0, 1)),
    "tilted": ((1, 2, -1), (0, 0, 1)),
}
WALLS = {(1, 0, 0): 0.8, (-1, 0, 0): 0.3, (0, 1, 0): 0.6, (0, -1, 0): 0.4, (0, 0, 1): 0.7, (0, 0, -1): 0.5}
LAMP, BALL = (-0.7, -0.6, 0.3), (0.1, 0.7, 0.0)  # what the first view sees is a mirror, in part
SETTINGS = engine.Settings(frames=3, quality="preview", method="full", phase_field="designed")

pytestmark = pytest.mark.usefixtures("one_thread")


def axes(forward, up):
    """Right, up and forward unit vectors of a view."""
    forward, up = (np.array(axis, float) for axis in (forward, up))
    forward /= np.linalg.norm(forward)
    up -= forward * (forward @ up)
    up /= np.linalg.norm(up)
    return np.cross(forward, up), up, forward


SENSOR = """<sensor type="perspective" id="{}"><float name="fov" value="40"/>
 <transform name="to_world"><lookat origin="0,0,0" target="{}" up="{}"/></transform></sensor>"""
WALL = """<shape type="rectangle"><transform name="to_world"><lookat origin="{0}" target="0,0,0" up="{1}"/></transform>
 <bsdf type="diffuse"><rgb name="reflectance" value="{2}"/></bsdf></shape>"""
THINGS = """<shape type="sphere"><point name="center" value="{}"/><float name="radius" value="0.1"/>
 <bsdf type="conductor"/></shape>
<emitter type="point"><point name="position" value="{}"/><rgb name="intensity" value="1"/></emitter>"""


def write_xml(path):
    """A room with a camera for each view, as a Mitsuba scene."""

    def words(values):
        return ",".join(map(str, values))

    parts = [SENSOR.format(name, *map(words, view)) for name, view in VIEWS.items()]
    parts += [WALL.format(words(n), words(n[1:] + n[:1]), albedo) for n, albedo in WALLS.items()]
    parts.append(THINGS.format(words(BALL), words(LAMP)))
    path.write_text(f'<scene version="3.0.0">{"".join(parts)}</scene>')


def write_blend(path):
    """The same as a Blender file."""
    import bpy
    from mathutils import Matrix

    from benchmarks.stage import Stage

    bpy.ops.wm.read_factory_settings(use_empty=True)
    stage = Stage()
    for name, view in VIEWS.items():
        camera = stage.link(bpy.data.objects.new(name, bpy.data.cameras.new(name)))
        camera.data.angle = np.radians(40)
        right, up, forward = axes(*view)
        camera.matrix_world = Matrix(np.stack([right, up, -forward], axis=1).tolist()).to_4x4()
    for normal, albedo in WALLS.items():
        color = stage.material("ShaderNodeBsdfDiffuse", Color=(albedo, albedo, albedo, 1))
        wall = stage.plane(2.0, color)
        right, up, forward = axes(normal, normal[1:] + normal[:1])
        wall.matrix_world = (
            Matrix.Translation(normal) @ Matrix(np.stack([right, up, -forward], axis=1)).to_4x4()
        )
    stage.sphere(0.1, stage.material("ShaderNodeBsdfGlossy", Roughness=0), BALL)
    stage.lamp("POINT", 10.0, LAMP, shadow_soft_size=0.0)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


WRITERS = {"xml": write_xml, "blend": write_blend}
LATER = ("forward", "down", "rolled")
CASES = [("xml", view) for view in VIEWS] + [("blend", view) for view in ("right", *LATER, "tilted")]


def render(source, view, width=16, height=16):
    """The camera's scene and the wave field of a view."""
    loaded = source.load(width, height, view)
    hologram = engine.Hologram(width, height, 8e-6, (GREEN,), depth_far=0.05e-3, depth_near=0.25e-3, near=0.5)
    return loaded, engine.render(loaded.scene, loaded.camera, hologram, SETTINGS)


def digest(field):
    return hashlib.sha256(np.ascontiguousarray(field.data).tobytes()).hexdigest()


@pytest.fixture(scope="module")
def path(request, backend, tmp_path_factory):
    """Path of a scene with all cameras."""
    if request.param == "blend":
        pytest.importorskip("bpy")
    path = tmp_path_factory.mktemp("cameras") / f"room.{request.param}"
    WRITERS[request.param](path)
    return path


@pytest.fixture(scope="module")
def source(path):
    return sources.open_source(str(path))


@pytest.fixture(scope="module")
def fields(source):
    """Digest of each view's wave field, made before any other of this scene in this process was."""
    return {}


@pytest.mark.parametrize(("path", "view"), CASES, indirect=["path"])
def test_all_axes_in_turn(source, fields, view):
    """Each, of two sizes by turns, is as bright as what a pinhole sees, where the aperture cuts nothing off."""
    size = (16, 16) if len(fields) % 2 == 0 else (20, 12)
    loaded, field = render(source, view, *size)
    fields[view] = digest(field), size
    inner = np.s_[3:-3, 3:-3]
    picture = engine.Preview(loaded.scene, loaded.camera, *size).refine(64)[inner][..., 1]
    image = engine.reconstruct(field, [1.0])[0, ..., 0][inner]
    assert image.mean() == pytest.approx(picture.mean(), rel=0.06)


@pytest.mark.parametrize(
    ("path", "view"),
    [("xml", v) for v in LATER] + [pytest.param("blend", v, marks=pytest.mark.slow) for v in LATER],
    indirect=["path"],
)
def test_again_after_others(source, fields, view):
    """The same to the last bit, as far as the test before found it."""
    found, size = fields.get(view) or (digest(render(source, view)[1]), (16, 16))
    assert digest(render(source, view, *size)[1]) == found


@pytest.mark.slow
@pytest.mark.parametrize(("path", "view"), CASES, indirect=["path"])
def test_as_in_a_process_of_its_own(path, source, view):
    words = [sys.executable, __file__, str(path), view]
    alone = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert alone.returncode == 0, alone.stderr
    assert alone.stdout.splitlines()[-1] == digest(render(source, view)[1])


if __name__ == "__main__":
    print(digest(render(sources.open_source(sys.argv[1]), sys.argv[2])[1]))
