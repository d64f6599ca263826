"""Random and designed phase fields: statistics, speckle at any focus, prefixes, tiling, the design program."""

import math
import signal

import numpy as np
import pytest
import scipy.fft

from holopath_addon import engine
from holopath_addon.engine.waves.phase_fields import (
    GAIN,
    SETS,
    __main__,
    designed_phasors,
    pixel_transmission,
    random_phasors,
    recordable_fraction,
    speckle_contrast,
)
from holopath_addon.engine.waves.phase_fields.design import DefocusedView, Design, Layer, Recipe, invent
from holopath_addon.engine.waves.supervision import Frames

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
def test_most_energy_lies_in_the_recordable_band(phasors):
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
    ("frames", "mean", "worst"), [(24, 0.03, 0.04), (8, 0.11, 0.16), (3, 0.38, 0.42), (1, 0.75, 0.88)]
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


def test_predicted_contrast_of_textured_pictures():
    """The plan's figures are those of the shipped maps, in pictures that were not designed for."""
    assert speckle_contrast("random", 9) == pytest.approx(1 / 3)
    with Frames() as threads:
        for count, gain in zip(SETS, GAIN, strict=True):
            maps = np.angle(designed_phasors(count))
            recipe = Recipe(count, maps.shape[-1])
            design, losses = Design(recipe, maps), []
            for seed in range(12):
                layers, pictures = invent(np.random.default_rng((7, seed)), recipe.size, recipe.reach, 0.0)
                losses.append(design.slopes(layers, pictures, threads)[0][count] * count / len(pictures))
            assert np.mean(losses) == pytest.approx(gain, rel=0.3), count


def test_independent_frames_have_the_loss_of_one():
    """What the design descends is scaled so that the mean of m independent frames has 1/m."""
    recipe = Recipe(8, 128)
    design = Design(recipe, np.angle(random_phasors(8, 128, 128, 1)))
    with Frames() as threads:
        losses, _ = design.slopes([Layer(np.ones((128, 128), np.float32))], [DefocusedView(30.0)], threads)
    for m, loss in losses.items():
        assert loss * m == pytest.approx(1, abs=0.12), m


@pytest.mark.parametrize("seed", range(6))
def test_slopes_of_the_design_against_finite_differences(seed):
    recipe = Recipe(3, 64)
    design = Design(recipe, np.angle(random_phasors(3, 64, 64)))
    rng = np.random.default_rng(seed)
    tasks = invent(rng, 64, 20.0, 0.3)
    step = 1e-2 * rng.standard_normal(design.phases.shape).astype(np.float32)
    with Frames() as threads:

        def loss(sign):
            design.phases += sign * step
            value = total(design, tasks, threads)
            design.phases -= sign * step
            return value

        _, slopes = design.slopes(*tasks, threads)
        expected = float(np.sum(np.array(slopes) * step))
        assert loss(1) - loss(-1) == pytest.approx(2 * expected, rel=0.03, abs=2e-4)


def total(design, tasks, threads):
    """The whole loss of a design, brightness included, from its definition."""
    from holopath_addon.engine.waves.phase_fields.design import incoherent_target
    from holopath_addon.engine.waves.supervision import BRIGHTNESS

    layers, pictures = tasks
    optics, value = design.optics, 0.0
    energy = sum((layer.amplitude.astype(float) ** 2).sum() for layer in layers) * optics.band.mean()
    spectra = []
    for phase in design.phases.astype(np.float64):
        parts = [
            np.fft.fft2(layer.amplitude * np.exp(1j * np.roll(phase, [-s for s in layer.shift], (0, 1))))
            * optics.transfer(layer.defocus)
            for layer in layers
        ]
        spectra.append(sum(parts))
    for picture in pictures:
        view = incoherent_target(optics, layers, picture)
        for m, stage in design.recipe.stages.items():
            image = np.mean([np.abs(np.fft.ifft2(s * view.transfer)) ** 2 for s in spectra[:m]], axis=0)
            bright = image.sum() / view.target.sum()
            whole = np.mean([np.sum(np.abs(s) ** 2) / s.size for s in spectra[:m]]) / energy
            error = (view.weight * (image / bright - view.target) ** 2).sum()
            value += stage * (error + BRIGHTNESS * (bright / whole - 1) ** 2)
    return value


def program(tmp_path, *words):
    out = tmp_path / "maps.npy"
    return __main__.main(["design", "--frames", "4", "--size", "64", "--out", str(out), *words]), out


def test_the_design_program_goes_on_where_it_was_interrupted(tmp_path, monkeypatch, capsys):
    (tmp_path / "whole").mkdir()
    status, whole = program(tmp_path / "whole", "--steps", "12")
    assert status == 0
    step = Design.step

    def interrupted(self, threads):
        if self.done == 4:
            signal.raise_signal(signal.SIGINT)  # as Ctrl-C in the middle of a step
        return step(self, threads)

    monkeypatch.setattr(Design, "step", interrupted)
    status, out = program(tmp_path, "--steps", "12")
    assert status == 130
    assert not out.exists()
    assert "same command goes on" in capsys.readouterr().err
    monkeypatch.setattr(Design, "step", step)
    status, out = program(tmp_path, "--steps", "12")
    assert status == 0
    assert "going on at step 5" in capsys.readouterr().err
    maps = np.load(out)
    assert maps.shape == (4, 64, 64)
    assert maps.dtype == np.uint8
    np.testing.assert_array_equal(maps, np.load(whole))


