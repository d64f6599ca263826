"""A display and a camera that are off in everything, found from captures of known patterns."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import cli, engine, slm
from holopath_addon.engine.viewing import metrics
from holopath_addon.engine.waves.display_model import GRID, DisplayLight
from holopath_addon.engine.waves.gaussian_points import THIRD
from holopath_addon.slm.fitting import (
    STAGES,
    Capture,
    Prediction,
    descend,
    drift,
    parameters,
    setup_of,
    vector,
)
from holopath_addon.slm.patterns import patterns, references
from tests.engine.encoding.fields import smooth

GREEN, PITCH, FOCI = 520e-9, 8e-6, (2e-3, 4.5e-3, 7e-3)
SMALL = slm.PatternWindow(24, PITCH, GREEN)


def start_of(window, distances=FOCI):
    camera = round(1.4 * window.side)
    return slm.nominal_setup(window, distances, (camera, camera), (0.95, 0.95))


def off(found, truth):
    """Error of each parameter as a fraction of its range."""
    spans = np.array([row.high - row.low for row in found.parameters])
    return np.abs(found.values - vector(truth)) / spans


def test_values_are_those_of_the_setup():
    start = start_of(SMALL)
    rows = parameters(start)
    values = np.random.default_rng(0).uniform([r.low for r in rows], [r.high for r in rows])
    assert vector(setup_of(values, start)) == pytest.approx(values, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("pitch", [PITCH, (0.8 * PITCH, PITCH)])
def test_a_display_is_seen_as_the_bench_has_it(pitch):
    """The model against the bench, which computes light and camera pixels independently."""
    window = slm.PatternWindow(24, pitch, GREEN)
    setup, shape = start_of(window, FOCI[:1]), (24, 24)
    levels = np.random.default_rng(1).integers(0, 256, shape)
    bench = slm.Bench(setup.model, setup.phases(8), setup.sensor, shape, pitch, full_well=1e9, read_noise=0.0)
    light = DisplayLight(setup.model, shape, pitch, FOCI[0])
    picture = light.picture(light.spectra(setup.phases(8)[levels]), FOCI[0])
    view = np.minimum(setup.sensor.predict(picture, shape, GRID, FOCI[0], pitch), 1)
    difference = bench.capture(levels, FOCI[0]) / 255 - view
    assert np.std(difference) < 0.01 * np.std(view)


def test_levels_in_the_middle_of_a_larger_device():
    """A checkerboard of half a turn surrounds the levels."""
    levels = np.full((2, 4), 7, np.uint8)
    whole = slm.place_in_center(levels, (8, 6), 8)
    assert whole.shape == (6, 8) and (whole[2:4, 2:6] == 7).all() and set(whole.ravel()) == {0, 7, 128}
    with pytest.raises(engine.InvalidInput, match="no more than 3"):
        slm.place_in_center(levels, (3, 6), 8)


def test_what_is_off_a_little_is_found():
    """Ten captures determine all but aberrations and the source's extent to a twentieth of the range."""
    distances, window = FOCI[:2], SMALL
    start = start_of(window, distances)
    bench, truth = slm.perturbed_bench(start, window, 3)
    model = replace(truth.model, across=(0, 0, 0), down=(0, 0, 0), size=0.0, bandwidth=0.0)
    bench, truth = replace(bench, model=model), replace(truth, model=model)
    shown = patterns((24, 24), 8, PITCH, GREEN, distances, 40)[20:32]
    captures = [
        Capture(levels, distance, bench.capture_values(levels, distance)) for levels, distance in shown
    ]
    rows = parameters(start)
    spans = np.array([row.high - row.low for row in rows])
    chosen = [n for n, row in enumerate(rows) if row.part != "source" and "Zernike" not in row.name]
    values = vector(truth)
    signs = np.random.default_rng(1).choice([-1, 1], len(chosen))
    values[chosen] += 0.05 * signs * spans[chosen]
    prediction = Prediction(captures, start, (24, 24), PITCH, 8)
    found, _ = descend(prediction, values, chosen, 2, 1e-4, lambda done, error: None)
    left = np.abs(found - vector(truth)) / spans
    assert left.max() < 0.02, {rows[n].name: left[n] for n in np.argsort(-left)[:5]}


