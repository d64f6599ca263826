"""Shader closures: energy, densities and values, smooth lobes, against integrals and Fresnel's equations."""

import numpy as np
import pytest

COSINES = (1.0, 0.2, -0.5)  # the last from behind
COUNT = 50_000  # samples of each angle


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def gloss(**values):
    return {"type": "gloss", **values}


def glass(**values):
    return {"type": "glass", "ior": 1.5, **values}


def over(below, above):
    return {"type": "mixture", "mode": "over", "weight": 1.0, "first": below, "second": above}


MATT = {"type": "matt", "reflectance": 1.0}
METAL = dict(f0=rgb(0.8, 0.5, 0.2), edge=rgb(0.3, 0.6, 0.9))
ROUGH = {
    "gloss": gloss(reflectance=1.0, roughness=0.5),
    "fully rough gloss": gloss(reflectance=1.0, roughness=1.0),
    "anisotropic": gloss(reflectance=1.0, roughness=0.6, aspect=0.4, rotation=0.15),
    "beckmann": gloss(reflectance=1.0, roughness=0.5, distribution="beckmann"),
    "metal": gloss(roughness=0.5, **METAL),
    "dielectric": gloss(roughness=0.5, ior=1.5, reflectance=rgb(1, 0.5, 0.1)),
    "glass": glass(roughness=0.6),
    "tinted glass": glass(roughness=0.8, specular_tint=rgb(1, 0.2, 0.1), transmittance=rgb(0.9, 0.5, 0.2)),
    "refraction": glass(roughness=0.6, fresnel=False),
    "beckmann refraction": glass(roughness=0.6, fresnel=False, distribution="beckmann"),
    "sheen": {"type": "sheen", "roughness": 0.5},
    "matt": {**MATT, "roughness": 1.0},
    "translucent": {**MATT, "translucent": True},
}


@pytest.fixture
def mi(backend):
    """Mitsuba, which knows the closures."""
    import mitsuba

    return mitsuba


def interaction(mi, *cosines, count=COUNT):
    """`count` interactions for each angle, one angle after another."""
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, count * len(cosines))
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    cosine = np.repeat(np.float32(cosines), count)
    sine = np.sqrt(1 - cosine**2)
    si.wi = mi.Vector3f(0.6 * sine, 0.8 * sine, cosine)
    return si


