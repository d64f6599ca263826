"""Phases that become better by what a camera sees of them, where the display's model is wrong."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import cli, engine, slm
from holopath_addon.engine.viewing import metrics
from holopath_addon.engine.waves.gaussian_points import THIRD
from holopath_addon.engine.waves.supervision import FramePool
from holopath_addon.slm.fitting import parameters, vector
from holopath_addon.slm.tuning import _Loop

GREEN, PITCH, FOCI, VIEW = 520e-9, 8e-6, (2e-3, 4.5e-3, 7e-3), (0.95, 0.95)
SIDE, FRAMES = 24, 2
WINDOW = slm.PatternWindow(SIDE, PITCH, GREEN)


@pytest.fixture
def pool():
    with FramePool() as pool:
        yield pool


def field_of(seed=0):
    """Frames of one even gradient, each with random phases."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices((SIDE, SIDE)) / SIDE
    light = (0.4 + 0.5 * rows + 0.3 * np.sin(6 * columns)) * np.exp(
        2j * np.pi * rng.random((FRAMES, 1, SIDE, SIDE))
    )
    volume = engine.Hologram(SIDE, SIDE, PITCH, (GREEN,), depth_far=FOCI[0], depth_near=FOCI[-1])
    return engine.WaveField(light.astype(np.complex64), volume, engine.Camera(np.eye(4), 0.6), 0.5)


@pytest.fixture(scope="module")
def bench():
    """A bench that is off in everything, and a calibration that knows all of it but the aberrations."""
    camera = round(1.4 * SIDE)
    start = slm.nominal_setup(WINDOW, FOCI, (camera, camera), VIEW)
    bench, truth = slm.perturbed_bench(start, WINDOW, 4)
    rows = parameters(start)
    found = slm.FitResult(truth, rows, vector(truth), np.zeros(len(rows)), 0.0, 1.0)
    known = slm.calibration_of(found, WINDOW)
    blind = replace(known.models[0], aberrations=(0.0,) * 8, across=(0.0,) * 3, down=(0.0,) * 3)
    return replace(bench, source=THIRD), replace(known, models=(blind,))


def encoded(field, calibration):
    return engine.encode(
        field,
        "joint",
        levels=calibration.levels_of(field.hologram),
        display=calibration.display([GREEN]),
        max_steps=40,
    )


def on_the_bench(bench, field, calibration, phase, distance=4.5e-3):
    """PSNR in dB of the picture without the camera."""
    shown = [bench.phases[calibration.levels(frame[0], GREEN)] for frame in phase.data]
    view = np.mean([bench.picture(phases, distance) for phases in shown], axis=0)
    target = engine.reconstruct(field, [float(field.mapping.z_to_depth(distance))])[0]
    return metrics.psnr(view[..., None], target, border=4)


def test_where_the_camera_looks_there_and_back(bench):
    _, calibration = bench
    sensor = calibration.sensors[0]
    xi, eta = sensor.points(FOCI[1])[:, 0, 0]
    rows, columns = np.indices(sensor.shape)
    np.testing.assert_allclose(sensor.pixels(FOCI[1], xi, eta), [rows, columns], atol=1e-9)
    light = np.linspace(0, 2, 9)
    np.testing.assert_allclose(sensor.intensity(sensor.value(light)), light, atol=1e-9)


@pytest.mark.slow
def test_what_the_model_does_not_know_is_made_up_for(bench):
    """Compare on the bench itself, also between the foci; the camera's PSNR increases, too."""
    bench, calibration = bench
    field = field_of()
    phase = encoded(field, calibration)
    before = [on_the_bench(bench, field, calibration, phase, z) for z in (4.5e-3, 3e-3)]
    tuned = slm.tune(phase, field, bench.capture_values, calibration, GREEN, rounds=8)
    after = [on_the_bench(bench, field, calibration, tuned, z) for z in (4.5e-3, 3e-3)]
    view = tuned.report["tuned"][0]["psnr_db"]
    assert len(view) == 9 and max(view) > view[0] + 0.7
    assert after[0] > before[0] + 0.7 and after[1] > before[1]
    assert tuned.data.dtype == np.float32 and tuned.method == phase.method


@pytest.mark.slow
def test_stopped_in_the_middle_keeps_the_best(bench):
    bench, calibration = bench
    field = field_of()
    phase = replace(encoded(field, calibration), report={})
    taken = []

    def look(levels, distance):
        taken.append(distance)
        if len(taken) > 2.5 * FRAMES * len(FOCI):
            raise KeyboardInterrupt
        return bench.capture_values(levels, distance)

    with pytest.raises(engine.Cancelled) as stopped:
        slm.tune(phase, field, look, calibration, GREEN)
    kept = stopped.value.kept
    assert len(kept.report["tuned"][0]["psnr_db"]) == 2 and kept.data.shape == phase.data.shape


@pytest.mark.parametrize("library", ["array_api_strict", pytest.param("torch", marks=pytest.mark.oracle)])
def test_libraries_of_arrays_agree(library, bench, pool):
    """Use a camera whose picture is always the same: phases are of the same library, and change alike."""
    library = pytest.importorskip(library)
    calibration, field = bench[1], field_of()
    phase, found = engine.encode(field, "sgd", max_steps=1), []
    picture = np.random.default_rng(1).random(calibration.sensors[0].shape)
    for made in (np, library):
        own = replace(phase, data=made.asarray(phase.data))
        tuned = slm.tune(own, field, lambda levels, distance: picture, calibration, GREEN, rounds=1)
        assert isinstance(tuned.data, type(own.data))
        loop = _Loop(own, field, calibration, 0, pool)
        loop.descend(loop.compare(lambda levels, distance: picture)[1], 0.1)
        found.append((np.exp(1j * np.asarray(loop.phases.values())), tuned.report["tuned"][0]["psnr_db"]))
    (expected, decibels), (values, others) = found
    assert np.quantile(np.abs(values - expected), 0.99) < 1e-3
    assert others == pytest.approx(decibels, abs=1e-4)
    assert np.median(np.abs(values - np.exp(1j * phase.data[:, 0]))) > 0.05