@pytest.mark.dense  # minutes for each
@pytest.mark.parametrize("seed", [1, 2])
def test_what_is_off_in_everything_is_found(seed):
    """Each parameter within 2 % of its range, from 64 captures of 8 bits with noise."""
    window = slm.PatternWindow(40, PITCH, GREEN)
    bench, truth = slm.perturbed_bench(start_of(window), window, seed)
    found = slm.calibrate(bench.capture_values, window, FOCI, (0.95, 0.95))
    left = off(found, truth)
    names = [row.name for row in found.parameters]
    assert left.max() < 0.02, {names[n]: left[n] for n in np.argsort(-left)[:5]}


def captures_of(benches, count=34):
    """One bench for the captures before the middle, another for those after."""
    shown = patterns((24, 24), 8, PITCH, GREEN, FOCI, count)
    known = references(count)
    return [
        Capture(
            *shown[n], benches[2 * n > count].capture_values(*shown[n]) if n in known else np.zeros((34, 34))
        )
        for n in range(count)
    ], known


@pytest.fixture(scope="module")
def bench():
    return replace(slm.perturbed_bench(start_of(SMALL), SMALL, 5)[0], source=THIRD)


def moved(bench, what):
    sensor, model = bench.sensor, bench.model
    if what == "camera":  # a tenth of its pixels
        matrices = {z: (*m[:2], m[2] + 0.006, *m[3:]) for z, m in sensor.homographies.items()}
        return replace(bench, sensor=replace(sensor, homographies=matrices))
    if what == "brightness":
        return replace(bench, sensor=replace(sensor, gain=1.03 * sensor.gain))
    if what == "focus":
        return replace(
            bench, model=replace(model, aberrations=(model.aberrations[0] + 0.1, *model.aberrations[1:]))
        )
    return replace(bench, phases=1.03 * bench.phases)


@pytest.mark.parametrize("what", ["camera", "brightness", "focus", "response"])
def test_drift_is_noticed(what, bench):
    captures, known = captures_of((bench, moved(bench, what)))
    before, after, times = drift(captures, known)
    assert (before, after) == (17, 33) and times > 1.25


def test_no_drift_is_seen_where_there_is_none(bench):
    assert drift(*captures_of((bench, bench))) is None


def test_a_bench_that_moves_is_refused(bench):
    then, looked = moved(bench, "camera"), []

    def look(levels, distance):
        looked.append(len(looked))
        if looked[-1] not in references(64):
            return np.zeros((34, 34))
        return (bench if len(looked) < 18 else then).capture_values(levels, distance)

    with pytest.raises(engine.InvalidInput, match="changed between captures 2 and 18"):
        slm.calibrate(look, SMALL, FOCI, count=64)


@pytest.mark.parametrize("sign", [pytest.param(1, marks=pytest.mark.slow), pytest.param(-1, id="falling")])
def test_the_sign_of_the_panel_is_found(sign, monkeypatch):
    """Both are tried; of a panel whose phase falls the curve falls."""
    monkeypatch.setattr("holopath_addon.slm.fitting.STAGES", STAGES[:1])
    monkeypatch.setattr("holopath_addon.slm.calibrating.MIN_EXPLAINED", -99)
    window, foci, reports = slm.PatternWindow(16, PITCH, GREEN), FOCI[:2], []
    rising, _ = slm.perturbed_bench(start_of(window, foci), window, 3)
    point = replace(rising.model, size=0.0, bandwidth=0.0)
    bench = replace(rising, model=point, phases=sign * rising.phases)
    found = slm.calibrate(
        bench.capture_values, window, foci, (0.95, 0.95), 20, progress=lambda done, _: reports.append(done)
    )
    assert reports == sorted(reports)
    assert sign * slm.calibration_of(found, window).phases(GREEN)[-1] > 0


