"""Gradient steps on a scene's own fields: the loss and its slopes, gain, cost in brightness, canceling."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.waves import supervision
from holopath_addon.engine.waves.despeckle import despeckle, targets

GREEN = 516.5e-9


def test_slopes_against_finite_differences(library):
    """Compute it in double precision by its definition, with two views, prefixes, and pixels without weight."""
    rng = np.random.default_rng(0)
    n, frames, energy, stages = 32, 3, 900.0, {1: 0.3, 3: 2.0}
    f = np.fft.fftfreq(n)
    band = np.hypot(f[:, None], f) <= 0.5

    def wave():
        return (rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))) * band * n

    spectra = [wave().astype(np.complex64) for _ in range(frames)]
    views = []
    for gain in (1, 2):
        weight = rng.random((n, n), dtype=np.float32) / n**2
        weight[-5:] = 0
        transfer = (gain * band * np.exp(2j * math.pi * rng.random((n, n)))).astype(np.complex64)
        views.append(supervision.TargetImage(transfer, rng.random((n, n), dtype=np.float32) + 0.1, weight))

    def loss(spectra):
        value = 0.0
        for view in views:
            mask = view.weight > 0
            for m, stage in stages.items():
                image = np.mean([np.abs(np.fft.ifft2(s * view.transfer)) ** 2 for s in spectra[:m]], axis=0)
                bright = image[mask].sum() / view.target[mask].sum(dtype=float)
                whole = np.mean([np.sum(np.abs(s) ** 2) / s.size for s in spectra[:m]]) / energy
                value += stage * (view.weight * (image / bright - view.target) ** 2).sum(dtype=float)
                value += stage * supervision.BRIGHTNESS * (bright / whole - 1) ** 2
        return value

    made = [library.asarray(each) for each in spectra]
    targets = [supervision.TargetImage(*map(library.asarray, vars(view).values())) for view in views]
    with supervision.FramePool() as pool:
        _, gradient = supervision.supervise(made, targets, energy, stages, pool)
    gradient = np.asarray(gradient)
    exact = [s.astype(complex) for s in spectra]
    for _ in range(5):
        step = [1e-4 * wave() for _ in range(frames)]
        ahead, back = (loss([s + sign * d for s, d in zip(exact, step, strict=True)]) for sign in (1, -1))
        slope = 2 * sum(np.vdot(g, d).real for g, d in zip(gradient, step, strict=True))
        assert ahead - back == pytest.approx(2 * slope, rel=1e-4)


def test_libraries_of_arrays_agree(other_library):
    """Frames are counted, and steps taken; roundings differ alone."""
    rng = np.random.default_rng(0)
    frames = [
        (rng.normal(size=(n, 40, 52)) + 1j * rng.normal(size=(n, 40, 52))).astype(np.complex64)
        for n in (3, 5, 2)
    ]
    found = []
    for made in (np.asarray, other_library.asarray):
        field, *batches = map(made, frames)
        pictures = targets((40, 52), 8e-6, GREEN, -1e-3, 1e-3, 0, on=field)
        for batch in batches:
            pictures.add(batch)
        found.append(np.asarray(despeckle(field, pictures, 4, 1, lambda done: None)))
    assert np.abs(found[0] - frames[0]).max() > 1e-3
    np.testing.assert_allclose(found[1], found[0], atol=2e-6 * np.abs(found[0]).max())


@pytest.fixture(scope="module")
def three(backend):
    """A scene, what its pictures should be, and how good a render's are."""
    from benchmarks.scenes import FOV, Scenes

    camera = engine.Camera(np.eye(4), FOV)
    hologram = engine.Hologram(256, 256, 8e-6, (GREEN,), 1e-3, 6e-3, near=0.5)
    focus, scene = [0.5, 0.7, 1.0, 2.0], Scenes().three_planes()
    truth = engine.reference(scene, camera, hologram, focus, spp=128, near=0.5, max_depth=1)

    def measure(**settings):
        field = engine.render(scene, camera, hologram, engine.Settings(max_depth=1, **settings))
        shown = engine.reconstruct(field, focus)
        inner = slice(26, -26)
        ratios = [s[inner, inner].mean() / t[inner, inner].mean() for s, t in zip(shown, truth, strict=True)]
        return np.array([engine.psnr(s, t, 26) for s, t in zip(shown, truth, strict=True)]), ratios

    return measure


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frames", "kind", "steps", "gain"),
    [(8, "designed", 60, 0.8), (8, "random", 60, 1.0), (3, "designed", 200, 0.8)],
)
def test_gain_at_every_focus_and_brightness_as_before(three, frames, kind, steps, gain):
    """Compare on one recording plane; on several, a surface in a plane gains hardly anything."""
    before, bright = three(frames=frames, phase_field=kind, planes=1)
    after, ratios = three(frames=frames, phase_field=kind, despeckle=steps, planes=1)
    assert (after - before).mean() >= gain
    assert (after - before).min() > 0
    assert ratios == pytest.approx(bright, rel=0.02)
    assert ratios == pytest.approx([1] * 4, abs=0.03)
    several, ratios = three(frames=frames, phase_field=kind, despeckle=steps)
    # as good as one plane's, and better at the near focus, which has no rim
    assert (several - after).mean() > -0.1 and (several - after).min() > -0.25 and several[0] > after[0] + 0.1
    assert ratios == pytest.approx([1] * 4, abs=0.03)


def test_colors_and_several_planes(backend, camera, build):
    hologram = engine.Hologram(64, 48, 8e-6, depth_far=0.25e-3, depth_near=1.5e-3)
    settings = engine.Settings(frames=4, planes=3, max_depth=1, phase_field="designed")
    scene = build.three_planes()
    plain = engine.render(scene, camera, hologram, settings)
    field = engine.render(scene, camera, hologram, replace(settings, despeckle=5))
    assert field.data.shape == plain.data.shape == (4, 3, 48, 64)
    assert np.isfinite(field.data).all()
    change = np.abs(field.data - plain.data).mean((0, 2, 3)) / np.abs(plain.data).mean((0, 2, 3))
    assert ((change > 0.001) & (change < 0.5)).all()
    assert field.report["seconds"]["despeckle"] > 0


def test_darkness_stays_dark():
    pictures = targets((32, 40), 8e-6, GREEN, -1e-3, 1e-3, 0)
    fields = np.zeros((2, 32, 40), np.complex64)
    pictures.add(fields)
    np.testing.assert_array_equal(despeckle(fields, pictures, 3, 0, lambda done: None), 0)


def test_canceling(backend, camera, build, small):
    def progress(done, message):
        if message == "Despeckling":
            raise engine.Cancelled

    settings = engine.Settings(frames=2, max_depth=1, despeckle=1000)
    with pytest.raises(engine.Cancelled):
        engine.render(build.three_planes(), camera, small, settings, progress=progress)


@pytest.mark.parametrize("steps", [-1, 1 << 20])
def test_impossible_numbers_of_steps(steps):
    with pytest.raises(engine.InvalidInput, match="speckle"):
        engine.Settings(despeckle=steps)