def drawn(mi, bsdf, *cosines):
    """Interaction, sample and weight."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, COUNT * len(cosines))
    si = interaction(mi, *cosines)
    sample, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())
    return si, sample, weight


def by_angle(values, angles):
    """An array of interactions, the last axis, as [..., angle, number]."""
    values = np.array(values)
    return values.reshape(*values.shape[:-1], angles, -1)


def albedo(mi, bsdf, *cosines):
    """Share of light in each channel and, of several angles, each."""
    weight = by_angle(drawn(mi, bsdf, *cosines)[2], len(cosines)).mean(-1)
    return weight if len(cosines) > 1 else weight[:, 0]


@pytest.mark.parametrize("name", ROUGH)
def test_values_and_densities(mi, name):
    """What `sample` returns is what `eval_pdf` says, and the density integrates to the share that is drawn."""
    import drjit as dr

    bsdf = mi.load_dict(ROUGH[name])
    si, sample, weight = drawn(mi, bsdf, *COSINES)
    value, density = bsdf.eval_pdf(mi.BSDFContext(), si, sample.wo)
    height, turn = np.meshgrid((np.arange(2000) + 0.5) / 2000, (np.arange(64) + 0.5) / 64)
    height, turn = (np.tile(np.float32(v.ravel()), len(COSINES)) for v in (height, turn))
    sphere = mi.warp.square_to_uniform_sphere(mi.Point2f(turn, height))
    over_sphere = interaction(mi, *COSINES, count=2000 * 64)
    everywhere = bsdf.pdf(mi.BSDFContext(), over_sphere, sphere)
    dr.eval(sample, weight, value, density, everywhere)
    value, weight, density, drawn_density, everywhere = (
        by_angle(v, len(COSINES)) for v in (value, weight, density, sample.pdf, everywhere)
    )
    for angle, cosine in enumerate(COSINES):
        hit = drawn_density[angle] > 1e-4
        assert hit.any() or cosine < 0
        np.testing.assert_allclose(density[angle, hit], drawn_density[angle, hit], rtol=5e-3)
        expected = weight[:, angle, hit] * density[angle, hit]
        np.testing.assert_allclose(value[:, angle, hit], expected, rtol=5e-3, atol=1e-5)
        total = everywhere[angle].mean() * 4 * np.pi
        assert total == pytest.approx((drawn_density[angle] > 0).mean(), abs=0.01)


@pytest.mark.parametrize(
    "bsdf",
    [
        *(gloss(reflectance=1.0, roughness=r) for r in (0.05, 0.4, 1.0)),
        gloss(f0=rgb(1, 1, 1), roughness=0.8),
        *(over(MATT, gloss(ior=i, roughness=r)) for i in (1.3, 2.0) for r in (0.1, 1.0)),
        over(MATT, gloss(ior=1.5)),
        over(MATT, {"type": "sheen", "reflectance": 1.0, "roughness": 0.4}),
        *(glass(roughness=r) for r in (0.1, 0.5, 1.0)),
        {**MATT, "roughness": 0.5},
        {**MATT, "roughness": 1.0},
        {**MATT, "translucent": True},
    ],
)
def test_white_stays_white(mi, bsdf):
    """No energy is lost or won: what Cycles calls preserving energy."""
    found = albedo(mi, mi.load_dict(bsdf), *COSINES)
    assert found == pytest.approx(np.ones((3, len(COSINES))), abs=0.006)


def test_single_scattering_is_darker(mi):
    """What Smith GGX at alpha = 1 reflects when seen from above, against the integral over its normals."""
    from scipy.integrate import quad

    # from above every microfacet is seen: normals by cosine, mirrored to twice the angle, masked on the way out
    def share(theta):
        out = 2 * theta
        masking = 0.5 * (np.sqrt(1 + np.tan(out) ** 2) - 1)
        return 2 * np.sin(theta) * np.cos(theta) / (1 + masking)

    expected = quad(share, 0, np.pi / 4)[0]
    bsdf = mi.load_dict(gloss(reflectance=1.0, roughness=1.0, distribution="ggx"))
    assert albedo(mi, bsdf, 1.0) == pytest.approx(np.full(3, expected), abs=0.005)


@pytest.mark.parametrize("cosine", [1.0, 0.5, 1 / 7, -0.5])
def test_smooth_mirrors(mi, cosine):
    """One lobe, in the mirror's direction, of Fresnel's or Schlick's share."""
    import drjit as dr

    bsdf = mi.load_dict(gloss(ior=1.5, reflectance=1.0))
    assert bsdf.flags(0) & mi.BSDFFlags.DeltaReflection
    si, sample, weight = drawn(mi, bsdf, cosine)
    expected = float(mi.fresnel(mi.Float(abs(cosine)), 1.5)[0][0])
    assert np.array(weight)[:, 0] == pytest.approx(np.full(3, expected), rel=1e-4)
    assert dr.allclose(sample.wo, mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z))
    assert not np.array(bsdf.eval(mi.BSDFContext(), si, sample.wo)).any()
    metal = mi.load_dict(gloss(**METAL))
    f0, edge = np.array([0.8, 0.5, 0.2]), np.array([0.3, 0.6, 0.9])
    schlick = f0 + (1 - f0) * (1 - abs(cosine)) ** 5
    # the edge tint is the reflectance over Schlick's at a cosine of 1 / 7
    factor = {1.0: 1.0, 1 / 7: edge}.get(cosine)
    if factor is not None:
        assert albedo(mi, metal, cosine) == pytest.approx(schlick * factor, rel=1e-3)