def of_camera(calibration, **change):
    return replace(calibration, sensors=(replace(calibration.sensors[0], **change),))


def on(phase, **optics):
    return replace(phase, hologram=replace(phase.hologram, optics=engine.Optics(**optics)))


ELSEWHERE = dict.fromkeys(FOCI, (1, 0, 9, 0, 1, 0, 0, 0))
REFUSED = {
    "Expected a wavelength of the hologram, 640 nm, got 520 nm": lambda c, p: (
        c,
        replace(p, hologram=replace(p.hologram, wavelengths=(640e-9,))),
    ),
    "pixel positions that depend on color": lambda c, p: (
        c,
        on(p, color_distance=(1e-4,)),
    ),
    "a beam and a stop of its own": lambda c, p: (c, on(p, stop=engine.Stop("half"))),
    "no lens behind it": lambda c, p: (c, on(p, lens=engine.Lens(0.1))),
    "neither mirrored": lambda c, p: (replace(c, flip_x=True), p),
    "Run `holopath calibrate` first": lambda c, p: (replace(c, models=(), sensors=()), p),
    "No focus of the calibration is within the volume, 2 to 7 mm": lambda c, p: (
        of_camera(c, homographies={9e-3: (1, 0, 0, 0, 1, 0, 0, 0)}),
        p,
    ),
    "The camera sees 0% of the hologram": lambda c, p: (of_camera(c, homographies=ELSEWHERE), p),
    "Expected 20 x 20 pixels in the camera's picture, as at the calibration, got 34 x 34": lambda c, p: (
        of_camera(c, shape=(20, 20)),
        p,
    ),
}


def test_a_camera_that_fails_leaves_the_best(bench):
    bench, calibration = bench
    field = field_of()
    phase = encoded(field, calibration)
    taken = iter(range(FRAMES * len(FOCI) + 1))

    def look(levels, distance):
        if next(taken) == FRAMES * len(FOCI):
            raise engine.InvalidInput("The camera's command failed.")
        return bench.capture_values(levels, distance)

    with pytest.raises(engine.InvalidInput, match="command failed") as failed:
        slm.tune(phase, field, look, calibration, GREEN)
    assert failed.value.kept.report["tuned"][0]["psnr_db"][0] > 5


@pytest.mark.parametrize("says", REFUSED)
def test_refusals(says, bench):
    bench, calibration = bench
    field = field_of()
    phase = engine.encode(field, "sgd", max_steps=1)
    calibration, phase = REFUSED[says](calibration, phase)
    with pytest.raises(engine.InvalidInput, match=says):
        slm.tune(phase, field, bench.capture_values, calibration, GREEN, rounds=1)


def test_the_light_of_a_controller(bench, tmp_path):
    """It is that of the wavelength's index in the hologram."""
    pytest.importorskip("termios", reason="There are ptys on Unix alone.")
    from tests.slm.device import Board, Firmware

    _, calibration = bench
    field = field_of()
    colors = replace(field.hologram, wavelengths=(640e-9, GREEN, 450e-9))
    field = replace(field, data=np.repeat(field.data, 3, 1), hologram=colors)
    field.save(tmp_path / "out" / "wavefield")
    engine.encode(field, "sgd", max_steps=1).save(tmp_path / "out" / "hologram")
    calibration.save(tmp_path / "slm.json")
    slm.FocusPlanes(tuple(slm.Plane(z, n) for n, z in enumerate(FOCI))).save(tmp_path / "planes.json")
    words = ["tune", str(tmp_path / "out"), "--calibration", str(tmp_path / "slm.json"), "--driver", "serial"]
    words += ["--wavelength", "520", "--focus-planes", str(tmp_path / "planes.json"), "--settle", "0"]
    words += ["--camera", f"'{sys.executable}' -c 'raise SystemExit(1)' {{file}}"]
    with Board(Firmware()) as board:
        assert cli.main([*words, "--port", board.path]) == 2
    assert [shown[3] for shown in board.firmware.shown] == [1]


@pytest.mark.slow
def test_command(bench, tmp_path, monkeypatch, capsys):
    """Run it on the simulated bench: with a missing option, to its end, and interrupted."""
    _, calibration = bench
    field = field_of()
    field.save(tmp_path / "out" / "wavefield")
    encoded(field, calibration).save(tmp_path / "out" / "hologram")
    calibration.save(tmp_path / "slm.json")
    words = ["tune", str(tmp_path / "out"), "--calibration", str(tmp_path / "slm.json")]
    assert cli.main([*words]) == 2
    assert "The camera is missing" in capsys.readouterr().err
    before = engine.PhaseHologram.load(tmp_path / "out" / "hologram")
    assert cli.main([*words, "--driver", "virtual", "--seed", "4", "--rounds", "1"]) == 0
    assert "Done: PSNR of captures" in capsys.readouterr().err
    after = engine.PhaseHologram.load(tmp_path / "out" / "hologram")
    assert len(after.report["tuned"][0]["psnr_db"]) == 2 and not np.array_equal(before.data, after.data)

    def stopped(*_args, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(slm.Bench, "capture_values", stopped)
    assert cli.main([*words, "--driver", "virtual", "--quiet"]) == 1
    assert capsys.readouterr().err == "holopath: Tuning was stopped.\n"
    again = engine.PhaseHologram.load(tmp_path / "out" / "hologram")
    assert np.array_equal(again.data, after.data)
