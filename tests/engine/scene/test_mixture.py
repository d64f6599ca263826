"""The mixture of two BSDFs: shares of mirrors, angles of a coat, one lobe at a time."""

import numpy as np
import pytest

COSINES = (1.0, 0.5, 0.25)
MIRROR = {"type": "conductor", "material": "none"}
ROUGH = {"type": "roughconductor", "material": "none", "alpha": 0.3}
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
PLASTIC = {"type": "plastic", "int_ior": 1.5, "ext_ior": 1.0, "diffuse_reflectance": 0.5}


@pytest.fixture
def mi(backend):
    """Mitsuba, which knows mixtures."""
    import mitsuba

    return mitsuba


def diffuse(reflectance):
    return {"type": "diffuse", "reflectance": reflectance}


def mix(weight, first, second, **options):
    return {"type": "mixture", "weight": weight, "first": first, "second": second, **options}


def interaction(mi, cosine, count):
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.wi = mi.Vector3f((1 - cosine**2) ** 0.5, 0, cosine)
    return si


def albedo(mi, bsdf, cosine, count=200_000, **context):
    """Share of light that is reflected or let through, by sampling."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, count)
    ctx = mi.BSDFContext()
    for name, value in context.items():
        setattr(ctx, name, value)
    _, weight = bsdf.sample(ctx, interaction(mi, cosine, count), sampler.next_1d(), sampler.next_2d())
    return float(np.mean(np.array(weight)))


@pytest.mark.parametrize(
    "first, second",
    [
        (diffuse(0.2), MIRROR),
        (MIRROR, PLASTIC),
        (ROUGH, diffuse(0.5)),
        (MIRROR, GLASS),
        ({"type": "null"}, ROUGH),
    ],
)
def test_shares_are_the_weights(mi, first, second):
    bsdf = mi.load_dict(mix(0.3, first, second))
    alone = [mi.load_dict(part) for part in (first, second)]
    for cosine in COSINES:
        expected = 0.7 * albedo(mi, alone[0], cosine) + 0.3 * albedo(mi, alone[1], cosine)
        assert albedo(mi, bsdf, cosine) == pytest.approx(expected, abs=0.005)


def test_a_coat_reflects_as_a_dielectric_does(mi):
    coat = {"type": "gloss", "ior": 1.5}
    bsdf = mi.load_dict({"type": "twosided", "bsdf": mix(0.6, diffuse(0.5), coat, mode="over")})
    for cosine in COSINES:
        reflected = 0.6 * float(mi.fresnel(mi.Float(cosine), 1.5)[0][0])
        assert albedo(mi, bsdf, cosine, component=1) == pytest.approx(reflected, abs=1e-4)
        assert albedo(mi, bsdf, cosine) == pytest.approx(reflected + 0.5 * (1 - reflected), abs=0.005)


def test_a_tinted_coat_absorbs_along_the_ray(mi):
    coat = {"type": "gloss", "ior": 1.5}
    tint = {"type": "rgb", "value": [0.25, 0.25, 0.25]}
    bsdf = mi.load_dict(mix(1.0, diffuse(1.0), coat, mode="over", tint=tint, int_ior=1.5))
    for cosine in COSINES:
        reflected = float(mi.fresnel(mi.Float(cosine), 1.5)[0][0])
        length = (1 - (1 - cosine**2) / 1.5**2) ** -0.5
        assert albedo(mi, bsdf, cosine, component=0) == pytest.approx(
            (1 - reflected) * 0.25**length, rel=1e-3
        )


def test_a_sum(mi):
    clear = {"type": "clear", "transmittance": {"type": "rgb", "value": [0.1, 0.2, 0.6]}}
    bsdf = mi.load_dict(mix(0.1, diffuse(0.4), mix(0.5, MIRROR, clear), mode="add"))
    assert albedo(mi, bsdf, 0.5) == pytest.approx(0.4 + 0.5 + 0.5 * 0.3, abs=0.005)
    through = bsdf.eval_null_transmission(interaction(mi, 1.0, 1))
    assert np.array(through).ravel() == pytest.approx([0.05, 0.1, 0.3])


@pytest.mark.parametrize("wrong", [dict(mode="under"), dict(mode="over")])
def test_bad_modes_are_refused(mi, wrong):
    with pytest.raises(Exception, match="mixture: "):
        mi.load_dict(mix(0.5, diffuse(0.5), diffuse(0.5), **wrong))


def test_lobes_one_by_one(mi):
    bsdf = mi.load_dict(mix(0.3, mix(0.5, diffuse(0.4), MIRROR), GLASS))
    assert [bool(bsdf.flags(i) & mi.BSDFFlags.Delta) for i in range(bsdf.component_count())] == [0, 1, 1, 1]
    alone = [albedo(mi, bsdf, 0.5, component=i) for i in range(4)]
    glass = mi.load_dict(GLASS)
    expected = [0.14, 0.35, *(0.3 * albedo(mi, glass, 0.5, component=i) for i in range(2))]
    assert alone == pytest.approx(expected, abs=1e-3)
    assert sum(alone) == pytest.approx(albedo(mi, bsdf, 0.5), abs=0.005)


def test_density_and_value_agree(mi):
    """What `sample` returns is what `eval` says over what `pdf` says, also where both parts scatter."""
    bsdf = mi.load_dict(mix(0.4, ROUGH, diffuse(0.5)))
    si = interaction(mi, 0.7, 64)
    rng = np.random.default_rng(1)
    numbers = mi.Float(rng.random(64)), mi.Point2f(*rng.random((2, 64)))
    sample, weight = bsdf.sample(mi.BSDFContext(), si, *numbers)
    value, density = bsdf.eval_pdf(mi.BSDFContext(), si, sample.wo)
    weight, value = np.array(weight)[0], np.array(value)[0]
    kept = weight > 0
    density = np.array(density)[kept]
    assert kept.sum() > 40
    assert np.array(sample.pdf)[kept] == pytest.approx(density)
    assert weight[kept] == pytest.approx(value[kept] / density, rel=1e-4)


def test_what_passes_straight_on(mi):
    bsdf = mi.load_dict(mix(0.3, {"type": "null"}, mix(0.5, diffuse(0.5), {"type": "null"})))
    assert float(bsdf.eval_null_transmission(interaction(mi, 1.0, 1)).x[0]) == pytest.approx(0.85)


def test_brightness_in_a_scene(mi):
    """A mixture under a uniform sky, by Mitsuba's path tracer, in front of and behind the surface."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "sky": {"type": "constant"},
            "plane": {
                "type": "rectangle",
                "bsdf": {"type": "twosided", "bsdf": mix(0.25, diffuse(0.4), MIRROR)},
            },
        }
    )
    for z in (3, -3):
        sensor = {
            "type": "perspective",
            "fov": 10,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, z], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16},
        }
        image = mi.render(
            scene, sensor=mi.load_dict(sensor), integrator=mi.load_dict({"type": "path"}), spp=256
        )
        assert np.array(image).mean() == pytest.approx(0.55, abs=0.01)


