"""The program that designs phase fields."""

import math
import signal

import numpy as np
import pytest
import scipy.fft

from holopath_addon.engine.waves.phase_fields import (
    __main__,
    random_phasors,
)
from holopath_addon.engine.waves.phase_fields.design import DefocusedView, Design, Layer, Recipe, invent
from holopath_addon.engine.waves.supervision import FramePool


def test_independent_frames_have_the_loss_of_one():
    """The loss of a design is scaled so that the mean of m independent frames has 1/m."""
    recipe = Recipe(8, 128)
    design = Design(recipe, np.angle(random_phasors(8, 128, 128, 1)))
    with FramePool() as pool:
        losses, _ = design.slopes([Layer(np.ones((128, 128), np.float32))], [DefocusedView(30.0)], pool)
    for m, loss in losses.items():
        assert loss * m == pytest.approx(1, abs=0.12), m


@pytest.mark.parametrize("seed", range(6))
def test_slopes_of_the_design_against_finite_differences(seed):
    recipe = Recipe(3, 64)
    design = Design(recipe, np.angle(random_phasors(3, 64, 64)))
    rng = np.random.default_rng(seed)
    tasks = invent(rng, 64, 20.0, 0.3)
    step = 1e-2 * rng.standard_normal(design.phases.shape).astype(np.float32)
    with FramePool() as pool:

        def loss(sign):
            design.phases += sign * step
            value = total(design, tasks, pool)
            design.phases -= sign * step
            return value

        _, slopes = design.slopes(*tasks, pool)
        expected = float(np.sum(np.array(slopes) * step))
        assert loss(1) - loss(-1) == pytest.approx(2 * expected, rel=0.03, abs=2e-4)


def total(design, tasks, pool):
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

    def interrupted(self, pool):
        if self.done == 4:
            signal.raise_signal(signal.SIGINT)  # as Ctrl-C in the middle of a step
        return step(self, pool)

    monkeypatch.setattr(Design, "step", interrupted)
    status, out = program(tmp_path, "--steps", "12")
    assert status == 130
    assert not out.exists()
    assert "same command continues" in capsys.readouterr().err
    monkeypatch.setattr(Design, "step", step)
    status, out = program(tmp_path, "--steps", "12")
    assert status == 0
    assert "continuing at step 5" in capsys.readouterr().err
    maps = np.load(out)
    assert maps.shape == (4, 64, 64)
    assert maps.dtype == np.uint8
    np.testing.assert_array_equal(maps, np.load(whole))


def test_the_design_program_designs(tmp_path):
    """150 steps remove a quarter of the squared error."""
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
    """Images through parts of the pupil that are a fifth as wide are more even with --narrow than without."""

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
        (["--steps", "0"], "at least one step"),
        (["--plane", "2"], "fraction of planes from 0 to 1"),
        (["--narrow", "-1"], "narrow"),
        (["--out", "nowhere/maps.npy"], "Create it first"),
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
        assert "Remove it" in capsys.readouterr().err


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
    assert "Change --frames or --size" in capsys.readouterr().err
