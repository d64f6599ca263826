"""Images sampled as Cycles does: by each wrap mode and filter against the formulas."""

import numpy as np
import pytest

PIXELS = np.random.default_rng(0).integers(0, 256, (5, 7, 4), np.uint8)
PIXELS[..., :3] = PIXELS[..., :3] * (PIXELS[..., 3:] / 255)
PLACES = np.random.default_rng(1).uniform(-2.5, 3.5, (2000, 2)).astype(np.float32)


@pytest.fixture
def picture(backend):
    """A texture of these pixels."""
    import mitsuba as mi

    def make(pixels=PIXELS, **settings):
        return mi.load_dict({"type": "picture", "bitmap": mi.Bitmap(pixels), **settings})

    return make


def at(places):
    import drjit as dr
    import mitsuba as mi

    si = dr.zeros(mi.SurfaceInteraction3f, len(places))
    si.uv = mi.Point2f(places.T)
    return si


def seen(texture, places=PLACES):
    return np.array(texture.eval(at(places))).T


def decoded(color):
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def along(x, count, wrap, cubic):
    """Texels, their weights, and whether they are there."""
    first = np.floor(x * count - 0.5).astype(int)
    t = x * count - 0.5 - first
    weights = {0: 1 - t, 1: t}
    if cubic:
        weights = {-1: (1 - t) ** 3 / 6, 0: 2 / 3 - t**2 + t**3 / 2, 2: t**3 / 6}
        weights[1] = 1 - sum(weights.values())
    for step, weight in weights.items():
        place = first + step
        inside = (place >= 0) & (place < count)
        mirrored = np.abs(place + (place < 0)) % (2 * count)
        mirrored = np.where(mirrored >= count, 2 * count - 1 - mirrored, mirrored)
        clamped = np.clip(place, 0, count - 1)
        kinds = {"repeat": place % count, "mirror": mirrored, "clamp": clamped, "black": clamped}
        yield kinds[wrap], weight * (inside | (wrap != "black"))


@pytest.mark.parametrize("wrap", ["repeat", "mirror", "clamp", "black"])
@pytest.mark.parametrize("filter_type", ["bilinear", "cubic"])
def test_formulas(picture, wrap, filter_type):
    texture = picture(wrap_mode=wrap, filter_type=filter_type, srgb=True, unassociate=True)
    x, y = PLACES.T.astype(float)
    cubic = filter_type == "cubic"
    expected = sum(
        (across * down)[:, None] * PIXELS[row, column] / 255
        for row, down in along(y, 5, wrap, cubic)
        for column, across in along(x, 7, wrap, cubic)
    )
    alpha = np.where(expected[:, 3:] > 0, expected[:, 3:], 1)
    assert seen(texture) == pytest.approx(decoded(expected[:, :3] / alpha), abs=2e-4)
    floats = picture(
        (PIXELS / 255).astype(np.float32),
        wrap_mode=wrap,
        filter_type=filter_type,
        srgb=True,
        unassociate=True,
    )
    assert seen(floats) == pytest.approx(seen(texture), abs=2e-4)


def test_a_number_is_the_luminance(picture):
    import mitsuba as mi

    texture = picture(PIXELS[..., :3], srgb=True)
    number = np.array(texture.eval_1(at(PLACES)))
    assert number == pytest.approx(seen(texture) @ [0.2126, 0.7152, 0.0722], abs=1e-6)
    gray = picture(PIXELS[..., :3], srgb=True, gray=True)
    assert seen(gray) == pytest.approx(np.repeat(number[:, None], 3, axis=1), abs=1e-6)
    assert np.array(gray.eval_3(at(PLACES))).T == pytest.approx(seen(gray))
    assert texture.mean()[0] == pytest.approx(
        (decoded(PIXELS[..., :3] / 255) @ [0.2126, 0.7152, 0.0722]).mean(), rel=1e-4
    )
    assert texture.max() == pytest.approx(decoded(PIXELS[..., :3].max() / 255), rel=1e-5)
    assert texture.is_spatially_varying()
    assert list(texture.resolution()) == [7, 5]
    assert [name for name, _ in mi.traverse(texture)] == ["texels"]


def test_power_scale_offset_limit(picture):
    plain = seen(picture(PIXELS[..., :3]))
    changes = dict(power=0.5, limit=0.8, scale_r=2.0, scale_g=-1.0, offset_g=1.0, offset_b=0.25)
    expected = np.clip(np.sqrt(plain) * [2, -1, 1] + [0, 1, 0.25], 0, 0.8)
    assert seen(picture(PIXELS[..., :3], **changes)) == pytest.approx(expected, abs=1e-5)


def test_one_channel_is_gray_and_places_are_mapped(picture):
    import mitsuba as mi

    ramp = np.linspace(0, 1, 4, dtype=np.float32).reshape(1, 4, 1)
    move = mi.ScalarTransform3f(np.array([[0, 0.5, 0.25], [1, 0, 0], [0, 0, 1.0]]))
    texture = picture(ramp, to_uv=move, wrap_mode="clamp")
    there = np.array([[0.3, 0.0], [0.7, 0.5], [0.1, 1.0]], np.float32)
    expected = np.interp(0.5 * there[:, 1] + 0.25, (np.arange(4) + 0.5) / 4, ramp.ravel())
    assert seen(texture, there) == pytest.approx(np.repeat(expected[:, None], 3, axis=1), abs=1e-6)


def test_places_that_are_no_numbers_read_some_texel(picture):
    assert np.isnan(seen(picture(), np.full((4, 2), np.nan, np.float32))).all()


def test_unknown_wrap_mode(picture):
    with pytest.raises(RuntimeError, match="Expected a wrap_mode of .*, got 'round'"):
        picture(wrap_mode="round")