def test_the_design_program_designs(tmp_path):
    """A hundred and fifty steps take a quarter of the squared error away."""
    status, out = program(tmp_path, "--steps", "150", "--reach", "20", "--plane", "1")
    assert status == 0
    designed = np.exp(2j * math.pi / 256 * np.load(out))
    before = random_phasors(4, 64, 64)
    f = scipy.fft.fftfreq(64)
    square = f[:, None] ** 2 + f**2

    def contrast(phasors, q):
        transfer = np.exp(-1j * math.pi * q * square) * (square <= 0.25)
        image = np.mean([np.abs(np.fft.ifft2(np.fft.fft2(p) * transfer)) ** 2 for p in phasors], axis=0)
        return image.std() / image.mean()

    places = np.linspace(-20, 20, 9)
    assert np.mean([contrast(designed, q) for q in places]) < 0.85 * np.mean(
        [contrast(before, q) for q in places]
    )


def test_views_through_narrow_parts_may_count_more(tmp_path):
    """With --narrow, pictures through parts of the pupil a fifth as wide become evener than without."""

    def contrast(*words):
        status, out = program(tmp_path, "--steps", "150", "--reach", "20", "--plane", "1", *words)
        assert status == 0
        spectra = np.fft.fft2(np.exp(2j * math.pi / 256 * np.load(out)))
        out.unlink()
        out.with_suffix(".state.npz").unlink(missing_ok=True)
        f = scipy.fft.fftfreq(64)
        found = []
        for angle in np.arange(8) * math.pi / 4:
            x, y = 0.3 * math.cos(angle), 0.3 * math.sin(angle)
            part = (f - x) ** 2 + (f[:, None] - y) ** 2 <= 0.1**2
            image = np.mean(np.abs(np.fft.ifft2(spectra * part)) ** 2, axis=0)
            found.append(image.std() / image.mean())
        return np.mean(found)

    assert contrast("--narrow", "4") < 0.95 * contrast()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--size", "100"], "power of two"),
        (["--steps", "0"], "Steps"),
        (["--plane", "2"], "share"),
        (["--narrow", "-1"], "narrow"),
        (["--out", "nowhere/maps.npy"], "make it first"),
    ],
)
def test_bad_designs(words, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    status, _ = program(tmp_path, *words)
    assert status == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


def test_states_of_other_designs_are_refused(tmp_path, capsys):
    program(tmp_path, "--steps", "2")
    assert program(tmp_path, "--steps", "3")[0] == 2
    assert "another design" in capsys.readouterr().err
    whole = (tmp_path / "maps.state.npz").read_bytes()
    for damaged in (b"nothing", whole[: len(whole) // 2]):
        (tmp_path / "maps.state.npz").write_bytes(damaged)
        assert program(tmp_path, "--steps", "2")[0] == 2
        assert "remove it" in capsys.readouterr().err


def test_a_state_that_cannot_be_kept_is_known_before_the_work(tmp_path, capsys):
    status, _ = program(tmp_path, "--state", str(tmp_path / "nowhere" / "state.npz"))
    assert status == 1
    assert "Cannot write" in capsys.readouterr().err


def test_maps_to_begin_with(tmp_path, capsys):
    start = tmp_path / "start.npy"
    np.save(start, np.full((4, 64, 64), 64, np.uint8))
    status, out = program(tmp_path, "--steps", "1", "--start", str(start))
    assert status == 0
    assert abs(int(np.median(np.load(out))) - 64) <= 1
    np.save(start, np.zeros((3, 64, 64), np.uint8))
    out.unlink()
    (tmp_path / "maps.state.npz").unlink()
    assert program(tmp_path, "--steps", "1", "--start", str(start))[0] == 2
    assert "change --frames or --size" in capsys.readouterr().err


def test_a_hologram_of_any_size_has_no_seams(build, camera):
    """An even plane on 560 x 300 pixels, over two and a bit tiles, out of focus: as little speckle where tiles meet."""
    hologram = engine.Hologram(560, 300, PITCH, (WAVELENGTHS[1],), 1e-3, 6e-3, near=0.5)
    scene = build.scene(plane=build.plane(1.0, build.emissive(build.grey(1.0)), 0.6))
    field = engine.render(scene, camera, hologram, engine.Settings(frames=24))
    image = engine.reconstruct(field, [0.6])[0, ..., 0]
    inner = image[40:-40, 40:-40] / image[40:-40, 40:-40].mean()
    assert inner.std() < 0.06
    seam = inner[:, 256 - 40 - 8 : 256 - 40 + 8]
    assert seam.std() == pytest.approx(inner.std(), rel=0.3)


@pytest.mark.parametrize(("frames", "gain"), [(24, 3.0), pytest.param(8, 2.5, marks=pytest.mark.slow)])
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