def test_smooth_refraction(mi):
    bsdf = mi.load_dict({"type": "glass", "fresnel": False, "ior": 1.5, "transmittance": 0.7})
    assert bsdf.flags(0) & mi.BSDFFlags.DeltaTransmission
    si, sample, weight = drawn(mi, bsdf, 0.6)
    assert np.array(weight)[:, 0] == pytest.approx(np.full(3, 0.7))
    assert np.array(sample.wo)[:, 0] == pytest.approx(
        [*(-np.array(si.wi)[:2, 0] / 1.5), -((1 - 0.64 / 2.25) ** 0.5)], rel=1e-5
    )
    assert not np.array(drawn(mi, bsdf, -0.5)[2]).any()  # total reflection, of which there is none


def test_tinted_passage(mi):
    bsdf = mi.load_dict({"type": "clear", "transmittance": rgb(0.2, 0.5, 0.8)})
    assert bsdf.flags(0) & mi.BSDFFlags.Null
    si, sample, weight = drawn(mi, bsdf, 0.6)
    assert np.array(weight)[:, 0] == pytest.approx([0.2, 0.5, 0.8])
    assert np.array(sample.wo)[:, 0] == pytest.approx(-np.array(si.wi)[:, 0])
    assert np.array(bsdf.eval_null_transmission(si))[:, 0] == pytest.approx([0.2, 0.5, 0.8])


@pytest.mark.parametrize("ior", [1.5, 0.9, 0.5, 0.1, 0.005])
def test_mean_reflectance(mi, ior):
    """Fresnel's equations, averaged over the hemisphere by the cosine."""
    from holopath_addon.engine.scene.microfacet import mean_reflectance

    cosine = (np.arange(10_000) + 0.5) / 10_000
    sine = np.sqrt(1 - cosine**2) / ior
    beyond = np.sqrt(np.maximum(1 - sine**2, 0))
    s = ((cosine - ior * beyond) / (cosine + ior * beyond)) ** 2
    p = ((ior * cosine - beyond) / (ior * cosine + beyond)) ** 2
    reflected = np.where(sine >= 1, 1, (s + p) / 2)
    assert mean_reflectance(mi.Float(ior))[0] == pytest.approx(2 * (reflected * cosine).mean(), abs=1e-3)


def test_bad_distribution_is_refused(mi):
    with pytest.raises(Exception, match="Expected a distribution of .*, got 'phong'"):
        mi.load_dict(gloss(roughness=0.5, distribution="phong"))


@pytest.mark.parametrize("cosine", [0.9, 0.3, -0.9, -0.5])
def test_smooth_glass(mi, cosine):
    """Fresnel's shares by component, and Snell's direction; radiance is not scaled by the index."""
    import drjit as dr

    bsdf = mi.load_dict(glass(transmittance=0.7, reflectance=0.9))
    index = 1.5 if cosine > 0 else 1 / 1.5
    fresnel = float(mi.fresnel(mi.Float(abs(cosine)), mi.Float(index))[0][0])
    si = interaction(mi, cosine)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, COUNT)
    for component, lobe, share in (
        (0, mi.BSDFFlags.DeltaReflection, 0.9 * fresnel),
        (1, mi.BSDFFlags.DeltaTransmission, 0.7 * (1 - fresnel)),
    ):
        ctx = mi.BSDFContext(mi.TransportMode.Radiance, 0xFFFFFFFF, component)
        sample, weight = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d())
        np.testing.assert_allclose(weight, share, rtol=1e-4, atol=1e-6)
        if share > 0:
            assert np.all(np.array(sample.sampled_type) == int(lobe))
            assert np.all(np.array(sample.sampled_component) == component)
            ratio = 1.0 if component == 0 else 1 / index
            assert float(sample.wo.x[0]) == pytest.approx(-float(si.wi.x[0]) * ratio, rel=1e-4)
    _, sample, weight = drawn(mi, bsdf, cosine)
    assert dr.mean(weight.x)[0] == pytest.approx(0.9 * fresnel + 0.7 * (1 - fresnel), abs=0.01)
