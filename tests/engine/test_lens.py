"""Holograms with a lens behind the SLM: what stands behind it, what is seen through it, and what is refused."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine import Hologram, InvalidInput, Lens, Optics
from holopath_addon.engine.encoding.phases import Phases
from holopath_addon.engine.encoding.targets import ComplexTarget
from holopath_addon.engine.hologram import AerialImage
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.viewing.reconstruction import far_from, picture_pitch
from holopath_addon.engine.waves.lens import behind_lens
from holopath_addon.engine.waves.supervision import FramePool

GREEN, PITCH, FOCAL = 516.5e-9, 8e-6, 0.1
RGB = (640e-9, 516.5e-9, 455.4e-9)
FOURIER = Optics(lens=Lens(FOCAL))


def panel(n=64, wavelengths=(GREEN,), lens=None, **changes):
    return Hologram(n, n, PITCH, wavelengths, optics=Optics(lens=lens or Lens(FOCAL)), **changes)


def shown(waves, hologram, distance):
    """Picture of light that leaves the SLM, at a distance of hologram space."""
    camera = engine.Camera(np.eye(4), 0.4)
    field = engine.WaveField(np.asarray(waves, np.complex64)[None, None], hologram, camera, 1.0)
    return engine.reconstruct(field, [float(field.mapping.z_to_depth(distance))])[0, :, :, 0]


def places(n, pitch=PITCH):
    across = (np.arange(n) - (n - 1) / 2) * pitch
    return across[None, :], -across[:, None]


# Where light arrives


@pytest.mark.parametrize(
    "lens", [Lens(FOCAL), Lens(FOCAL, 0.04), Lens(FOCAL, 0.04, 0.12), Lens(-FOCAL, 0.04, 0.12)]
)
def test_a_tilted_wave_is_a_spot_that_far_aside(lens):
    """x' = B sin(angle), to the right and up, by the ray matrix; of a hologram that has its focus on that plane."""
    hologram = panel(lens=lens)
    x, y = places(64)
    across, up = 9.5, -20.5  # of the picture's pixels, which are lambda B / (n pitch)
    wave = np.exp(2j * math.pi * (across * x + up * y) / (64 * PITCH))
    a = 0.0 if lens.picture is None else 1 - lens.picture / lens.focal
    wave = wave * np.exp(-1j * math.pi * a * (x**2 + y**2) / (GREEN * lens.reach))
    picture = shown(wave, hologram, 0.0)
    row, column = np.unravel_index(picture.argmax(), picture.shape)
    assert (column - 31.5, 31.5 - row) == (across, up)
    assert hologram.picture.pitch == pytest.approx(GREEN * lens.reach / (64 * PITCH))


@pytest.mark.parametrize(("distance", "true"), [(FOCAL, False), (0.0, True)])
def test_a_second_lens_moves_the_focus(distance, true):
    """A lens phase of focal length f_2 on the SLM: by Newton's equation at z = -f^2 / f_2 behind one that stands its
    focal length away; in contact with it, at 1/F = 1/f + 1/f_2, which hologram space has as z / (1 - z D / B).
    """
    second, hologram = 2.0, panel(96, lens=Lens(FOCAL, distance))
    x, y = places(96)
    wave = np.exp(-1j * math.pi * (x**2 + y**2) / (GREEN * second))
    z = -(FOCAL**2) / second
    ends = [4 * z, z, -2 * z]
    peaks = [
        shown(wave, replace(hologram, depth_far=-0.03, depth_near=0.03), each).max()
        for each in np.linspace(*ends[::2], 25)
    ]
    best = np.linspace(*ends[::2], 25)[int(np.argmax(peaks))]
    assert best == pytest.approx(z, abs=0.13 * abs(ends[0] - ends[2]) / 2)
    if true:
        where = z / (1 - z * 1.0 / FOCAL)
        assert FOCAL + where == pytest.approx(1 / (1 / FOCAL + 1 / second))


