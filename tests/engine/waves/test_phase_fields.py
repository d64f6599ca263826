"""Random and designed phase fields: statistics, speckle at any focus, prefixes, tiling, the design program."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.waves.phase_fields import (
    DESIGNED_STARTS,
    GAIN,
    RING,
    SETS,
    aimed_waves,
    designed_phasors,
    phasors_of,
    pixel_transmission,
    random_phasors,
    randomness_for,
    recordable_fraction,
    speckle_contrast,
    straight_share,
)
from holopath_addon.engine.waves.phase_fields.design import Design, Recipe, invent
from holopath_addon.engine.waves.supervision import FramePool

PITCH = 8e-6
WAVELENGTHS = (640e-9, 516.5e-9, 455.4e-9)


def test_unit_modulus_and_independence():
    phasors = random_phasors(4, 96, 128, seed=3)
    np.testing.assert_allclose(np.abs(phasors), 1, atol=1e-5)
    for a in range(4):
        for b in range(a):
            assert abs(np.vdot(phasors[a], phasors[b])) / phasors[0].size < 4 / math.sqrt(phasors[0].size)


def test_fewer_frames_are_a_prefix_and_seeds_differ():
    np.testing.assert_array_equal(random_phasors(2, 32, 32, 5), random_phasors(4, 32, 32, 5)[:2])
    assert not np.array_equal(random_phasors(1, 32, 32, 5), random_phasors(1, 32, 32, 6))


@pytest.mark.parametrize("phasors", [random_phasors(4, 256, 256), *(designed_phasors(m) for m in SETS)])
def test_energy_in_the_recordable_band(phasors):
    """The argument of a circular Gaussian field keeps pi/4 of the energy in the field's own component."""
    assert math.pi / 4 - 0.03 < recordable_fraction(phasors) < 1


def test_pixel_transmission_against_a_direct_integral():
    scipy_integrate = pytest.importorskip("scipy.integrate")

    def over_y(x):
        top = math.sqrt(max(0.25 - x * x, 0))
        return np.sinc(x) ** 2 * scipy_integrate.quad(lambda y: np.sinc(y) ** 2, -top, top)[0]

    exact = scipy_integrate.quad(over_y, -0.5, 0.5)[0] / (math.pi / 4)
    assert pixel_transmission() == pytest.approx(exact, rel=2e-3)


def even_plane(phasors, wavelength, distance):
    """Frame mean of the intensity of a periodic even plane, by the textbook transfer function in double precision."""
    n = phasors.shape[-1]
    f = np.fft.fftfreq(n, PITCH)
    square = f[:, None] ** 2 + f**2
    transfer = np.exp(2j * math.pi * distance * np.sqrt(1 / wavelength**2 - square))
    transfer[square > (0.5 / PITCH) ** 2] = 0
    return np.mean([np.abs(np.fft.ifft2(np.fft.fft2(p) * transfer)) ** 2 for p in phasors], axis=0)


def contrasts(phasors, steps=13):
    images = [
        even_plane(phasors, wavelength, z)
        for wavelength in WAVELENGTHS
        for z in np.linspace(-6e-3, 6e-3, steps)
    ]
    return np.array([image.std() / image.mean() for image in images])


@pytest.mark.parametrize(
    ("frames", "mean", "worst"),
    [pytest.param(24, 0.03, 0.04, marks=pytest.mark.slow), (8, 0.11, 0.16), (3, 0.38, 0.42), (1, 0.75, 0.88)],
)
def test_an_even_plane_has_little_speckle_at_any_focus_and_wavelength(frames, mean, worst):
    values = contrasts(designed_phasors(frames))
    assert values.mean() <= mean
    assert values.max() <= worst


@pytest.mark.parametrize("frames", [3, 8, 24])
def test_what_is_left_is_too_fine_to_show_the_period(frames):
    """Waves of 33 pixels and longer, which would be seen to repeat, hold a tenth of random speckle's power at most."""
    f = np.hypot(np.fft.fftfreq(256)[:, None], np.fft.fftfreq(256))
    coarse = (f < 0.03) & (f > 0)
    powers = [
        (np.abs(np.fft.fft2(even_plane(phasors, WAVELENGTHS[1], 3e-3))) ** 2)[coarse].mean()
        for phasors in (designed_phasors(frames), random_phasors(frames, 256, 256))
    ]
    assert powers[0] < 0.1 * powers[1]


