"""Life of the extension in Blender, and of renders in the extension. Nothing of either stays.

Whole life cycles run in a Python of their own: they load HoloPath and Mitsuba anew.
"""

import gc
import json
import os
import subprocess
import sys
import textwrap
import weakref
from pathlib import Path

import bpy
import numpy as np
import pytest

from distribution import extension
from distribution.wheels import this_platform
from tests.patience import NEVER

ROOT = Path(__file__).parents[2]
PLATFORM = this_platform()


def run(code, folder, *arguments, **environment):
    """Run a program in a Blender with its own user folders; the JSON that it prints last."""
    folder.mkdir()
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)],
        cwd=folder,
        env=os.environ
        | {
            "PYTHONPATH": str(Path(__file__).parents[1] / "in_blender"),
            "BLENDER_USER_RESOURCES": str(folder / "user"),
            "BLENDER_USER_EXTENSIONS": str(folder / "user" / "extensions"),
        }
        | environment,
        capture_output=True,
        text=True,
        timeout=NEVER,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "Traceback" not in result.stderr, result.stderr
    return json.loads(result.stdout.splitlines()[-1])


@pytest.fixture
def zipped(tmp_path):
    """The extension without wheels: the Python that runs the tests has them."""
    return extension.build(PLATFORM, "3.11", [], tmp_path / "dist")


INSTALL = """
    import json, os, sys
    del os.environ["DRJIT_CACHE_DIR"]  # of the tests
    import bpy
    import addon_utils
    from traces import modules, traces

    name, result = "bl_ext.user_default.holopath", {"before": traces()}

    def install():
        bpy.ops.extensions.package_install_files(filepath=sys.argv[1], repo="user_default", enable_on_install=True)
        return sys.modules[name + ".engine.scene.variants"], sys.modules[name + ".blender.preferences"].store().folder

    variants, result["store"] = install()
    result["enabled"] = traces()
    result["file"] = sys.modules[name].__file__
    result["programs"] = os.environ["DRJIT_CACHE_DIR"]
    variants.activate()
    addon_utils.disable(name, default_set=True)
    result["disabled"] = traces()
    result["forgotten"] = "DRJIT_CACHE_DIR" not in os.environ
    addon_utils.enable(name, default_set=True)
    bpy.ops.script.reload()
    result["reloaded"] = traces()

    renewed, _ = install()
    result["renewed"] = traces()
    renewed.activate()
    import mitsuba as mi
    glass = type(mi.load_dict({"type": "dispersive_dielectric"}))
    result["plugin"] = glass.__init__.__globals__ is vars(sys.modules[name + ".engine.scene.dispersion"])
    result["anew"] = renewed is not variants

    addon_utils.disable("cycles")  # the exporter does without it
    session = sys.modules[name + ".operators.session"]
    bpy.context.scene.render.film_transparent = True
    result["notes"] = session.prepare(bpy.context.evaluated_depsgraph_get(), bpy.context.scene.holopath).notes
    addon_utils.enable("cycles")

    place = [repository.module for repository in bpy.context.preferences.extensions.repos].index("user_default")
    bpy.ops.extensions.package_uninstall(repo_index=place, pkg_id="holopath")
    result["left"] = os.listdir(os.path.dirname(result["programs"])) if os.path.exists(result["programs"]) else []
    result["uninstalled"], result["modules"] = traces(), modules(name)
    print("\\n" + json.dumps(result, default=str))
"""


def test_from_installing_to_uninstalling(tmp_path, zipped):
    result = run(INSTALL, tmp_path / "blender", zipped, HOLOPATH_CACHE="")
    installed = tmp_path / "blender" / "user" / "extensions"
    assert Path(result["file"]).is_relative_to(installed / "user_default" / "holopath")
    assert Path(result["store"]).is_relative_to(installed / ".user")
    assert Path(result["programs"]).is_relative_to(installed / ".user") and result["forgotten"]
    assert "class HOLOPATH_OT_render_hologram" in result["enabled"]
    assert result["reloaded"] == result["renewed"] == result["enabled"]
    assert (
        result["before"]
        == result["disabled"]
        == result["uninstalled"]
        == result["modules"]
        == result["left"]
        == []
    )
    assert result["anew"], "the new version's modules are loaded"
    assert result["plugin"], "Mitsuba makes materials of the new version's classes"