def test_all_colors_share_a_grid():
    hologram = panel(wavelengths=RGB)
    image = hologram.in_air
    assert isinstance(image, AerialImage) and hologram.picture == image
    assert image.pitch == pytest.approx(min(RGB) * FOCAL / (64 * PITCH))
    # the aperture's cone is one for all
    slopes = [hologram.max_slope(w) for w in RGB]
    np.testing.assert_allclose(slopes, 64 * PITCH / 2 / FOCAL, rtol=1e-4)
    # light of one sine arrives at one place, whose pixel is none of any color's, and keeps its power
    x, y = places(64)
    across, up = 1.2e-3, -0.7e-3
    waves = [np.exp(2j * math.pi * (across * x + up * y) / (FOCAL * w)) for w in RGB]
    field = engine.WaveField(
        np.stack(waves)[None].astype(np.complex64), hologram, engine.Camera(np.eye(4), 0.4), 1.0
    )
    picture = engine.reconstruct(field, [float(field.mapping.z_to_depth(0.0))])[0]
    for k, wavelength in enumerate(RGB):
        row, column = np.unravel_index(picture[..., k].argmax(), picture.shape[:2])
        assert column - 31.5 == pytest.approx(across / image.pitch, abs=0.5 + 0.5 * wavelength / min(RGB))
        assert 31.5 - row == pytest.approx(up / image.pitch, abs=0.5 + 0.5 * wavelength / min(RGB))
        power = picture[..., k].sum() * (min(RGB) / wavelength) ** 2  # of pixels in units of its own
        assert power == pytest.approx(math.pi / 4 * 64**2, rel=0.03)  # of the aperture's circle


def test_every_second_pixel_of_a_color():
    """The same through a part of the pupil, whose light every second pixel could hold."""
    hologram, rng = panel(48, RGB), np.random.default_rng(0)
    data = np.exp(2j * math.pi * rng.random((1, 3, 48, 48))).astype(np.complex64)
    field = engine.WaveField(data, hologram, engine.Camera(np.eye(4), 0.4), 1.0)
    part = engine.Pupil(0.0, 0.0, field.mapping.pupil_radius(hologram.max_slope(RGB[0])))
    refocus, focus = engine.Refocuser(field, max_apart=2), [float(field.mapping.z_to_depth(0.0))]
    whole, half = refocus(focus, part), refocus(focus, part, apart=2)
    assert half.shape == (1, 24, 24, 3)
    np.testing.assert_allclose(half[..., :2], whole[:, ::2, ::2, :2], rtol=1e-4, atol=1e-5)


def test_of_a_wide_panel_the_square_in_its_middle_counts():
    wide = Hologram(96, 64, PITCH, (GREEN,), optics=FOURIER)
    assert (wide.picture.width, wide.picture.height) == (64, 64)
    assert wide.picture.pitch == panel().picture.pitch
    pair = Hologram(80, 64, (6.4e-6, 8e-6), (GREEN,), optics=FOURIER)  # columns reach farther
    assert (pair.picture.width, pair.picture.height) == (80, 64)
    assert pair.picture.pitch == pytest.approx(panel().picture.pitch)


@pytest.mark.parametrize("share", [0.7, 0.5])
def test_a_share_of_the_picture_is_its_middle(share):
    """The same light, of all colors: what is beside it is left out."""
    rng, pictures = np.random.default_rng(0), []
    data = np.exp(2j * math.pi * rng.random((1, 3, 48, 64))).astype(np.complex64)
    camera = engine.Camera(np.eye(4), 0.4)
    for part in (1.0, share):
        lens = Lens(FOCAL, FOCAL, FOCAL, part)
        hologram = Hologram(64, 48, PITCH, RGB, optics=Optics(lens=lens), depth_far=-0.05, depth_near=0.01)
        mapping = engine.WaveField(data, hologram, camera, 1.0).mapping
        focus = [float(mapping.z_to_depth(z)) for z in (0.0, 5e-3)]
        pictures.append(engine.reconstruct(engine.WaveField(data, hologram, camera, 1.0), focus))
    whole, part = pictures
    beside = (48 - part.shape[1]) // 2
    assert part.shape[1:3] == (48 - 2 * beside,) * 2 and beside == round((1 - share) / 2 * 48)
    np.testing.assert_allclose(part, whole[:, beside:-beside, beside:-beside], rtol=1e-5, atol=1e-6)


