"""The radiance of grains: what light is divided by where they share it, and rare bright paths."""

import dataclasses
import math

import numpy as np
import pytest

from holopath_addon import engine

GREEN = 516.5e-9


def test_what_light_is_divided_by(build):
    """Reflectances alone, whatever the bumps and lobes; surfaces that have none show their light as it is."""
    import mitsuba as mi

    from holopath_addon.engine.scene.specular_chains import FirstHits
    from holopath_addon.engine.tracing import grains

    def shown(bsdf):
        bumps = {"type": "bumpmap", "scale": 0.02, "bump": build.texture(64, 3) | {"raw": True}}
        scene = build.scene(pane=build.plane(1.0, {"bsdf": bumps | {"worn": bsdf}}, slant=2))
        x = mi.Float(np.linspace(-0.2, 0.2, 64))
        ray = mi.Ray3f(mi.Point3f(x, 0.1, 0), mi.Vector3f(0, 0, -1))
        seen = FirstHits().view(scene, ray, mi.UInt32(0))
        return np.array(grains.reflectance_of(scene, seen, mi.Bool(True))[0])

    matt, gloss = {"type": "matt", "reflectance": build.gray(0.3)}, {"type": "gloss", "roughness": 0.2}
    for bare in ({"type": "roughdielectric"}, {"type": "roughconductor"}, gloss):
        np.testing.assert_array_equal(shown(bare), 1)
    worn = shown({"type": "mixture", "mode": "over", "a": matt, "b": gloss | {"ior": 1.5}, "weight": 1.0})
    assert 0.27 < worn.min() and worn.max() < 0.35


def test_what_light_is_divided_by_is_the_same_from_both_sides(build):
    """As it was not: where a wall whose normals point away met another one, and at the contours of smooth things."""
    import mitsuba as mi

    from holopath_addon.engine.scene.specular_chains import FirstHits
    from holopath_addon.engine.tracing import grains

    matt = {"type": "matt", "reflectance": build.gray(0.3)}
    gloss = {"type": "gloss", "roughness": 0.2, "ior": 1.5}
    for bsdf in (
        matt,
        matt | {"translucent": True},
        matt | {"roughness": build.gray(0.5)},
        {"type": "mixture", "mode": "over", "a": matt, "b": gloss, "weight": 1.0},
    ):
        scene = build.scene(pane=build.plane(1.0, {"bsdf": bsdf}, slant=2))
        sides = []
        for z in (0, -2):
            ray = mi.Ray3f(mi.Point3f(0.01, 0.01, z), mi.Vector3f(0, 0, -1 - z))
            seen = FirstHits().view(scene, ray, mi.UInt32(0))
            assert seen.surface.is_valid()[0]
            sides.append(np.array(grains.reflectance_of(scene, seen, mi.Bool(True))[0]).ravel())
        np.testing.assert_allclose(*sides, rtol=1e-4)
        assert 0.27 < sides[0].min() and sides[0].max() < 0.35


@pytest.mark.slow
def test_rare_bright_paths_do_not_destroy_grains(build, camera):
    """A wall lit by a lamp, and a little by a bulb behind glass, which paths find once in thousands."""
    hologram = engine.Hologram(128, 128, 8e-6, (GREEN,), 0.3e-3, 1.5e-3)
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    lamp = build.T().look_at(origin=[1.0, 1.5, 0.5], target=[0, 0, -1], up=[0, 1, 0]).scale(0.5)
    scene = build.scene(
        wall=build.plane(1.0, build.diffuse(build.gray(0.7)), 0.4),
        lamp={"type": "rectangle", "to_world": lamp, **build.emissive(build.gray(8.0))},
        shell={"type": "sphere", "center": [0.25, 0, -0.85], "radius": 0.02, "bsdf": glass},
        bulb={
            "type": "sphere",
            "center": [0.25, 0, -0.85],
            "radius": 0.003,
            **build.emissive(build.gray(3000.0)),
        },
    )
    settings = engine.Settings(frames=24, fixed={"filter": 0})  # which would spread them
    plan = engine.plan(scene, camera, hologram, settings)
    spots, means = [], []
    for limit in (plan.radiance_limit, math.inf):
        chosen = dataclasses.replace(plan, radiance_limit=limit)
        field = engine.render(scene, camera, hologram, settings, chosen)
        picture = engine.reconstruct(field, [1.0])[0, 16:-16, 16:-16, 0]
        spots.append(picture.max() / np.median(picture))
        means.append(picture.mean())
    assert spots[0] < 5 < 10 < spots[1]
    assert 0.6 * means[1] < means[0] < means[1]  # what is cut is lost


