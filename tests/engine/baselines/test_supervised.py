"""RGB-D layers, and the methods that find phases by descent: brightness, focus, occlusion, loss, frames, canceling."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.scenes import FOV, GREEN
from holopath_addon import engine
from holopath_addon.engine.baselines import BaselineInput, frame_mean
from holopath_addon.engine.baselines.frame_mean import FrameMean
from holopath_addon.engine.baselines.supervised import phases_for
from holopath_addon.engine.encoding.double_phase import even_double_phase
from holopath_addon.engine.waves import arrays, libraries
from holopath_addon.engine.waves.phase_fields import aimed_waves
from holopath_addon.engine.waves.propagation import propagate
from holopath_addon.engine.waves.target_images import TargetImages, Viewpoint

SIDE, BORDER = 128, 24
DESCENTS = ("rgbd-sgd", "focal-stack", "light-field")
METHODS = ("rgbd", *DESCENTS)


def display(wavelengths=(GREEN,), side=SIDE):
    return engine.Hologram(side, side, 8e-6, wavelengths, 1e-3, 4e-3, near=0.5)


def render(method, scene, camera, hologram, frames=4, steps=100, **settings):
    chosen = {"max_depth": 1, "spp": 8, "fixed": {"steps": steps}, **settings}
    return engine.render(scene, camera, hologram, engine.Settings(method=method, frames=frames, **chosen))


def inner(picture, border=BORDER):
    return picture[border:-border, border:-border]


def card_before_wall(build):
    """Textured: a card at 0.5 m that covers the middle, before a wall at 2 m."""
    half = 0.5 * np.tan(FOV / 2)
    return build.scene(
        wall=build.plane(2.0, build.emissive(build.texture(64, 1, contrast=4))),
        card=build.plane(0.5, build.emissive(build.texture(32, 2, 0.02, 0.5, contrast=4)), 0.5 * half),
    )


@pytest.mark.parametrize("method", METHODS)
def test_a_plane_is_as_bright_as_it_should_be(build, camera, method):
    """Brightness away from the light that the SLM's edge cuts off; all methods compute colors one by one."""
    wall = build.scene(wall=build.plane(1.0, build.emissive({"type": "rgb", "value": [0.8, 0.3, 0.1]})))
    colors = (640e-9, GREEN) if method in ("rgbd", "rgbd-sgd") else (GREEN,)
    field = render(method, wall, camera, display(colors))
    mean = inner(engine.reconstruct(field, [1.0])[0]).mean((0, 1))
    assert mean == pytest.approx([0.8, 0.3][-len(colors) :], rel=0.05)