# Scenes


@pytest.fixture(scope="module")
def slanted(build):
    return build.scene(plane=build.plane(1.0, build.emissive(build.texture(512, 3)), 0.8, 0.4, slant=60))


SETTINGS = engine.Settings(frames=4, phase_field="designed", method="full")


@pytest.mark.parametrize("lens", [Lens(FOCAL), Lens(0.06, 0.03, 0.07)])
def test_the_field_is_that_of_pixels_in_the_air(slanted, camera, lens):
    """The light in the picture's plane is that of a panel of its pixels there."""
    hologram = panel(48, lens=lens)
    image = hologram.in_air
    ends = image.depth_far, image.depth_near
    own = engine.render(slanted, camera, Hologram(48, 48, image.pitch, (GREEN,), *ends), SETTINGS)
    field = engine.render(slanted, camera, hologram, SETTINGS)
    assert field.data.shape == (4, 1, 48, 48) and field.near == own.near
    there = behind_lens(hologram, GREEN).propagate(field.data[:, 0])
    assert np.linalg.norm(there - own.data[:, 0]) < 1e-4 * np.linalg.norm(there)
    focus = [0.7, 1.0, 1.6]
    np.testing.assert_allclose(
        engine.reconstruct(field, focus), engine.reconstruct(own, focus), atol=1e-3, rtol=1e-3
    )


def test_a_fourier_hologram_is_as_good_as_one_of_free_space(slanted, camera):
    """Compared with a thin lens: 0.3 dB, and the same brightness; phases alone, too."""
    found, focus = [], [0.8, 1.4]
    for optics in (Optics(), FOURIER):
        hologram = Hologram(64, 64, PITCH, (GREEN,), optics=optics)
        field = engine.render(slanted, camera, hologram, replace(SETTINGS, frames=8))
        truth = engine.reference(slanted, camera, hologram, focus, spp=32, near=field.near, halves=True)
        phases = engine.encode(field, "joint", max_steps=30)
        for light in (field, phases.field()):
            for picture, halves in zip(engine.reconstruct(light, focus), truth, strict=True):
                inner = np.s_[6:-6, 6:-6]
                bright = picture[inner].mean() / halves.mean(0)[inner].mean()
                found.append((engine.psnr(picture, halves, 6), 100 * bright))
    free, behind = np.array(found).reshape(2, 2, 2, 2)
    assert np.abs((behind - free)[..., 0].mean(-1)).max() < 0.3
    np.testing.assert_allclose(behind[0, :, 1], 100, atol=2)
    np.testing.assert_allclose(behind[..., 1], free[..., 1], atol=2)


def test_three_colors_are_as_good_as_in_free_space(build, camera):
    """Images that all colors resolve, by a thin lens; each at its own pixels, and averaged over the picture's."""
    scene = build.scene(plane=build.plane(1.0, build.emissive(build.texture(64, 3)), 0.8, 0.4, slant=60))
    found = []
    for optics in (Optics(), FOURIER):
        hologram = Hologram(64, 64, PITCH, RGB, optics=optics)
        field = engine.render(scene, camera, hologram, replace(SETTINGS, frames=8))
        halves = engine.reference(scene, camera, hologram, [1.0], spp=32, near=field.near, halves=True)[0]
        found.append(engine.psnr(engine.reconstruct(field, [1.0])[0], halves, 6))
    assert found[1] > found[0] - 0.3