CYCLES = """
    import ctypes, gc, json, os, sys, time
    import bpy
    sys.path.insert(0, sys.argv[1])
    import holopath_addon
    from holopath_addon.operators import session
    from holopath_addon.operators.jobs import Job

    # of glibc's struct mallinfo2: bytes in large blocks (5th field), bytes in the others (8th)
    class Allocated(ctypes.Structure):
        _fields_ = [(f"field_{k}", ctypes.c_size_t) for k in range(10)]

    mallinfo2 = ctypes.CDLL(None).mallinfo2
    mallinfo2.restype = Allocated

    def allocated():
        gc.collect()
        result = mallinfo2()
        return result.field_4 + result.field_7

    def cycle(number):
        holopath_addon.register()
        props = bpy.context.scene.holopath
        props.resolution_x = props.resolution_y = 32
        props.depth_far_mm, props.depth_near_mm = 0.6, 0.9
        props.frames, props.colours, props.quality = 1, "MONO", "preview"
        job = Job(session.prepare(bpy.context.evaluated_depsgraph_get(), props).compute)
        session.current.job = job
        job.start()
        while job.running and job.done < (0.0, 0.06, 0.2, 1.0)[number % 3 if number >= 0 else 3]:
            time.sleep(1e-3)
        if number % 2 and number > 0:
            job.cancel()
            assert job.wait(600)
        holopath_addon.unregister()  # which cancels what is at work
        assert not job.running and (number >= 0 or job.result is not None)
        return type(job.error).__name__

    def measured():
        return allocated(), len(os.listdir(os.environ["DRJIT_CACHE_DIR"]))

    cycle(-1)  # to the end: nearly all that is compiled is compiled before measuring
    ends = [cycle(number) for number in range(20)]
    measurements = [measured()]
    for number in range(20, int(sys.argv[2])):
        ends.append(cycle(number))
        measurements.append(measured())
    print(json.dumps({"ends": ends, "measurements": measurements}))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs glibc's mallinfo2")
def test_memory_after_200_cycles_of_enabling_canceling_and_disabling(tmp_path):
    programs = tmp_path / "programs"
    programs.mkdir()
    result = run(CYCLES, tmp_path / "blender", ROOT, 200, DRJIT_CACHE_DIR=str(programs))
    assert result["ends"].count("Cancelled") > 180, result["ends"]
    assert set(result["ends"]) <= {"Cancelled", "NoneType"}, result["ends"]
    memory, compiled = np.transpose(result["measurements"])
    # Compiled programs stay, and take memory of their own. A few come late: another number of a lamp, another choice of
    # a plan. Their files are written in the background, so one that a cycle compiled may be counted in the next.
    late = np.append(np.diff(compiled), 0) > 0
    grown = np.diff(memory)[~(late[:-1] | late[1:])].sum()
    assert late.sum() < 30, result["measurements"]
    assert grown <= 5e6, result["measurements"]  # 28 kB a cycle


@pytest.mark.parametrize("half", [0.01, 0.2, 0.8])
def test_a_canceled_job_lets_go_of_its_scene(scene, half):
    from holopath_addon import engine
    from holopath_addon.operators import session
    from holopath_addon.operators.jobs import Job

    class Canceling(Job):
        def _progress(self, done, message):
            if done >= half:
                self.cancel()
            super()._progress(done, message)

    task = session.prepare(bpy.context.evaluated_depsgraph_get(), scene.holopath)
    job, reference = Canceling(task.compute), weakref.ref(task)
    gc.collect()
    gc.disable()  # memory is needed sooner than Python looks for cycles
    try:
        job.start()
        del task
        assert job.wait(NEVER)
        assert isinstance(job.error, engine.Cancelled)
        assert reference() is None
    finally:
        gc.enable()


WITHOUT = """
    import json, sys
    for name in ("xatlas", "serial"):
        sys.modules[name] = None
    sys.path.insert(0, sys.argv[1])
    import bpy
    import holopath_addon
    from holopath_addon import cli
    holopath_addon.register()
    status = cli.main(sys.argv[2:])
    report = json.load(open("out/report.json"))
    result = {"status": status, "warnings": report["warnings"], "notes": report["export_notes"], **report["bake"]}
    print("\\n" + json.dumps(result))
"""


@pytest.mark.slow
def test_without_optional_packages(tmp_path):
    """Light is baked all the same, and a sentence says what is different."""
    scene = tmp_path / "room.blend"
    bpy.ops.wm.read_factory_settings(use_empty=False)
    tree = bpy.data.objects["Cube"].active_material
    if bpy.app.version < (5, 0, 0):
        tree.use_nodes = True
    nodes = tree.node_tree.nodes
    principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    tree.node_tree.links.new(
        nodes.new("ShaderNodeTexNoise").outputs["Color"], principled.inputs["Base Color"]
    )
    bpy.ops.wm.save_as_mainfile(filepath=str(scene), copy=True)
    options = (
        "--method fast --resolution 32x32 --frames 1 --wavelengths 516 --quality preview --quiet --no-cache"
    )
    result = run(WITHOUT, tmp_path / "blender", ROOT, "render", scene, "--out", "out", *options.split())
    assert result["status"] == 0
    assert result["texels"] > 0 and result["dense"] > 0
    assert [warning for warning in result["warnings"] if "xatlas" in warning]
    assert [note for note in result["notes"] if "xatlas" in str(note)]
