"""The sketch of the bench: to scale, within its borders, and with labels that do not lie on each other."""

import itertools
import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.viewing import bench_sketch
from holopath_addon.engine.viewing.bench_sketch import FONT, LETTER_WIDTH, axial_view, drawing

PITCH = 8e-6


def hologram(width=256, height=192, ends=(-2e-3, 0.5e-3), pitch=PITCH, **optics):
    return engine.Hologram(width, height, pitch, (520e-9,), *ends, optics=engine.Optics(**optics))


HALF_UP = engine.Stop("half", (math.pi / 2,))
HOLOGRAMS = {
    "flat": hologram(),
    "tilt": hologram(beam=engine.Beam("tilt", (math.radians(-1), math.radians(0.5)))),
    "steep": hologram(ends=(60e-3, 65e-3), beam=engine.Beam("tilt", (0.0, math.radians(-1.5)))),
    "near point": hologram(ends=(20e-3, 30e-3), beam=engine.Beam("point", (50e-3,))),
    "far point": hologram(1920, 1080, beam=engine.Beam("point", (-0.4,))),
    "gaussian": hologram(beam=engine.Beam("gaussian", (0.6e-3, 0.2e-3, -0.4e-3))),
    "measured": hologram(64, 48, beam=engine.Beam("measured", measured=np.ones((48, 64)))),
    "auto": hologram(carrier="auto"),
    "half": hologram(stop=HALF_UP),
    "rectangle": hologram(
        1920, 1080, (80e-3, 85e-3), 4.5e-6, carrier=(0.3, -0.5), stop=engine.Stop("rectangle", (0.4, 0.8))
    ),
    "picture": hologram(carrier="auto", stop=engine.Stop("measured", measured=np.tri(8, dtype=bool).T)),
    "behind a lens": hologram(ends=(None, None), lens=engine.Lens(0.1)),
    "image": hologram(512, 512, (None, None), lens=engine.Lens(0.1, 0.05, 0.15)),
    "oblong": hologram(320, 256, pitch=(6.4e-6, 8e-6)),
    "tiny": hologram(16, 16, (1e-4, 2e-4)),
}  # fmt: skip

EYEPIECE = engine.Hologram(
    256, 192, PITCH, (520e-9,), None, None, "eyepiece", optics=engine.Optics(lens=engine.Lens(0.05, 0.02))
)
HOLOGRAMS["eyepiece"] = EYEPIECE


def role(thing, name):
    return [line.points for line in thing.lines if line.role == name]


@pytest.mark.parametrize("width", [400, 720, 1500])
@pytest.mark.parametrize("name", HOLOGRAMS)
def test_all_lies_within_and_labels_apart(name, width):
    drawn = drawing(HOLOGRAMS[name], width=width)
    for line in drawn.lines:
        x, y = line.points.T
        assert x.min() > -1 and x.max() < width + 1 and y.min() > -1 and y.max() < drawn.height + 1, line
    boxes = [
        (text.x, text.y - FONT, text.x + LETTER_WIDTH * FONT * len(text.text), text.y) for text in drawn.texts
    ]
    for left, top, right, bottom in boxes:
        assert left >= 0 and top >= 0 and right <= width + 1 and bottom <= drawn.height
    for (a, b, c, d), (e, f, g, h) in itertools.combinations(boxes, 2):
        assert c <= e or g <= a or d <= f or h <= b


@pytest.mark.parametrize("name", HOLOGRAMS)
def test_to_scale(name):
    """SLM and volume have their size and place, and the bars and words say by which scales."""
    which = HOLOGRAMS[name]
    bench, drawn = axial_view(which), drawing(which)
    side = 1e3 * (which.height * which.pitch_y if bench.upright else which.width * which.pitch_x)
    if which.in_air is not which:
        return
    (slm,) = role(drawn, "slm")
    volume = role(drawn, "volume")[0]
    across = abs(slm[1, 1] - slm[0, 1]) / side
    along = (volume[1, 0] - volume[0, 0]) / (1e3 * (which.depth_near - which.depth_far))
    assert volume[0, 0] - slm[0, 0] == pytest.approx(1e3 * which.depth_far * along, abs=1e-6)
    assert volume[2, 1] - volume[1, 1] == pytest.approx(-side * across)
    words = [text.text for text in drawn.texts]
    sentence = next(text for text in words if text.startswith("across at"))
    ratio = sentence.split()[2]
    ratio = 1 / float(ratio[2:]) if ratio.startswith("1/") else float(ratio)
    assert across / along == pytest.approx(ratio)
    bars = [line.points for line in drawn.lines if line.role == "ink" and line.width == 2.0]
    for bar, word, scale in zip(bars, ("along", "across"), (along, across), strict=True):
        length = next(float(text.split()[0]) for text in words if text.endswith(f" mm {word}"))
        assert np.abs(bar[1] - bar[0]).max() == pytest.approx(length * scale)