def test_colors_are_as_bright_as_each_other(build, camera):
    """Phases on their own pixels, whose light reaches 1.4 times as far."""
    scene = build.scene(plane=build.plane(1.0, build.emissive(build.gray(0.5)), 2.0))
    field = engine.render(scene, camera, panel(48, RGB), SETTINGS)
    picture = engine.reconstruct(field, [1.0])[0, 6:-6, 6:-6]
    np.testing.assert_allclose(picture.mean((0, 1)), 0.5, rtol=0.02)


def test_the_plan_says_how_light_comes_there(slanted, camera):
    plan = engine.plan(slanted, camera, panel(32, RGB), SETTINGS)
    by_name = {decision.name: decision for decision in plan.decisions}
    assert by_name["propagation"].value == "Fourier transform"
    assert "178 µm at 455.4 nm to 250 at 640" in by_name["propagation"].reason
    assert "the picture's plane" in by_name["depth"].value and plan.traversals == 3
    free = engine.plan(slanted, camera, Hologram(32, 32, PITCH, RGB), SETTINGS)
    assert "propagation" not in {decision.name for decision in free.decisions}


# Phases


def test_the_slope_of_phases_behind_a_lens():
    """Compared with differences of the loss in the picture's plane with respect to phases on the SLM."""
    hologram = panel(16, RGB[:1] + RGB[2:], lens=Lens(FOCAL, 0.06, 0.12))
    rng = np.random.default_rng(0)
    way, pitch = behind_lens(hologram, RGB[0]), hologram.in_air.pitch_at(RGB[0])
    target = rng.normal(size=(1, 16, 16)) + 1j * rng.normal(size=(1, 16, 16))
    angle, change = rng.uniform(0, 6, (2, 1, 16, 16))
    with FramePool() as pool:
        compared = ComplexTarget(target, True, pool, pitch=pitch)

        def loss(step):
            # the factor of the step before is 1 until it is set
            compared.factors, compared._back = np.ones(1, complex), np.empty((1, 16, 16), complex)
            phases = Phases(angle + step * change, pool, lens=way)
            return phases, compared.gradient(phases.light)

        phases, (_, back, factors) = loss(0.0)
        back, factors = phases._at_pixels(back.copy(), factors)
        light = np.exp(1j * angle)
        slope = 2 * (light.conj() * back * np.asarray(factors)[:, None, None]).imag
        ends = [loss(step)[1][0] for step in (-1e-4, 1e-4)]
        assert (slope * change).sum() == pytest.approx((ends[1] - ends[0]) / 2e-4, rel=1e-3)


@pytest.mark.parametrize("method", ["sgd", "joint", "dpac", "auto"])
def test_phases_behind_a_lens(slanted, camera, method):
    """Brightness and image of the field through the aperture."""
    field = engine.render(slanted, camera, panel(48), replace(SETTINGS, frames=8))
    phases = engine.encode(field, method, max_steps=20)
    expected, found = (engine.reconstruct(light, [1.0])[0] for light in (field, phases.field()))
    inner = np.s_[12:-12, 12:-12]  # double phase has corners to lose
    assert found[inner].mean() == pytest.approx(expected[inner].mean(), rel=0.1 if method != "dpac" else 0.3)
    alike = np.corrcoef(found[inner].ravel(), expected[inner].ravel())[0, 1]
    assert (
        alike > {"joint": 0.95, "auto": 0.95, "sgd": 0.6, "dpac": 0.35}[method]
    )  # without a lens 0.22 of dpac


def test_pixels_beside_the_square_send_their_light_elsewhere(slanted, camera):
    """A checkerboard's first order lies at half a cycle a pixel both ways, in the corners of what pixels reach."""
    hologram = Hologram(48, 32, PITCH, (GREEN,), optics=FOURIER)
    field = engine.render(slanted, camera, hologram, replace(SETTINGS, frames=1))
    phases = engine.encode(field, "sgd", max_steps=5).data[0, 0]
    beside = np.exp(1j * phases[:, :8])
    power = np.abs(np.fft.fft2(beside)) ** 2
    assert power[16, 4] == pytest.approx(power.sum())
    assert len(np.unique(phases[:, 8:-8])) > 500


