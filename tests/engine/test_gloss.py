"""Gloss: highlights move with the view, and roughness changes how sharp they are."""

import math

import pytest

from benchmarks.optics import displacement
from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping

GREEN = 516.5e-9


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [0.1, pytest.param(0.2, marks=pytest.mark.slow)])
def test_highlights_move_with_the_pupil(build, camera, small, roughness):
    """Views half a degree to either side: highlights are where Mitsuba's thin lens has them."""
    scene = build.glossy_dome(roughness)
    settings = engine.Settings(frames=24)
    plan = engine.plan(scene, camera, small, settings)
    mapping = DepthMapping.of(small, camera, plan.near)
    radius = mapping.pupil_radius(small.max_slope(GREEN))
    aside = math.tan(math.radians(0.5)) * mapping.beta / mapping.focal
    field = engine.render(scene, camera, small, settings, plan)
    errors = []
    for x in (-aside, aside):
        pupil = engine.Pupil(x, 0, 0.6 * radius)
        (picture,) = engine.reconstruct(field, [0.81], pupil)
        (truth,) = engine.reference(scene, camera, small, [0.81], pupil, spp=96, near=plan.near)
        errors.append(displacement(picture, truth))
    assert abs(errors[1] - errors[0]) < 0.5


def test_recording_plane_keeps_away_from_gloss(build, camera, small):
    """A pixel of the plane holds one direction's worth of light where the surface lies on it."""
    sharp = engine.plan(build.glossy_dome(0.1), camera, small)
    z = sharp.planes[0].z
    assert not sharp.z_low <= z <= sharp.z_high
    assert min(abs(z - sharp.z_low), abs(z - sharp.z_high)) > 0.9 * small.depth_of_focus
    assert sharp.bins > engine.plan(build.glossy_dome(0.4), camera, small).bins
    matt = engine.plan(build.glossy_dome(0.9), camera, small)
    assert matt.bins == 1  # one that hardly turns across the pupil
    assert matt.planes[0].z == pytest.approx(0.5 * (matt.z_low + matt.z_high))