@pytest.mark.slow
def test_what_the_model_gains():
    """Phases for the display as it is, against phases for an ideal one: on the bench itself."""
    window = slm.PatternWindow(40, PITCH, GREEN)
    bench, truth = slm.perturbed_bench(start_of(window), window, 1)
    bench = replace(bench, source=THIRD)
    volume = engine.Hologram(40, 40, PITCH, (GREEN,), depth_far=2e-3, depth_near=7e-3)
    data = smooth(4, shape=(40, 40)).astype(np.complex64)
    field = engine.WaveField(data, volume, engine.Camera(np.eye(4), 0.6), 0.5)
    target = engine.reconstruct(field, [float(field.mapping.z_to_depth(4.5e-3))])[0]
    curve = tuple(enumerate(map(float, truth.phases(8))))
    known = slm.Calibration(
        responses=(slm.Response(GREEN, curve=curve),), models=(truth.model,), sensors=(truth.sensor,)
    )

    def decibels(calibration):
        levels = {} if not calibration.models else {"levels": calibration.levels_of(volume)}
        phase = engine.encode(field, "joint", display=calibration.display([GREEN]), **levels)
        shown = [bench.phases[calibration.levels(frame[0], GREEN)] for frame in phase.data]
        view = np.mean([bench.picture(phases, 4.5e-3) for phases in shown], axis=0)
        return metrics.psnr(view[..., None], target, border=4)

    assert decibels(known) > decibels(slm.Calibration()) + 5


def test_file(tmp_path):
    start = start_of(SMALL)
    _, truth = slm.perturbed_bench(start, SMALL, 7)
    curve = ((0, 0.0), (255, 6.0))
    calibration = slm.Calibration(
        responses=(slm.Response(GREEN, curve=curve),), models=(truth.model,), sensors=(truth.sensor,)
    )
    calibration.save(tmp_path / "my.json")
    again = slm.Calibration.load(tmp_path / "my.json")
    described = again.display([GREEN])[0].to_dict()
    assert all(described[name] == pytest.approx(value) for name, value in truth.model.to_dict().items())
    assert again.sensor(GREEN).to_dict() == truth.sensor.to_dict()
    with pytest.raises(engine.InvalidInput, match=r"calibrated \(520 nm\), got 640 nm"):
        again.display([GREEN, 640e-9])


@pytest.mark.parametrize(
    "change",
    [{"tilt": [0]}, {"camera": {}}, {"unmodulated": [1, 1]}, {"wavelength_nm": "green"}],
)
def test_files_that_say_what_cannot_be(change, tmp_path):
    _, truth = slm.perturbed_bench(start_of(SMALL), SMALL, 7)
    slm.Calibration(models=(truth.model,), sensors=(truth.sensor,)).save(tmp_path / "my.json")
    described = json.loads((tmp_path / "my.json").read_text())
    described["displays"][0] |= change
    (tmp_path / "my.json").write_text(json.dumps(described))
    with pytest.raises(engine.InvalidInput, match="my.json"):
        slm.Calibration.load(tmp_path / "my.json")


WORDS = "calibrate --driver virtual --wavelength 520 --pitch 8 --distances 0.5,1 --window 16 --captures 20".split()


def test_command(tmp_path, monkeypatch, capsys):
    """Calibrate on the virtual bench with a source of few points, by a short first stage."""
    bench_of = slm.perturbed_bench
    monkeypatch.setattr(
        slm,
        "perturbed_bench",
        lambda *words: (replace(bench_of(*words)[0], source=THIRD), bench_of(*words)[1]),
    )
    monkeypatch.setattr("holopath_addon.slm.fitting.STAGES", STAGES[:1])
    monkeypatch.setattr("holopath_addon.slm.calibrating.MIN_EXPLAINED", -99)
    assert cli.main([*WORDS, "--out", str(tmp_path / "my.json")]) == 0
    assert "homography c at 0.5 mm" in capsys.readouterr().out
    calibration = slm.Calibration.load(tmp_path / "my.json")
    assert len(calibration.models) == 1 and calibration.display([520e-9])


@pytest.mark.slow
def test_another_wavelength_beside_the_first(tmp_path, monkeypatch):
    monkeypatch.setattr("holopath_addon.slm.fitting.STAGES", STAGES[:1])
    monkeypatch.setattr("holopath_addon.slm.calibrating.MIN_EXPLAINED", -99)
    words = [*WORDS, "--quiet", "--out", str(tmp_path / "my.json")]
    assert cli.main(words) == 0
    words[words.index("520")] = "640"
    assert cli.main(words) == 0
    assert len(slm.Calibration.load(tmp_path / "my.json").display([640e-9, 520e-9])) == 2