def test_few_frames_begin_with_light_from_all_of_the_aperture(slanted, camera):
    """Each place of the picture from a place of its own: less speckle than random phases begin with."""
    field = engine.render(slanted, camera, panel(48), engine.Settings(frames=1, method="full"))
    expected, errors = engine.reconstruct(field, [1.0])[0, 4:-4, 4:-4], {}
    for randomness in (None, 1.0):
        phases = engine.encode(field, "joint", max_steps=40, randomness=randomness)
        picture = engine.reconstruct(phases.field(), [1.0])[0, 4:-4, 4:-4]
        errors[randomness] = np.linalg.norm(picture - expected)
    assert errors[None] < 0.8 * errors[1.0]


def test_one_frame_needs_room_beside_the_picture(slanted, camera):
    """Compared with a thin lens: otherwise all light arrives in the picture, its errors too."""
    found = []
    for share in (1.0, 0.6):
        hologram = panel(64, lens=Lens(FOCAL, FOCAL, FOCAL, share))
        field = engine.render(slanted, camera, hologram, engine.Settings(frames=1, method="full"))
        halves = engine.reference(slanted, camera, hologram, [1.0], spp=32, near=field.near, halves=True)[0]
        phases = engine.encode(field, "joint", max_steps=40)
        found.append(
            [engine.psnr(engine.reconstruct(each, [1.0])[0], halves, 4) for each in (field, phases.field())]
        )
    (whole, of_whole), (part, of_part) = found
    assert part - of_part < whole - of_whole - 2


def test_the_scene_goes_on_beside_a_share_of_the_picture(build, camera):
    """So that the picture's border is as bright as the rest out of focus, as a thin lens sees it."""
    scene = build.scene(plane=build.plane(1.0, build.emissive(build.gray(0.5)), 2.0))
    borders = []
    for share in (0.6, 1.0):
        lens, ends = Lens(FOCAL, FOCAL, FOCAL, share), {"depth_far": -0.06, "depth_near": 0.02}
        field = engine.render(scene, camera, panel(64, lens=lens, **ends, near=0.4), SETTINGS)
        picture = engine.reconstruct(field, [0.5])[0, :, :, 0]
        borders.append(np.concatenate([picture[:3].ravel(), picture[-3:].ravel()]).mean())
    assert borders[0] == pytest.approx(0.5, rel=0.05) and borders[1] < 0.47


def test_the_zero_order_is_in_the_middle():
    hologram = panel(64)
    phases = engine.PhaseHologram(
        np.random.default_rng(0).uniform(0, 6, (1, 1, 64, 64)).astype(np.float32), hologram,
        engine.Camera(np.eye(4), 0.4), 1.0, "none", (1.0,),
    )  # fmt: skip
    focus = [float(phases.field().mapping.z_to_depth(0.0))]
    picture = engine.reconstruct(phases.field(engine.Modulator(unmodulated=0.2)), focus)[0, :, :, 0]
    assert picture[31:33, 31:33].min() > 20 * picture.mean()


# Through an eyepiece


def test_an_eyepiece_has_the_depths_of_its_lens():
    """A thing d before a lens of focal length f is seen at 1/s = 1/d - 1/f from it, and an eye in its back focal plane
    sees it f farther away: Hecht, Optics, section 5.2.
    """
    focal, distance = 0.05, 0.052
    hologram = Hologram(
        64, 64, PITCH, (GREEN,), depth_mapping="eyepiece", optics=Optics(lens=Lens(focal, distance))
    )
    assert hologram.picture is hologram and hologram.depth_far == pytest.approx(2e-3)
    mapping = DepthMapping.of(hologram, engine.Camera(np.eye(4), 0.3), None)
    for z in (2.5e-3, 4e-3, 7e-3):
        d = distance - z
        assert float(mapping.z_to_depth(z)) == pytest.approx(1 / (1 / d - 1 / focal) + focal)
    assert math.isinf(mapping.z_to_depth(hologram.depth_far))