@pytest.mark.parametrize("frames", [2, 4, 6, 8, 12, 16, 24])
def test_the_first_frames_alone_are_better_than_random_ones(frames):
    phasors = designed_phasors(24)[:frames]
    assert contrasts(phasors, 5).mean() < 0.95 / math.sqrt(frames)


@pytest.mark.parametrize("randomness", [0.0, 0.3, 0.5, 1.0])
def test_smooth_fields_send_a_share_of_light_straight_on_and_the_rest_everywhere(randomness):
    """The fraction sinc(r)^2 of an even surface's light; the rest is even from the pupil's center to its edge."""
    phasors = phasors_of("smooth", 4, 128, 128, 0, randomness)
    power = np.mean([np.abs(np.fft.fft2(p) / p.size) ** 2 for p in phasors], axis=0)
    share = (math.sin(math.pi * randomness) / (math.pi * randomness)) ** 2 if randomness else 1.0
    assert power[0, 0] == pytest.approx(share, abs=0.01) == straight_share(randomness)
    if randomness:
        power[0, 0] = power[0, 1]
        f = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.fftfreq(128))
        rings = [power[(f >= low) & (f < low + 0.1)].mean() for low in (0, 0.1, 0.2, 0.3, 0.4)]
        assert rings == pytest.approx(5 * [np.mean(rings)], rel=0.05)


def test_speckle_of_smooth_fields_out_of_focus():
    """Partially developed: against that of an even plane, which is a wave and its scattered rest."""
    for randomness in (0.3, 0.6):
        phasors = phasors_of("smooth", 1, 256, 256, 0, randomness)
        assert contrasts(phasors, 5)[[0, -1]].mean() == pytest.approx(
            speckle_contrast("smooth", 1, randomness), rel=0.08
        )


def test_smooth_fields_end_in_random_ones():
    one, other = phasors_of("smooth", 2, 32, 48, 5, 1.0), phasors_of("random", 2, 32, 48, 5)
    np.testing.assert_array_equal(one, other)
    assert (phasors_of("smooth", 2, 32, 48, 5, 0.0) == 1).all()
    degrees = [randomness_for(frames, 0.0) for frames in range(1, DESIGNED_STARTS)]
    assert degrees == sorted(degrees) and degrees[0] == 0
    assert randomness_for(DESIGNED_STARTS, 0.0) == degrees[-1]  # for the pupil as a whole
    assert randomness_for(DESIGNED_STARTS, 0.1) is None
    assert [randomness_for(3, eyebox) for eyebox in (0, 0.15, 0.3, 1)] == pytest.approx([0.1, 0.55, 1, 1])


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 7, DESIGNED_STARTS, 9])
def test_each_frame_is_aimed_at_a_place_of_its_own(frames):
    """Their spectra are evenly spread on a ring, in terms of the pupil of pixels twice as high as wide."""
    waves = aimed_waves(frames, (60, 60), (1.0, 0.5), (0.2, 0.0))
    spectra = np.abs(np.fft.fft2(waves, (1200, 1200)))
    peaks = [np.unravel_index(np.argmax(each), each.shape) for each in spectra]
    down, across = (np.fft.fftfreq(1200)[np.array(line)] * 2 for line in zip(*peaks, strict=True))
    places = (down - 0.2) + 2j * across
    radius = 0 if frames < 3 else RING * (DESIGNED_STARTS - frames) / (DESIGNED_STARTS - 3)
    radius = RING if frames >= DESIGNED_STARTS else radius  # of short descents
    np.testing.assert_allclose(abs(places), radius, atol=0.004)
    if radius:
        turns = np.diff(np.unwrap(np.angle(places)))
        np.testing.assert_allclose(turns, 2 * math.pi / frames, atol=0.1)