@pytest.mark.parametrize("cosine", [0.9, 0.2, -0.6])
@pytest.mark.parametrize("how", [{"fresnel_ior": 1.6}, {"facing": 0.7}])
def test_shares_by_angle(mi, how, cosine):
    """A mirror over black: it reflects its share, by Fresnel's equations or by the angle alone."""
    black = {"type": "diffuse", "reflectance": 0.0}
    mirror = {"type": "gloss", "reflectance": 1.0}
    bsdf = mi.load_dict(
        {
            "type": "mixture",
            "weight": 0.5,
            "first": {"type": "twosided", "bsdf": black},
            "second": mirror,
            **how,
        }
    )
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 500_000)
    _, weight = bsdf.sample(
        mi.BSDFContext(), interaction(mi, cosine, 500_000), sampler.next_1d(), sampler.next_2d()
    )
    if "facing" in how:
        share = 1 - abs(cosine) ** 0.7
    else:
        index = 1.6 if cosine > 0 else 1 / 1.6
        sine = (1 - cosine**2) / index**2
        inside = (1 - sine) ** 0.5 if sine < 1 else 0.0
        s = (abs(cosine) - index * inside) / (abs(cosine) + index * inside)
        p = (index * abs(cosine) - inside) / (index * abs(cosine) + inside)
        share = (s * s + p * p) / 2
    assert np.array(weight).mean() == pytest.approx(0.5 * share, rel=0.05)