def test_an_eyepiece_is_as_the_camera_that_has_its_field_of_view(slanted):
    """The same as an eyepiece without a lens, whose focal length follows from the camera's field of view."""
    focal = 0.02
    camera = engine.Camera(np.eye(4), 2 * math.atan(48 * PITCH / 2 / focal))
    ends = {"depth_far": 0.1e-3, "depth_near": 1e-3, "depth_mapping": "eyepiece"}
    free = engine.render(slanted, camera, Hologram(48, 48, PITCH, (GREEN,), **ends), SETTINGS)
    optics = Optics(lens=Lens(focal, focal + 0.1e-3))
    field = engine.render(slanted, camera, Hologram(48, 48, PITCH, (GREEN,), **ends, optics=optics), SETTINGS)
    assert field.mapping.beta == pytest.approx(free.mapping.beta)
    assert np.linalg.norm(field.data - free.data) < 1e-3 * np.linalg.norm(free.data)


# Far away


def test_the_far_field_of_free_space():
    """A wave of sine s arrives z s aside, 1 km away, on pixels of lambda z over the panel's width."""
    hologram = Hologram(64, 64, PITCH, (GREEN,), depth_far=-1e-3, depth_near=1e-3)
    x, y = places(64)
    z = 1000.0
    pixel = picture_pitch(hologram, z)
    assert pixel == pytest.approx(GREEN * z / (64 * PITCH))
    wave = np.exp(2j * math.pi * (7.5 * x + 12.5 * y) / (64 * PITCH))
    picture = shown(wave, hologram, z)
    row, column = np.unravel_index(picture.argmax(), picture.shape)
    assert (column - 31.5, 31.5 - row) == (7.5, 12.5)
    assert picture.sum() == pytest.approx(64**2, rel=1e-2)
    assert picture_pitch(hologram, 1e-3) == PITCH
    assert far_from(panel()) == math.inf


def test_near_and_far_meet():
    """Both are right where the angular spectrum ends: images of a small spot, on the far field's pixels."""
    hologram = Hologram(32, 32, PITCH, (GREEN,), depth_far=-0.1e-3, depth_near=0.1e-3)
    x, y = places(32)
    wave = np.exp(-(x**2 + y**2) / (30e-6) ** 2)
    z = 1.01 * far_from(hologram)
    far = shown(wave, hologram, z)
    radius = 30e-6 * math.sqrt(1 + (GREEN * z / (math.pi * 30e-6**2)) ** 2)  # Saleh and Teich, eq. 3.1-8
    x, _ = places(32, picture_pitch(hologram, z))
    width = 2 * math.sqrt((far.sum(0) * x[0] ** 2).sum() / far.sum())
    assert width == pytest.approx(radius, rel=5e-3)


# What is kept, and what is refused


def test_a_lens_is_kept(tmp_path):
    hologram = panel(lens=Lens(FOCAL, 0.05, 0.12))
    assert Hologram.from_dict(json.loads(json.dumps(hologram.to_dict()))) == hologram
    assert "lens" not in Hologram(8, 8, PITCH).to_dict().get("optics", {})
    data = np.ones((1, 1, 64, 64), np.complex64)
    engine.WaveField(data, hologram, engine.Camera(np.eye(4), 0.4), 1.0).save(tmp_path / "field")
    assert engine.WaveField.load(tmp_path / "field").hologram == hologram


