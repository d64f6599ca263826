"""Shader closures: energy, densities and values, smooth lobes, against integrals and Fresnel's equations."""

import numpy as np
import pytest

COSINES = (1.0, 0.2, -0.5)  # the last from behind
COUNT = 50_000


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


def interaction(mi, cosine):
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    sine = (1 - cosine**2) ** 0.5
    si.wi = mi.Vector3f(0.6 * sine, 0.8 * sine, cosine)
    return si


def drawn(mi, bsdf, cosine):
    """Interaction, sample and weight."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, COUNT)
    si = interaction(mi, cosine)
    sample, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())
    return si, sample, weight


def albedo(mi, bsdf, cosine):
    return np.array(drawn(mi, bsdf, cosine)[2]).mean(1)


@pytest.mark.parametrize("name", ROUGH)
@pytest.mark.parametrize("cosine", COSINES)
def test_values_and_densities(mi, name, cosine):
    """What `sample` returns is what `eval_pdf` says, and the density integrates to the share that is drawn."""
    import drjit as dr

    bsdf = mi.load_dict(ROUGH[name])
    si, sample, weight = drawn(mi, bsdf, cosine)
    value, density = bsdf.eval_pdf(mi.BSDFContext(), si, sample.wo)
    value = np.array(value)
    hit = np.array(sample.pdf) > 1e-4
    assert hit.any() or cosine < 0
    assert np.array(density)[hit] == pytest.approx(np.array(sample.pdf)[hit], rel=5e-3)
    assert value[:, hit] == pytest.approx((np.array(weight) * np.array(density))[:, hit], rel=5e-3, abs=1e-5)
    height, turn = np.meshgrid((np.arange(2000) + 0.5) / 2000, (np.arange(64) + 0.5) / 64)
    sphere = mi.warp.square_to_uniform_sphere(mi.Point2f(turn.ravel(), height.ravel()))
    si = dr.gather(mi.SurfaceInteraction3f, si, dr.zeros(mi.UInt32, height.size))
    total = np.array(bsdf.pdf(mi.BSDFContext(), si, sphere)).mean() * 4 * np.pi
    assert total == pytest.approx((np.array(sample.pdf) > 0).mean(), abs=0.01)


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
@pytest.mark.parametrize("cosine", COSINES)
def test_white_stays_white(mi, bsdf, cosine):
    """No energy is lost or won: what Cycles calls preserving energy."""
    assert albedo(mi, mi.load_dict(bsdf), cosine) == pytest.approx(np.ones(3), abs=0.006)


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


def test_bad_distribution_is_refused(mi):
    with pytest.raises(Exception, match="no distribution 'phong'"):
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
        assert np.array(weight) == pytest.approx(share, rel=1e-4, abs=1e-6)
        if share > 0:
            assert np.all(np.array(sample.sampled_type) == int(lobe))
            assert np.all(np.array(sample.sampled_component) == component)
            ratio = 1.0 if component == 0 else 1 / index
            assert float(sample.wo.x[0]) == pytest.approx(-float(si.wi.x[0]) * ratio, rel=1e-4)
    _, sample, weight = drawn(mi, bsdf, cosine)
    assert dr.mean(weight.x)[0] == pytest.approx(0.9 * fresnel + 0.7 * (1 - fresnel), abs=0.01)