def test_beams_run_as_the_light_does():
    """Their slopes, up the page, are the phase's: of a tilt its tangent; rays of a point meet there."""
    for name, slope in (("tilt", math.tan(math.radians(-1))), ("steep", math.tan(math.radians(-1.5)))):
        bench = axial_view(HOLOGRAMS[name])
        assert bench.upright == (name == "steep")
        for (x, y), (u, v) in role(bench, "beam"):
            assert u == x or (v - y) / (u - x) == pytest.approx(slope)
    for points in role(axial_view(HOLOGRAMS["near point"]), "beam"):
        np.testing.assert_allclose(points[0], (-50.0, 0.0), atol=1e-9)
    for (x, y), (u, v) in role(axial_view(HOLOGRAMS["far point"]), "beam"):
        assert y + (v - y) / (u - x) * (400 - x) == pytest.approx(0, abs=1e-9)
    bench = axial_view(HOLOGRAMS["gaussian"])
    assert bench.upright
    np.testing.assert_allclose(
        [p[0, 1] for p in role(bench, "beam")], (-0.4 - 0.6, -0.4, -0.4 + 0.6), atol=0.25
    )


@pytest.mark.parametrize("name", ["auto", "half", "rectangle"])
def test_light_behind_the_slm(name):
    """The stop's edges and the zero order, by the angles of light of such frequencies."""
    which = HOLOGRAMS[name]
    bench, optics = axial_view(which), which.optics
    axis = int(bench.upright)
    assert abs(optics.carrier[axis]) == max(map(abs, optics.carrier))
    slope = math.tan(math.asin(520e-9 / (2 * which.pitch)))
    assert bench.zero_order == pytest.approx(-optics.carrier[axis] * slope * bench.end)
    x, radius = optics.stop_circle[axis], optics.stop_circle[2]
    way = bench.end - 0.5e3 * (which.depth_far + which.depth_near)
    assert bench.edges == pytest.approx(((x - radius) * slope * way, (x + radius) * slope * way))


@pytest.mark.parametrize("name", ["auto", "half", "rectangle", "picture"])
def test_the_fourier_plane(name):
    """The open area is that through which light passes, and on the same side."""
    optics, drawn = HOLOGRAMS[name].optics, drawing(HOLOGRAMS[name])
    areas = [
        line.points for line in drawn.lines if line.role == "light" and line.opacity and len(line.points) == 4
    ]
    side = bench_sketch.FOURIER_SIDE
    left, top = drawn.width - side, 1.6 * FONT
    sizes = [np.ptp(p[:, 0]) * np.ptp(p[:, 1]) / side**2 for p in areas]
    axis = np.linspace(-1, 1, 401)
    x, y = optics.carrier
    is_open = optics.open_at(axis[None, :] - x, -axis[:, None] - y)
    assert sum(sizes) == pytest.approx(is_open.mean(), abs=0.01)
    middle = (
        sum(size * (p.mean(0) - (left, top)) for size, p in zip(sizes, areas, strict=True))
        / sum(sizes)
        / side
    )
    rows, columns = np.nonzero(is_open)
    np.testing.assert_allclose(middle, (columns.mean() / 400, rows.mean() / 400), atol=0.01)
    words = [text.text for text in drawn.texts]
    assert ["Fourier plane", "zero order", "picture", "twin"] == words[-4:] and "stop" in words


def test_behind_a_lens():
    """The volume stands where the lens images it, and is as large as its pixels there; rays meet in its focus."""
    which = HOLOGRAMS["image"]
    bench, image, z = axial_view(which), which.in_air, np.array([which.depth_far, which.depth_near])
    (lens,), volume = role(bench, "lens"), role(bench, "volume")[0]
    assert lens[0, 0] == lens[1, 0] == pytest.approx(50)
    # an object at distance p before the lens is imaged at p f / (p - f): with B = L + s - L s / f, D = 1 - L / f
    reach, d = 0.05 + 0.15 - 0.05 * 0.15 / 0.1, 1 - 0.05 / 0.1
    np.testing.assert_allclose(volume[:2, 0], 1e3 * (0.2 + z / (1 - z * d / reach)))
    assert volume[2, 1] - volume[1, 1] == pytest.approx(1e3 * image.width * image.pitch)
    rays = [points for points in role(bench, "beam") if len(points) == 3]
    assert len(rays) == 2
    for points in rays:
        np.testing.assert_allclose(points[-1], (150.0, 0.0), atol=1e-9)


def test_light_from_the_focal_plane_of_an_eyepiece_is_parallel():
    bench = axial_view(EYEPIECE)
    middle = 0.5e3 * (EYEPIECE.depth_far + EYEPIECE.depth_near)
    for points in role(bench, "light"):
        (x, y), (u, v), (s, t) = points
        assert (x, u) == pytest.approx((middle, 20.0))
        slope = (v - y) / (u - x)
        assert (t - v) / (s - u) == pytest.approx(slope - v / 50)
        assert abs((t - v) / (s - u)) < 0.1 * abs(slope)  # parallel but for how far it is from that plane


def test_without_a_stop_there_is_none():
    assert not {"stop", "twin"} & {text.text for text in drawing(HOLOGRAMS["flat"]).texts}


@pytest.mark.parametrize("page", [(1.0, 1.0, 1.0), (24 / 255, 24 / 255, 24 / 255)])
def test_colors_are_seen_on_light_and_dark_pages(page):
    """A contrast of 3, as WCAG 2.1 asks of what is drawn (1.4.11), with its relative luminance."""

    def luminance(color):
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in color]
        return float(np.dot((0.2126, 0.7152, 0.0722), linear)) + 0.05

    for color in bench_sketch.COLORS.values():
        darker, lighter = sorted((luminance(color), luminance(page)))
        assert lighter / darker >= 3