@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        ((0.0,), "finite and not 0, got 0 mm"),
        ((-0.1,), "A lens of -100 mm diverges, and its focal plane is before it"),
        ((-0.1, 0.04), "to look through it choose a converging one"),
        ((math.nan,), "not 0, got nan"),
        ((0.1, -0.01), "of 0 mm or more, got -10 mm"),
        ((0.1, 0.1, 0.0), "above 0 mm, got 0 mm"),
        ((0.1, 0.2, 0.2), "the SLM's own image"),
        ((0.1, 0.1, 0.1, 1.2), "0.1 to 1 of the width that light reaches there, got 1.2"),
        ((0.1, 0.1, 0.1, math.nan), "got nan"),
    ],
)
def test_lenses_that_cannot_be(numbers, says):
    with pytest.raises(InvalidInput, match=says):
        Lens(*numbers)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"optics": Optics(lens=Lens(0.5e-3))}, "Choose a longer focal length"),
        (
            {"optics": Optics(lens=Lens(FOCAL), carrier="auto")},
            "Omit the carrier and the stop, or the lens",
        ),
        (
            {"optics": Optics(lens=Lens(FOCAL, 0.1, 0.1)), "depth_mapping": "eyepiece"},
            "or choose the depth mapping fit",
        ),
        (
            {"optics": Optics(lens=Lens(-FOCAL, 0.0, 0.1)), "depth_mapping": "eyepiece"},
            "or choose the depth mapping fit",
        ),
        (
            {"optics": Optics(lens=Lens(FOCAL, share=0.7)), "depth_mapping": "eyepiece"},
            "Omit the picture's share",
        ),
        (
            {"optics": FOURIER, "depth_mapping": "eyepiece", "depth_far": 1e-3, "depth_near": 2e-3},
            "infinity in its front focal plane, 0 mm from the SLM, and the depth range has it at 1 mm",
        ),
    ],
)
def test_lenses_that_do_not_fit(changes, says):
    with pytest.raises(InvalidInput, match=says):
        Hologram(64, 64, PITCH, **changes)


def test_other_methods_know_no_lens(slanted, camera):
    with pytest.raises(InvalidInput, match="The method focal-stack is made for light without a lens"):
        engine.render(slanted, camera, panel(32), engine.Settings(frames=1, method="focal-stack"))


@pytest.mark.parametrize("pitch", [(8e-6, 4e-6), 8e-6])
def test_far_images_are_as_bright_as_near_ones(pitch):
    """The light's power is the same on all planes, and so is a picture's sum over squares of the largest pitch."""
    hologram = Hologram(32, 64 if isinstance(pitch, tuple) else 32, pitch, (GREEN,), -0.1e-3, 0.1e-3)
    across, down = pitch if isinstance(pitch, tuple) else (pitch, pitch)
    x = (np.arange(32) - 15.5) * across
    y = (np.arange(hologram.height) - (hologram.height - 1) / 2) * down
    wave = np.exp(-(x**2 + y[:, None] ** 2) / (40e-6) ** 2)
    near, far = (shown(wave, hologram, z).sum() for z in (1e-4, 1.5 * far_from(hologram)))
    assert far == pytest.approx(near, rel=0.02)


def test_far_images_are_shifted_as_near_ones():
    shift = 300e-6, -200e-6
    hologram = Hologram(
        64, 64, PITCH, (GREEN, 640e-9), -0.1e-3, 0.1e-3, optics=Optics(color_shift=(shift, (0.0, 0.0)))
    )
    x, y = places(64)
    wave = np.exp(-(x**2 + y**2) / (60e-6) ** 2)
    z = 1.01 * far_from(hologram)
    field = engine.WaveField(
        np.stack([wave, wave])[None].astype(np.complex64), hologram, engine.Camera(np.eye(4), 0.4), 1.0
    )
    picture = engine.reconstruct(field, [float(field.mapping.z_to_depth(z))])[0, ..., 0]
    pixel = picture_pitch(hologram, z)
    columns, rows = ((np.arange(n) - (n - 1) / 2) * pixel for n in picture.shape[::-1])
    middle = (picture.sum(0) * columns).sum() / picture.sum(), -(picture.sum(1) * rows).sum() / picture.sum()
    np.testing.assert_allclose(middle, shift, atol=0.1 * pixel)
