"""Glass with an Abbe number: one focus a wavelength."""

import numpy as np
import pytest

from holopath_addon import engine

RGB = (640e-9, 516.5e-9, 455.4e-9)


def test_abbe_number_is_met(backend):
    from holopath_addon.engine.scene.dispersion import LINE_C, LINE_D, LINE_F, cauchy

    index = [cauchy(1.62, 36.0, line) for line in (LINE_F, LINE_D, LINE_C)]
    assert index[1] == pytest.approx(1.62)
    assert (index[1] - 1) / (index[0] - index[2]) == pytest.approx(36.0)


@pytest.fixture
def ball(build):
    glass = {"type": "dispersive_dielectric", "int_ior": 1.62, "abbe": 20.0}
    return build.scene(
        ball={"type": "sphere", "center": [0, 0, -0.7], "radius": 0.1, "bsdf": glass},
        far=build.plane(1.2, build.emissive(build.texture(128, 1))),
    )


def test_each_wavelength_has_its_focus(build, ball):
    """Paraxial images of the wall through the ball, as far apart as the indices say."""
    from holopath_addon.engine.scene.dispersion import cauchy, tuned
    from holopath_addon.engine.scene.specular_chains import SpecularChains

    mi = build.mi
    ray = mi.Ray3f(mi.Point3f([0.0], [0.0], [0.0]), mi.Vector3f([1e-4], [0.0], [-1.0]))
    for wavelength in RGB:
        index = cauchy(1.62, 20.0, wavelength)
        behind = index / (-1 / 0.4 + (index - 1) / 0.1)
        image = 0.6 - 1 / (index / (behind - 0.2) + (index - 1) / 0.1)
        with tuned(ball, (wavelength,)):
            view = SpecularChains(ball, "curvature", 8).view(ball, ray, mi.UInt32([3]))
        assert float(view.distance[0]) == pytest.approx(image, abs=2e-4)


@pytest.mark.slow
def test_dispersive_ball_against_mitsuba(ball, camera):
    hologram = engine.Hologram(96, 96, 8e-6, RGB, 0.6e-3, 2.4e-3)
    field = engine.render(ball, camera, hologram, engine.Settings(frames=24))
    truth = engine.reference(ball, camera, hologram, [0.65, 1.2], spp=64, near=field.near)
    for picture, reference in zip(engine.reconstruct(field, [0.65, 1.2]), truth, strict=True):
        assert engine.psnr(picture, reference, 12) >= 20
        inner = slice(12, -12)
        ratio = picture[inner, inner].mean((0, 1)) / reference[inner, inner].mean((0, 1))
        assert ratio == pytest.approx(1, abs=0.03)


def test_rays_are_shared_where_nothing_disperses(build, ball):
    from holopath_addon.engine.scene.dispersion import wavelength_groups

    assert wavelength_groups(build.two_planes(build.emissive), RGB) == [RGB]
    assert wavelength_groups(ball, RGB) == [(w,) for w in RGB]


def test_bad_abbe_number_is_refused(build):
    with pytest.raises(Exception, match="abbe"):
        build.mi.load_dict({"type": "dispersive_dielectric", "abbe": -1.0})
    assert np.isfinite(build.mi.load_dict({"type": "dispersive_dielectric"}).abbe)