@pytest.mark.parametrize("frames", [4, 8])
def test_what_is_black_is_kept_dark(build, camera, frames):
    """A black card before a wall that shines: on its layer nothing is bright."""
    half = 0.5 * np.tan(FOV / 2)
    black = {"bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}}
    scene = build.scene(
        wall=build.plane(2.0, build.emissive(build.texture(64, 1, contrast=4))),
        card=build.plane(0.5, black, 0.5 * half),
    )
    field = render("rgbd-sgd", scene, camera, display(side=96), frames, 30)
    picture = engine.reconstruct(field, [0.5])[0, ..., 0]
    assert picture[40:56, 40:56].mean() < 0.25 * picture[16:24, 24:72].mean()


@pytest.mark.parametrize(
    ("frames", "randomness", "smooth"), [(3, None, True), (6, None, False), (6, 0.1, True)]
)
def test_phases_begin_as_random_as_is_set(build, camera, frames, randomness, smooth):
    """Phases after one step of at most a fifth of a radian: around a checkerboard, aimed, or random."""
    wall = build.scene(wall=build.plane(1.0, build.emissive(build.gray(0.5))))
    hologram = display(side=64)
    field = render("focal-stack", wall, camera, hologram, frames, 1, spp=1, randomness=randomness)
    start = aimed_waves(frames, (64, 64)) * np.exp(1j * even_double_phase((64, 64)))
    alike = abs((np.exp(1j * np.angle(field.data[:, 0])) * start.conj()).mean())
    assert alike > 0.9 if smooth else alike < 0.2


@pytest.mark.parametrize("method", ["rgbd", "point", "polygon", "gaussian"])
@pytest.mark.parametrize("frames", [1, 3])
def test_a_plane_of_few_frames_is_as_bright(build, camera, method, frames):
    """Whose phases are the same all over, or nearly: the band keeps more of their light than of random ones."""
    wall = build.scene(wall=build.plane(1.0, build.emissive(build.gray(0.5))))
    field = render(method, wall, camera, display(side=96), frames, spp=1)
    assert inner(engine.reconstruct(field, [1.0])[0]).mean() == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("method", ["rgbd", "focal-stack"])
def test_one_frame_shows_more_than_speckle(build, camera, method, monkeypatch):
    """Several decibels more than phases that begin at random."""
    from holopath_addon.engine.baselines import layers, supervised

    scene, hologram, focus = card_before_wall(build), display(side=96), [0.5, 2.0]
    truth = engine.reference(scene, camera, hologram, focus, spp=16, near=0.5, max_depth=1)

    def quality():
        images = engine.reconstruct(render(method, scene, camera, hologram, 1), focus)
        return np.mean([engine.psnr(*pair, BORDER) for pair in zip(images, truth, strict=True)])

    few = quality()
    monkeypatch.setattr(layers, "light_randomness", lambda frames: 1.0)
    monkeypatch.setattr(layers, "FEW_FRAMES", 0)
    monkeypatch.setattr(supervised, "FEW_FRAMES", 0)
    assert few > quality() + 4


def test_layers_of_one_frame_meet_without_lines(build, camera):
    """A slanted plane over several layers: their light adds up like one wave's."""
    scene = build.scene(wall=build.plane(1.0, build.emissive(build.gray(0.5)), slant=50))
    field = render("rgbd", scene, camera, display(), 1, spp=1)
    images = inner(engine.reconstruct(field, [1.0])[0])[..., 0].mean(0)
    assert images.std() < 0.15 * images.mean()


def test_the_edge_of_a_layer_loses_what_leaves_the_slm(build, camera):
    """Loss of a small display far from its image: large, as for all waves that spread over the cone."""
    wall = build.scene(wall=build.plane(1.0, build.emissive(build.gray(0.5))))
    field = render("rgbd", wall, camera, display(side=64), 8)
    z = float(field.mapping.depth_to_z(1.0))
    rng = np.random.default_rng(0)
    waves = np.sqrt(4 / np.pi * 0.5) * np.exp(2j * np.pi * rng.random((8, 64, 64)))
    back = propagate(propagate(waves, 8e-6, GREEN, -z), 8e-6, GREEN, z)
    expected = (np.abs(back) ** 2).mean()
    assert expected < 0.9 * 0.5
    assert engine.reconstruct(field, [1.0]).mean() == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(
    ("method", "bound"),
    [
        ("rgbd", 14),
        pytest.param("rgbd-sgd", 17, marks=pytest.mark.slow),
        pytest.param("focal-stack", 19, marks=pytest.mark.slow),
        pytest.param("light-field", 15, marks=pytest.mark.slow),
    ],
)
def test_sharp_where_it_is_in_focus(build, camera, method, bound):
    """Like a thin lens, and at each depth more like the lens at this one than at the other; of both planes."""
    scene, hologram, focus = card_before_wall(build), display(), [0.5, 2.0]
    field = render(method, scene, camera, hologram, 8)
    images = engine.reconstruct(field, focus)
    truth = engine.reference(scene, camera, hologram, focus, spp=64, near=0.5, max_depth=1)
    card = slice(SIDE // 2 - 24, SIDE // 2 + 24)  # well within it
    for own, other in ((0, 1), (1, 0)):
        assert engine.psnr(images[own], truth[own], BORDER) > bound
        assert engine.psnr(images[own], truth[own], BORDER) > engine.psnr(images[own], truth[other], BORDER)
    # the card's texture is there when it is in focus, and less so when not
    contrast = [np.corrcoef(s[card, card].ravel(), truth[0][card, card].ravel())[0, 1] for s in images]
    assert contrast[0] > 0.65 and contrast[0] > contrast[1]


@pytest.mark.parametrize("method", METHODS)
def test_a_card_hides_what_is_behind_it(build, camera, method):
    half = 0.5 * np.tan(FOV / 2)
    scene = build.scene(
        wall=build.plane(2.0, build.emissive(build.gray(1.0))),
        card=build.plane(0.5, build.emissive(build.gray(0.02)), 0.5 * half),
    )
    near = engine.reconstruct(render(method, scene, camera, display(), 4), [0.5])[0]
    assert inner(near, 44).mean() < (0.35 if method == "light-field" else 0.15)  # in so few steps
    assert near[:BORDER].mean() > 0.5


def test_layers_block_as_waves(build, camera):
    """Two layers by hand: what passes the near one is the far one's light, propagated, where the card is not."""
    from holopath_addon.engine.baselines.layers import gain_for, random_phasor

    half = 0.5 * np.tan(FOV / 2)
    scene = build.scene(
        wall=build.plane(2.0, build.emissive(build.gray(1.0))),
        card=build.plane(0.5, build.emissive(build.gray(0.25)), 0.5 * half),
    )
    hologram = display()
    field = render("rgbd", scene, camera, hologram, 2)
    pixel = 2 * np.tan(FOV / 2) / SIDE
    across = np.abs((np.arange(SIDE) - 0.5 * (SIDE - 1)) * pixel) < 0.5 * np.tan(FOV / 2)
    card = across[:, None] & across
    far, near = (float(field.mapping.depth_to_z(d)) for d in (2.0, 0.5))

    class Seed:
        settings, shape = engine.Settings(frames=2), (SIDE, SIDE)

    # phases are nearly constant, beside that of a wave along the axis
    axial = np.exp(2j * np.pi * (near - far) / GREEN)
    for m in range(2):
        phasor = gain_for(2) * random_phasor(Seed, m, 0)
        wave = propagate(np.where(card, 0, phasor), 8e-6, GREEN, near - far)
        wave = propagate(np.where(card, 0.5 * axial * phasor, wave), 8e-6, GREEN, -near)
        overlap = abs(np.vdot(wave, field.data[m, 0]))
        # layers are half a depth of focus thick, and surfaces lie anywhere in them
        assert overlap > 0.9 * np.linalg.norm(wave) * np.linalg.norm(field.data[m, 0])
        assert np.linalg.norm(field.data[m, 0]) == pytest.approx(np.linalg.norm(wave), rel=0.03)


@pytest.mark.parametrize(
    "method", [pytest.param(m, marks=pytest.mark.slow if m != "rgbd-sgd" else ()) for m in DESCENTS]
)
def test_phases_of_one_modulus_that_get_better(build, camera, method):
    """More steps, less speckle; all frames are used, and differ."""
    scene, hologram = card_before_wall(build), display()
    truth = engine.reference(scene, camera, hologram, [1.0], spp=64, near=0.5, max_depth=1)[0]
    quality = {}
    for frames, steps in ((4, 1), (4, 100), (1, 100)):
        field = render(method, scene, camera, hologram, frames, steps)
        modulus = np.abs(field.data)
        assert modulus.std() < 1e-4 * modulus.mean() and modulus.mean() > 0
        quality[frames, steps] = engine.psnr(engine.reconstruct(field, [1.0])[0], truth, BORDER)
        if (frames, steps) == (4, 100):
            gram = np.abs(np.einsum("mkyx,nkyx->mn", field.data, field.data.conj()))
            gram /= gram[0, 0]
            assert (gram - np.eye(4)).max() < 0.95  # 0.8: few frames begin nearly alike
    assert quality[4, 100] > quality[4, 1] + 0.4  # 0.8 of rgbd-sgd at least
    # of the whole pupil one frame at one focus shows nearly as much
    assert quality[4, 100] > quality[1, 100] + (1 if method == "light-field" else -0.5)


def test_descent_lowers_the_loss_and_keeps_the_brightness(pool):
    """Images that phases can show: those of other phases."""
    rng = np.random.default_rng(5)
    pictures = TargetImages((64, 80), 8e-6, GREEN, [Viewpoint(1e-3), Viewpoint(2e-3), Viewpoint(3e-3)])
    pictures.add(1.7 * np.exp(2j * np.pi * rng.random((3, 64, 80))).astype(np.complex64))
    losses = []
    for steps in (1, 30, 200):
        job = SimpleNamespace(
            settings=engine.Settings(frames=3, fixed={"steps": steps}),
            hologram=SimpleNamespace(wavelengths=(GREEN,)),
            shape=(64, 80),
        )
        reports = []
        light = phases_for(job, lambda k, on: pictures, lambda done, what: reports.append(done))[:, 0]  # noqa: B023
        assert len(reports) == steps and reports == sorted(reports) and reports[-1] == 1
        mean = FrameMean(pictures, 1.0, pool)
        losses.append(sum(mean.gradient(light, number)[0] for number in range(3)))
        shown = [mean.image(light, number) for number in range(3)]
        assert np.mean(shown) == pytest.approx(pictures.targets.mean(), rel=0.05)
    assert losses[0] > 2 * losses[1] > 4 * losses[2]


@pytest.mark.parametrize("frames", [2, 4])
def test_libraries_of_arrays_agree(other_library, monkeypatch, frames):
    """Light that shows images, by amplitudes and by intensities; NumPy continues where memory runs out."""
    hologram, reports = engine.Hologram(40, 32, 8e-6, (GREEN, 640e-9), 1e-3, 2e-3), []
    picture = np.random.default_rng(3).random((32, 40)).astype(np.float32)

    def pictures(k, on):
        reports.append(type(on))
        images = TargetImages(
            (32, 40), 8e-6, hologram.wavelengths[k], [Viewpoint(1e-3), Viewpoint(2e-3)], on=on
        )
        images.targets[...] = arrays.like(np.stack([picture, 1 - picture]), on)
        return images

    def light():
        settings = engine.Settings(frames=frames, fixed={"steps": 3})
        job = BaselineInput(None, None, hologram, settings, 0.5, 1e-3, 2e-3)
        return phases_for(job, pictures, lambda done, what: None), job.notes

    by_numpy, _ = light()
    monkeypatch.setattr(libraries, "empty_array", lambda name: other_library.zeros(0))
    found, notes = light()
    assert reports == [np.ndarray] * 2 + [type(other_library.zeros(0))] * 2 and not notes
    assert np.quantile(np.abs(found - by_numpy), 0.99) < 1e-4 * np.abs(by_numpy).max()

    class OutOfMemoryError(RuntimeError):
        pass

    def carried(wave, transfer):
        if not isinstance(wave, np.ndarray):
            raise OutOfMemoryError
        return whole(wave, transfer)

    whole = frame_mean.carried
    monkeypatch.setattr(frame_mean, "carried", carried)
    found, notes = light()
    np.testing.assert_array_equal(found, by_numpy)
    assert notes == [libraries.RAN_OUT]


@pytest.mark.slow
def test_views_of_a_light_field(build, camera):
    """Each part of the pupil as bright as its share of it, nothing between them, and parallax as a lens has it."""
    from holopath_addon.engine.baselines.light_field import PART, parts_of_pupil

    parts = np.array(parts_of_pupil())
    rng = np.random.default_rng(0)
    angle, radius = 2 * np.pi * rng.random(4000), np.sqrt(rng.random(4000))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    apart = np.linalg.norm(points[:, None] - parts, axis=-1)
    assert apart.min(axis=1).max() < PART  # the pupil has no gap

    scene, hologram = card_before_wall(build), display((640e-9, GREEN))
    field = render("light-field", scene, camera, hologram, 8, 200, spp=64)
    for k, wavelength in enumerate(hologram.wavelengths):
        cone = field.mapping.pupil_radius(hologram.max_slope(wavelength))
        for x, y in (parts[1], parts[2], parts[4]):
            pupil, mirrored = (
                engine.Pupil(sign * x * cone, sign * y * cone, 2 * PART * cone) for sign in (1, -1)
            )
            images = engine.reconstruct(field, [1.0], pupil)[0, ..., k : k + 1]
            own, other = (
                engine.reference(scene, camera, hologram, [1.0], p, 64, 0.5, 1)[0, ..., k : k + 1]
                for p in (pupil, mirrored)
            )
            assert inner(images).mean() == pytest.approx(PART**2 * inner(own).mean(), rel=0.05)
            assert engine.psnr(images, own, BORDER) > engine.psnr(images, other, BORDER) + 0.3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("stage", ["first", "last"])
def test_cancelled(build, camera, method, stage):
    reports = []

    def progress(done, message):
        if message in ("Planning", "Reference"):
            return
        assert 0 <= done <= 1
        reports.append(message)
        if stage == "first" or message in ("Layers", "Phases"):
            raise engine.Cancelled

    settings = engine.Settings(method=method, frames=1, max_depth=1, spp=1)
    with pytest.raises(engine.Cancelled):
        engine.render(card_before_wall(build), camera, display(side=64), settings, progress=progress)
    assert reports[-1] in (("Picture", "Pictures") if stage == "first" else ("Layers", "Phases"))


def test_a_light_field_under_a_measured_beam_of_each_wavelength(build, camera):
    """Rays of one wavelength know nothing of the beams of all."""
    colors = (640e-9, GREEN)
    beam = engine.Beam("measured", measured=np.ones((2, 32, 32)))
    hologram = engine.Hologram(32, 32, 8e-6, colors, 1e-3, 2e-3, near=0.5, optics=engine.Optics(beam))
    wall = build.scene(wall=build.plane(1.0, build.emissive({"type": "rgb", "value": [0.8, 0.3, 0.1]})))
    assert render("light-field", wall, camera, hologram, frames=1, steps=1).data.shape == (1, 2, 32, 32)


def test_targets_of_pictures_are_those_of_the_whole_cone(build, camera):
    """One field serves every stop: it is the same behind any, and also as bright as without one."""
    wall = build.scene(wall=build.plane(1.0, build.emissive({"type": "rgb", "value": [0.8, 0.3, 0.1]})))
    fields = [
        render("focal-stack", wall, camera, engine.Hologram(32, 32, 8e-6, (GREEN,), 1e-3, 2e-3, near=0.5, **bench),
               frames=1, steps=3)
        for bench in ({}, {"optics": engine.Optics(carrier="auto")})
    ]  # fmt: skip
    np.testing.assert_array_equal(fields[0].data, fields[1].data)


@pytest.mark.parametrize("method", ["focal-stack", "polygon"])
def test_any_seed(build, camera, method):
    """A date is one, too."""
    small = engine.Hologram(16, 16, 8e-6, (GREEN,), 1e-3, 2e-3, near=0.5)
    render(method, card_before_wall(build), camera, small, frames=1, steps=1, seed=2026_11_29 * 1000)
