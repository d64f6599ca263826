"""Values kept between launches are no literals, which Dr.Jit 1.5 may widen (docs/theory.md, "A trap of Dr.Jit")."""

import gc
import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.hologram import Hologram
from holopath_addon.engine.mapping import DepthMapping

GREEN = 516.5e-9


def kept(owner, path=""):
    """Name and value of each Dr.Jit number among an object's attributes, those of its vectors and lists too."""
    import drjit as dr

    parts = vars(owner) if hasattr(owner, "__dict__") else {}
    pending = [(f"{path}.{name}", value) for name, value in parts.items()]
    while pending:
        name, value = pending.pop()
        if dr.is_array_v(value) and dr.depth_v(value) == 1:
            yield name, value
        elif isinstance(value, (list, tuple)) or dr.is_array_v(value) and dr.is_vector_v(value):
            pending += [(f"{name}[{k}]", part) for k, part in enumerate(value)]


def literals(*owners):
    import drjit as dr

    found = [pair for owner in owners for pair in kept(owner, type(owner).__name__)]
    assert found  # that it looks where there is something
    return [name for name, value in found if value.state == dr.VarState.Literal]


def test_the_one_function(backend):
    """Whatever it makes keeps its width."""
    import drjit as dr
    import mitsuba as mi

    from holopath_addon.engine.scene.buffers import constant

    for width in (8, 5):
        axis = constant(mi.Vector3f, np.array([0.0, 1.0, -0.0]))
        wide = dr.arange(mi.Float, width)
        dr.eval(wide * axis, dr.select(mi.Bool(True), axis, wide), dr.fma(axis, axis, wide))
        assert [dr.width(part) for part in axis] == [1, 1, 1]
    assert np.ravel(axis).tolist() == [0, 1, 0]


@pytest.fixture
def level():
    return engine.Camera(np.eye(4), 0.6)


@pytest.fixture
def hologram():
    return Hologram(16, 12, 8e-6, (GREEN,), 1e-3, 2e-3)


def test_rays_and_lens(backend, level, hologram):
    from holopath_addon.engine.scene.rays import Rays
    from holopath_addon.engine.viewing.preview import CameraLens

    rays = Rays(hologram, level, DepthMapping.of(hologram, level, 0.5), 1e-3)
    lens = CameraLens(level, 16, 12, math.inf)
    assert literals(rays, lens) == []


def test_what_a_recording_keeps(build, level, hologram):
    from holopath_addon.engine.progress import Clock
    from holopath_addon.engine.tracing.recording import Recording

    settings = engine.Settings(frames=1, quality="preview", method="full")
    scene = build.two_planes(build.emissive)
    recording = Recording(scene, level, hologram, engine.plan(scene, level, hologram, settings), Clock())
    plane, other = recording.plan.planes
    assert plane.slab.bounded and other.slab.bounded
    radiance = recording.radiance(lambda done: None)
    part = recording._part(plane, radiance, 0, 0.0)
    owners = recording.tracer, radiance, part.rays, part.estimator
    assert literals(*owners) == []


@pytest.mark.parametrize(
    "lamp",
    [
        {"type": "point_lamp", "intensity": [1.0, 0.0, 1.0], "cone": 0.5, "radius": 0.0},
        {"type": "area_lamp", "radiance": [0.0, 1.0, 1.0], "width": 1.0, "height": 0.5, "spread": 0.3},
        {"type": "sun_lamp", "irradiance": [1.0, 1.0, 0.0], "radius": 0.0},
    ],
)
def test_lamps(backend, lamp):
    import mitsuba as mi

    lamp["to_world"] = mi.ScalarTransform4f()
    assert literals(mi.load_dict(lamp)) == []


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("gloss", {"ior": 1.5, "roughness": 0.3}),
        ("glass", {"ior": 1.0}),
        ("mixture", {"a": {"type": "diffuse"}, "b": {"type": "null"}, "fresnel_ior": 1.0, "facing": 1.0}),
    ],
)
def test_closures(backend, kind, more):
    import mitsuba as mi

    assert literals(mi.load_dict({"type": kind, **more})) == []


def programs(work, min_operations=1):
    """Hashes of the programs of so many operations at least that some work launches, those that it times, too."""
    import drjit as dr

    found, take_history = [], dr.kernel_history

    def heard():
        found.extend(new := take_history())
        return new

    dr.kernel_history_clear()
    with pytest.MonkeyPatch.context() as patched, dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        patched.setattr(dr, "kernel_history", heard)
        work()
        heard()
    return {k["hash"] for k in found if (k.get("operation_count") or 0) >= min_operations}


def test_one_program_for_all_sizes_and_distances(build, camera):
    """Another number of pixels, and a scene elsewhere: what took a second to compile serves again."""
    found = []
    for size, depth in ((32, 1.0), (40, 1.4)):
        scene = build.scene(wall=build.plane(depth, build.diffuse(build.gray(0.5))), sky={"type": "constant"})
        hologram = Hologram(size, size, 8e-6, (GREEN,), 0.3e-3, 1.5e-3)
        settings = engine.Settings(frames=2, method="full", fixed={"passes": 8, "slabs": 4 + size // 8})
        found.append(programs(lambda h=hologram, s=scene, w=settings: engine.render(s, camera, h, w), 1000))
        del scene
        gc.collect()  # beside other scenes programs are others: they hold the numbers of objects
    assert found[0] and found[1] <= found[0]


def test_numpys_memory_is_no_part_of_a_program(build):
    """Wherever it begins: at each multiple of four bytes within the widest vector."""
    import drjit as dr

    from holopath_addon.engine.scene.buffers import loaded

    numbers, found = np.arange(200, dtype=np.float32), set()
    for start in range(16):
        values = loaded(build.mi.Float, numbers[start : start + 100])
        np.testing.assert_array_equal(values, numbers[start : start + 100])
        found |= programs(lambda v=values: dr.eval(dr.sin(v) + v))
    assert len(found) == 1
