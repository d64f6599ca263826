"""Visibility to a camera: clipping, mirrored views, an environment that only lights."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping

GREEN = 516.5e-9


@pytest.fixture
def display():
    return engine.Hologram(96, 96, 8e-6, (GREEN,), 0.3e-3, 1.8e-3)


def pictures(scene, camera, display, focus, spp=32, **settings):
    """Images of the hologram and by Mitsuba's thin lens, without the edges."""
    field = engine.render(scene, camera, display, engine.Settings(frames=24, **settings))
    truth = engine.reference(scene, camera, display, [focus], spp=spp, near=field.near)
    found = engine.reconstruct(field, [focus])
    return found[0, 10:-10, 10:-10, 0], truth[0, 10:-10, 10:-10, 0]


def test_round_trip():
    for camera in (
        engine.Camera(np.eye(4), 0.7),
        engine.Camera(np.eye(4), 0.7, 0.1, 0.2, 0.3, 40.0, sees_sky=False),
    ):
        again = engine.Camera.from_dict(camera.to_dict())
        assert again.to_dict() == camera.to_dict()
        assert again.clip_end == camera.clip_end
    old = {"to_world": np.eye(4).tolist(), "fov_x": 0.7}
    assert engine.Camera.from_dict(old).sees_sky


def halves(build, near, far, **others):
    """Left half of the view a dark plane at 1 m, behind it a bright one at 2 m."""
    return build.scene(
        near=build.plane(1.0, build.emissive(build.gray(near)), 0.5, x=-0.5),
        far=build.plane(2.0, build.emissive(build.gray(far)), 2.0),
        **others,
    )


def test_clip_end_cuts_what_is_beyond(build, camera, display):
    scene = halves(build, 0.2, 0.8)
    cut = replace(camera, clip_end=1.5)
    found, truth = pictures(scene, cut, display, 1.0)
    for picture in (found, truth):
        assert picture[:, 50:].max() < 0.02
        assert picture[:, :30].mean() == pytest.approx(0.2, rel=0.05)
    plan = engine.plan(scene, cut, display)
    assert plan.z_low == pytest.approx(plan.z_high, abs=1e-6)
    shifted = replace(cut, shift_x=1e-6)  # the reference without Mitsuba's own lens
    assert engine.reference(scene, shifted, display, [1.0], near=1.0)[0, :, 60:].max() == 0


def test_a_reflected_camera_sees_a_mirrored_view(build, camera, display):
    scene = halves(build, 0.2, 0.8)
    reflected = replace(camera, to_world=np.diag([-1.0, 1.0, 1.0, 1.0]))
    for mirrored, picture in zip(
        pictures(scene, reflected, display, 1.0), pictures(scene, camera, display, 1.0), strict=True
    ):
        assert mirrored[:, :30].mean() == pytest.approx(picture[:, -30:].mean(), rel=0.03)
        assert mirrored[:, -30:].mean() == pytest.approx(picture[:, :30].mean(), rel=0.03)
        assert mirrored[:, :30].mean() > 3 * mirrored[:, -30:].mean()


def lit_by_sky(build, bsdf=None):
    """A diffuse plane in the left half of the view, with the sky behind the viewer and around it."""
    bsdf = bsdf or {"type": "diffuse", "reflectance": build.gray(0.5)}
    return build.scene(
        near=build.plane(1.0, {"bsdf": {"type": "twosided", "bsdf": bsdf}}, 0.5, x=-0.5),
        sky={"type": "constant", "radiance": build.gray(0.8)},
    )


def test_an_unseen_sky_lights_the_scene(build, camera, display):
    scene, unseen = lit_by_sky(build), replace(camera, sees_sky=False)
    found, truth = pictures(scene, unseen, display, 1.0)
    for picture in (found, truth):
        assert picture[:, 50:].mean() < 0.01
        assert picture[:, :30].mean() == pytest.approx(0.4, rel=0.03)
    one = engine.Settings(planes=1)
    with_sky, without = (engine.plan(scene, c, display, one) for c in (camera, unseen))
    far = DepthMapping.of(display, camera, with_sky.near).z_far
    assert with_sky.z_low == pytest.approx(far)
    assert without.z_low == pytest.approx(without.z_high, abs=1e-5)
    assert without.rays_per_pixel < with_sky.rays_per_pixel / 3


def test_an_unseen_sky_is_seen_in_mirrors_only(build, camera, display):
    unseen = replace(camera, sees_sky=False)
    mirror = {"type": "conductor", "material": "none"}
    found, truth = pictures(lit_by_sky(build, mirror), unseen, display, math.inf)
    for picture in (found, truth):
        assert picture[:, 60:].mean() < 0.03
        assert picture[:, :20].mean() == pytest.approx(0.8, rel=0.05)


def test_an_unseen_sky_is_not_seen_through_masks(build, camera, display):
    """A half transparent pane before nothing, and before a plane."""
    pane = {
        "type": "mask",
        "opacity": 0.5,
        "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": build.gray(0.5)}},
    }
    scene = build.scene(
        pane=build.plane(0.8, {"bsdf": pane}, 3.0),
        back=build.plane(1.0, build.emissive(build.gray(1.0)), 0.5, x=-0.5),
        sky={"type": "constant", "radiance": build.gray(0.8)},
    )
    unseen = replace(camera, sees_sky=False)
    found, truth = pictures(scene, unseen, display, 1.0, spp=64)
    for picture in (found, truth):
        assert picture[:, :25].mean() == pytest.approx(0.5 + 0.5 * 0.5 * 0.8, rel=0.06)
        assert picture[:, -25:].mean() == pytest.approx(0.5 * 0.5 * 0.8, rel=0.06)


def test_nothing_but_an_unseen_sky_is_refused(build, camera, display):
    sky = build.scene(sky={"type": "constant"})
    assert engine.plan(sky, camera, display)
    with pytest.raises(engine.InvalidInput, match="Nothing is in the camera's view"):
        engine.plan(sky, replace(camera, sees_sky=False), display)