def test_chunks_together_or_apart(build, camera, monkeypatch):
    """However many a machine traces at once, the same light."""
    from holopath_addon.engine.tracing import grains, measurement

    monkeypatch.setattr(grains, "CHUNK_PATHS", 1 << 13)
    monkeypatch.setattr(grains, "UNIT_PATHS", 1 << 11)
    hologram = engine.Hologram(48, 48, 8e-6, (516.5e-9,), 1e-3, 2e-3)
    settings = engine.Settings(frames=1, method="full", fixed={"passes": 6})
    view = build.two_planes(build.emissive), camera, hologram, settings
    plan, found, parts = engine.plan(*view), [], []
    for size in (1, 2, 100):

        def paced(chunks, most, size=size):
            parts.append(len(chunks))
            return (chunks[first : first + size] for first in range(0, len(chunks), size))

        monkeypatch.setattr(measurement, "paced", paced)
        found.append(engine.render(*view, plan).data)
    assert min(parts) > 2
    assert np.array_equal(found[0], found[1]) and np.array_equal(found[0], found[2])


def test_blocks_together_or_apart(build, camera, monkeypatch):
    """Neighboring blocks are traced as one where that is quick: the same field, and each of the blocks is given."""
    from holopath_addon.engine.tracing import wave_tracer

    hologram = engine.Hologram(72, 64, 8e-6, (516.5e-9, 640e-9), 1e-3, 2e-3)
    settings = engine.Settings(frames=3, method="full", quality="preview")
    view = build.two_planes(build.emissive), camera, hologram, settings
    plan, fields, launches = engine.plan(*view), [], []
    original = wave_tracer._join
    for rays, at_once in ((1 << 22, 1), (1 << 14, 1), (1 << 14, 100)):

        def join(blocks, max_pixels, at_once=at_once):
            joined = original(blocks[:at_once], max_pixels)
            launches.append(len(joined))
            return joined

        monkeypatch.setattr(wave_tracer, "CHUNK_RAYS", rays)
        monkeypatch.setattr(wave_tracer, "_join", join)
        monkeypatch.setattr(wave_tracer.Pace, "together", 100, raising=False)
        monkeypatch.setattr(
            wave_tracer.Pace,
            "__init__",
            lambda self, max_units, first=1: setattr(self, "_max_units", max_units),
        )
        fields.append(engine.render(*view, plan).data)
    assert launches.count(1) > 4 and max(launches) > 2
    assert np.array_equal(fields[0], fields[1]) and np.array_equal(fields[0], fields[2])


def test_sums_ordered_on_a_card_are_the_same(build, camera, monkeypatch):
    """A card orders a launch's sums in its own memory: as the processor does it, in one launch or several."""
    from holopath_addon.engine.scene import variants
    from holopath_addon.engine.tracing import wave_kernel, wave_tracer

    hologram = engine.Hologram(72, 64, 8e-6, (516.5e-9, 640e-9), 1e-3, 2e-3)
    settings = engine.Settings(frames=3, method="full", quality="preview")
    view = build.two_planes(build.emissive), camera, hologram, settings
    plan = engine.plan(*view)
    field = engine.render(*view, plan).data
    monkeypatch.setattr(wave_kernel, "activate", lambda: variants.CUDA)
    monkeypatch.setattr(wave_tracer, "CHUNK_RAYS", 1 << 15)
    for at_first in (1, 16):
        monkeypatch.setattr(wave_tracer, "units_at_first", lambda at_first=at_first: at_first)
        assert np.array_equal(engine.render(*view, plan).data, field)