@pytest.mark.parametrize("frames", SETS)
def test_light_fills_the_pupil_evenly(frames):
    """Parts of the pupil of half its diameter, anywhere in it, pass their share within 3 %."""
    power = np.mean([np.abs(np.fft.fft2(p)) ** 2 for p in designed_phasors(frames)], axis=0)
    f = np.fft.fftfreq(power.shape[0])
    whole = power[np.hypot(f[:, None], f) <= 0.5].mean()
    for angle in np.arange(8) * math.pi / 4:
        for aside in (0.0, 0.25):
            x, y = aside * math.cos(angle), aside * math.sin(angle)
            part = power[np.hypot(f[:, None] - y, f - x) <= 0.25].mean()
            assert part == pytest.approx(whole, rel=0.03)


@pytest.mark.slow
def test_more_frames_than_the_largest_set_go_on_getting_better():
    values = [contrasts(designed_phasors(m), 5).mean() for m in (24, 48, 96)]
    assert values[1] == pytest.approx(values[0] / math.sqrt(2), rel=0.15)
    assert values[2] == pytest.approx(values[0] / 2, rel=0.2)


def test_a_seed_moves_the_maps():
    still, moved = designed_phasors(8), designed_phasors(8, seed=5)
    assert not np.array_equal(still, moved)
    assert contrasts(moved, 5).mean() == pytest.approx(contrasts(still, 5).mean(), rel=1e-6)


@pytest.mark.slow
def test_predicted_contrast_of_textured_pictures():
    """The plan's figures are those of the shipped maps, in pictures that were not designed for."""
    assert speckle_contrast("random", 9) == pytest.approx(1 / 3)
    assert speckle_contrast("smooth", 9, 1.0) == pytest.approx(1 / 3)
    assert speckle_contrast("smooth", 9, 0.0) == 0
    with FramePool() as pool:
        for count, gain in zip(SETS, GAIN, strict=True):
            maps = np.angle(designed_phasors(count))
            recipe = Recipe(count, maps.shape[-1])
            design, losses = Design(recipe, maps), []
            for seed in range(12):
                layers, pictures = invent(np.random.default_rng((7, seed)), recipe.size, recipe.reach, 0.0)
                losses.append(design.slopes(layers, pictures, pool)[0][count] * count / len(pictures))
            assert np.mean(losses) == pytest.approx(gain, rel=0.3), count


def test_a_hologram_of_any_size_has_no_seams(build, camera):
    """An even plane on 560 x 300 pixels, over two and a bit tiles, out of focus: as little speckle where tiles meet."""
    hologram = engine.Hologram(560, 300, PITCH, (WAVELENGTHS[1],), 1e-3, 6e-3, near=0.5)
    scene = build.scene(plane=build.plane(1.0, build.emissive(build.gray(1.0)), 0.6))
    field = engine.render(scene, camera, hologram, engine.Settings(frames=24))
    image = engine.reconstruct(field, [0.6])[0, ..., 0]
    inner = image[40:-40, 40:-40] / image[40:-40, 40:-40].mean()
    assert inner.std() < 0.06
    seam = inner[:, 256 - 40 - 8 : 256 - 40 + 8]
    assert seam.std() == pytest.approx(inner.std(), rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(("frames", "gain"), [(24, 3.0), (8, 2.5)])
def test_gain_on_three_planes(build, camera, frames, gain):
    """Emissive planes with occlusion, against Mitsuba's thin lens, whole pupil and parts of it."""
    from benchmarks.phase_fields import pupils

    hologram = engine.Hologram(256, 256, PITCH, (WAVELENGTHS[1],), 1e-3, 6e-3, near=0.5)
    focus = [0.5, 1.0, 2.0]
    scene = build.three_planes()
    fields = [
        engine.render(scene, camera, hologram, engine.Settings(frames=frames, max_depth=1, phase_field=kind))
        for kind in ("random", "designed")
    ]
    for name, pupil in pupils(hologram, camera, 0.5).items():
        truth = engine.reference(scene, camera, hologram, focus, pupil, spp=48, near=0.5, max_depth=1)
        random, designed = (
            np.array(
                [
                    engine.psnr(p, t, 26)
                    for p, t in zip(engine.reconstruct(f, focus, pupil), truth, strict=True)
                ]
            )
            for f in fields
        )
        gains = designed - random
        assert gains.min() > 0.5, name
        if pupil is None:
            assert gains.mean() >= gain
            assert gains.min() >= gain - 0.7