@pytest.mark.parametrize("light", [None, 2])
def test_the_light_of_a_controller(light, tmp_path, capsys):
    """Each pattern names it; the camera fails at the first."""
    pytest.importorskip("termios", reason="There are ptys on Unix alone.")
    from tests.slm.device import Board, Firmware

    slm.FocusPlanes((slm.Plane(5e-4, 0), slm.Plane(1e-3, 5))).save(tmp_path / "planes.json")
    with Board(Firmware()) as board:
        words = ["--driver", "serial", "--port", board.path, "--focus-planes", str(tmp_path / "planes.json")]
        words += ["--light", str(light)] * (light is not None)
        words += ["--camera", f"'{sys.executable}' -c 'raise SystemExit(1)' {{file}}", "--settle", "0"]
        assert cli.main([*WORDS, "--out", str(tmp_path / "my.json"), *words]) == 2
    assert "took no picture" in capsys.readouterr().err
    assert [shown[3] for shown in board.firmware.shown] == [light or 0]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--light", "-1"], "from 0 to 255, got -1"),
        (["--light", "1"], "--light would have no effect here. Add --driver serial"),
        (["--out", "my.txt"], "Expected a .json file for the calibration"),
        (["--window", "4"], "16 to 512"),
        (["--captures", "10"], "ten captures at each"),
        (["--distances", "0.5"], "two or more foci"),
        (["--bits", "40"], "1 to 16 bits"),
        (["--driver", "slmsuite"], "camera is missing"),
        (["--packing", "slm-200"], "levels of 10 bits, got 8. Choose another packing"),
    ],
)
def test_refusals(words, sentence, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main([*WORDS, "--out", "my.json", *words]) == 2
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_device_that_turns_its_pictures_is_refused(tmp_path, capsys):
    """Its file stays as it is."""
    slm.Calibration(flip_x=True).save(tmp_path / "my.json")
    before = (tmp_path / "my.json").read_bytes()
    assert cli.main([*WORDS, "--out", str(tmp_path / "my.json")]) == 2
    assert "Name another file" in capsys.readouterr().err
    assert (tmp_path / "my.json").read_bytes() == before


def test_a_camera_that_sees_nothing_is_refused(monkeypatch):
    monkeypatch.setattr("holopath_addon.slm.fitting.STAGES", STAGES[:1])
    with pytest.raises(engine.InvalidInput, match="explains only"):
        rng = np.random.default_rng(0)
        first = rng.random((22, 22))
        slm.calibrate(lambda levels, z: first, slm.PatternWindow(16, PITCH, GREEN), (1e-3, 2e-3), count=20)


def test_a_camera_in_the_dark_is_refused():
    with pytest.raises(engine.InvalidInput, match="got 20 that are 0 everywhere. Check the light source"):
        slm.calibrate(
            lambda levels, z: np.zeros((22, 22)), slm.PatternWindow(16, PITCH, GREEN), (1e-3, 2e-3), count=20
        )


@pytest.mark.parametrize("end", [0, 1, None])
def test_a_camera_whose_values_are_not_linear_is_refused(end, monkeypatch):
    """The fit's exponent ends at a bound."""
    window = slm.PatternWindow(16, PITCH, GREEN)
    setup, rows = start_of(window), parameters(start_of(window))
    bounds = next(row.bounds for row in rows if row.name == "gamma")
    gamma = 1.1 if end is None else bounds[end]
    setup = replace(setup, sensor=replace(setup.sensor, gamma=gamma))
    result = slm.FitResult(setup, rows, vector(setup), np.zeros(len(rows)), 0.1, 0.9)
    monkeypatch.setattr("holopath_addon.slm.calibrating.fit", lambda *_: result)
    first = np.random.default_rng(0).random((22, 22))

    def calibrated():
        return slm.calibrate(lambda levels, z: first, window, (1e-3, 2e-3), count=20)

    if end is None:
        assert calibrated() is result
        return
    with pytest.raises(engine.InvalidInput, match="linear in light, got the exponent"):
        calibrated()
