"""The bench by words and files, and on the command line: what is taken, kept, shown, and refused."""

import json
import math

import numpy as np
import pytest

from holopath_addon import cli, engine, exchange, slm
from holopath_addon.cli import render_command
from holopath_addon.engine.waves.display_model import DisplayModel
from holopath_addon.workflow import output

SHAPE = (48, 64)


def test_words_of_a_beam():
    beam = engine.Beam
    assert exchange.parse_beam("flat") == beam()
    assert exchange.parse_beam("tilt:1,-0.5") == beam("tilt", (math.radians(1), math.radians(-0.5)))
    assert exchange.parse_beam("point:-120") == beam("point", (-0.12,))
    assert exchange.parse_beam("gaussian:2") == beam("gaussian", (2e-3,))
    assert exchange.parse_beam("gaussian:2,0.5,-1") == beam("gaussian", (2e-3, 0.5e-3, -1e-3))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("round", "Expected a beam"),
        ("tilt:a,b", "Expected a beam"),
        ("point:0", "one distance, which is not 0"),
        ("gaussian:-1", "a waist over 0"),
        ("missing.npy", "does not exist. Give a file of"),
        ("phase=a.npy", "got phase"),
        ("amplitude=a.npy,width=b.npy", "got amplitude and width"),
    ],
)
def test_words_that_are_no_beam(words, says):
    with pytest.raises(engine.InvalidInput, match=says):
        exchange.parse_beam(words)


def test_files_of_a_beam(tmp_path):
    rng = np.random.default_rng(0)
    size, phase = rng.uniform(0.2, 1, SHAPE), rng.uniform(-3, 3, SHAPE)
    size[3, 4] = 1
    target = size * np.exp(1j * phase)
    files = {
        "a": size,
        "i": size**2,
        "p": phase,
        "c": 3 * target,
        "levels": np.round(255 * size).astype(np.uint8),
    }
    for name, array in files.items():
        np.save(tmp_path / f"{name}.npy", array)
    at = str(tmp_path)
    for words in (
        f"{at}/c.npy",
        f"amplitude={at}/a.npy,phase={at}/p.npy",
        f"intensity={at}/i.npy,phase={at}/p.npy",
    ):
        np.testing.assert_allclose(exchange.parse_beam(words).measured, target, atol=1e-6)
    levels = exchange.parse_beam(f"amplitude={at}/levels.npy").measured
    np.testing.assert_allclose(levels, size, atol=1 / 255)
    np.savez(tmp_path / "two.npz", amplitude=size, phase=phase)
    both = f"amplitude={at}/two.npz,phase={at}/two.npz"
    np.testing.assert_allclose(exchange.parse_beam(both).measured, target, atol=1e-6)
    np.save(tmp_path / "wide.npy", size[:, :-1])
    for words, says in (
        (f"{at}/a.npy", "amplitude or its intensity. Give"),
        (f"amplitude={at}/c.npy", "without amplitude="),
        (f"amplitude={at}/a.npy,phase={at}/levels.npy", "in radians"),
        (f"amplitude={at}/wide.npy,phase={at}/p.npy", "differ"),
        (f"amplitude={at}/p.npy", "has negative values. Subtract its background first"),
        (f"intensity={at}/two.npz", "2 arrays"),
    ):
        with pytest.raises(engine.InvalidInput, match=says):
            exchange.parse_beam(words)


@pytest.fixture
def folder(tmp_path):
    """An output folder with a field of narrow band."""
    rng = np.random.default_rng(1)
    noise = rng.normal(size=SHAPE) + 1j * rng.normal(size=SHAPE)
    radius = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n) for n in SHAPE), indexing="ij"))
    data = np.fft.ifft2(np.fft.fft2(noise) * (radius < 0.1)).astype(np.complex64)[None, None]
    hologram = engine.Hologram(SHAPE[1], SHAPE[0], 8e-6, (520e-9,), 1e-3, 1.5e-3)
    with output.output_folder(tmp_path / "out") as part:
        engine.WaveField(data, hologram, engine.Camera(np.eye(4), 0.5), 1.0).save(part / "wavefield")
        output.write_report(part, {"format": output.FORMAT, "format_version": output.FORMAT_VERSION})
    return tmp_path / "out"


def view(folder):
    (picture,) = (folder / "reconstruction").glob("hologram_*.exr")
    return np.array(engine.variants.bitmaps().Bitmap(str(picture)))[..., 0]


def test_a_beam_on_the_command_line(folder, tmp_path, capsys):
    """Phases for a beam show the field on it, and not on a flat one; other programs' phases take it, too."""
    field, beam = engine.WaveField.load(folder / "wavefield"), "tilt:1,0.5"
    encode = ["encode", str(folder), "--method", "sgd", "--max-steps", "40", "--quiet"]
    assert cli.main([*encode, f"--beam={beam}"]) == 0
    phase = engine.PhaseHologram.load(folder / "hologram")
    assert phase.hologram.optics.beam == exchange.parse_beam(beam)
    target = engine.reconstruct(field, [1.2])[0, ..., 0]

    def alike(*words):
        show = ["reconstruct", str(folder), "--hologram", "--focus", "1.2", "--quiet", *words]
        assert cli.main(show) == 0
        return float(np.corrcoef(view(folder).ravel(), target.ravel())[0, 1])

    assert alike() > 0.8
    assert abs(alike("--beam", "flat")) < 0.3
    assert cli.main(["export", str(folder), str(tmp_path / "phases.npz"), "--hologram", "--quiet"]) == 0
    take = ["import", str(tmp_path / "phases.npz"), "--quiet", "--out"]
    for words, other in (([], beam), (["--beam", "point:-90"], "point:-90")):
        assert cli.main([*take, str(tmp_path / other), *words]) == 0
        again = engine.PhaseHologram.load(tmp_path / other / "hologram")
        assert again.hologram.optics.beam == exchange.parse_beam(other)
    meta = json.loads((folder / "hologram" / "meta.json").read_text())
    assert meta["hologram"]["optics"] == {
        "beam": {"kind": "tilt", "numbers": [math.radians(1), math.radians(0.5)]}
    }

    capsys.readouterr()
    for words, says in (
        ([*encode, "--beam", "gaussian:0.01,3,0"], "passes the panel"),
        ([*encode, "--beam", "tilt:9,0"], "Tilt or focus it less"),
        (["reconstruct", str(folder), "--focus", "1.2", "--beam", "flat"], "Add --hologram"),
    ):
        assert cli.main(words) == 2
        assert says in capsys.readouterr().err
    assert engine.PhaseHologram.load(folder / "hologram").hologram == phase.hologram


def test_words_of_colors():
    assert exchange.parse_colors("color_scale", "1.02,1,0.98") == (1.02, 1.0, 0.98)
    assert exchange.parse_colors("color_distance", "-0.5") == (-0.5e-3,)
    assert exchange.parse_colors("color_shift", "1,-2,0,0") == ((1e-3, -2e-3), (0.0, 0.0))
    for name, words in (("color_scale", "2%"), ("color_distance", "1;2"), ("color_shift", "1,2,3")):
        with pytest.raises(engine.InvalidInput, match="for each wavelength"):
            exchange.parse_colors(name, words)


def test_colors_on_the_command_line(folder, tmp_path, capsys):
    """A stored field is brought to where the panel lies for a color, phases know it, and so do files of others."""
    words = ["encode", str(folder), "--method", "sgd", "--max-steps", "30", "--quiet"]
    colors = ["--color-scale", "1.02", "--color-distance=-0.2", "--color-shift", "0.01,0"]
    assert cli.main([*words, *colors]) == 0
    phase = engine.PhaseHologram.load(folder / "hologram")
    optics = engine.Optics(color_scale=(1.02,), color_distance=(-0.2e-3,), color_shift=((0.01e-3, 0),))
    assert phase.hologram.optics == optics
    field = engine.WaveField.load(folder / "wavefield")
    target = engine.reconstruct(engine.at_panel(field, optics), [1.2])[0, 8:-8, 8:-8, 0]

    def alike(*words):
        assert cli.main(["reconstruct", str(folder), "--hologram", "--focus", "1.2", "--quiet", *words]) == 0
        return float(np.corrcoef(view(folder)[8:-8, 8:-8].ravel(), target.ravel())[0, 1])

    assert alike() > 0.8
    assert alike("--color-shift", "0.05,0") < 0.5
    assert cli.main(["export", str(folder), str(tmp_path / "phases.npz"), "--hologram", "--quiet"]) == 0
    assert (
        cli.main(["import", str(tmp_path / "phases.npz"), "--quiet", "--out", str(tmp_path / "again")]) == 0
    )
    assert engine.PhaseHologram.load(tmp_path / "again" / "hologram").hologram == phase.hologram
    capsys.readouterr()
    assert cli.main([*words, "--color-scale", "1,1.02"]) == 2
    assert "Expected a scale for each of 1 wavelengths, got 2" in capsys.readouterr().err
    assert engine.PhaseHologram.load(folder / "hologram").hologram == phase.hologram


def test_colors_of_a_calibration(folder, tmp_path, capsys):
    """Its numbers are those that words would say: of phases, files of others, a scene, and where light is seen."""
    model, focus = DisplayModel(520e-9, aberrations=(1.0, *7 * (0.0,))), {1e-3: (1, 0, 0, 0, 1, 0, 0, 0)}
    slm.Calibration(models=(model,), sensors=(slm.Sensor((8, 8), homographies=focus),)).save(
        tmp_path / "slm.json"
    )
    expected = engine.Optics(color_distance=(round(8 * math.sqrt(3) * 64e-12 / (math.pi * 520e-9), 9),))
    colors = ["--colors-from", str(tmp_path / "slm.json"), "--quiet"]
    assert cli.main(["encode", str(folder), "--method", "dpac", *colors]) == 0
    phase = engine.PhaseHologram.load(folder / "hologram")
    assert phase.hologram.optics == expected
    field = str(tmp_path / "field.npz")
    assert cli.main(["export", str(folder), field, "--quiet"]) == 0
    assert cli.main(["import", field, *colors, "--out", str(tmp_path / "own")]) == 0
    assert engine.WaveField.load(tmp_path / "own" / "wavefield").hologram.optics == expected
    assert (
        cli.main(["encode", str(folder), "--method", "dpac", "--quiet", "--out", str(tmp_path / "plain")])
        == 0
    )
    seen_so = ["reconstruct", str(folder), "--hologram", "--focus", "1.2"]
    assert cli.main([*seen_so, *colors]) == 0
    corrected = view(folder)
    assert cli.main([*seen_so, "--quiet"]) == 0
    assert np.array_equal(view(folder), corrected)
    assert cli.main([*seen_so, "--color-distance", "0", "--quiet"]) == 0
    assert not np.allclose(view(folder), corrected, rtol=0.1)
    words = cli.parse(["render", "demo:planes", *colors[:2], "--out", "unused"])
    assert render_command.hologram_of(words, phase.hologram).optics == expected
    for words, says in (
        (
            ["--color-scale", "1.1"],
            "Expected either --colors-from or --color-scale, got both. Omit one of them",
        ),
        (["--colors-from", str(tmp_path / "no.json")], "no.json cannot be read"),
    ):
        assert cli.main(["encode", str(folder), "--method", "dpac", *colors, *words]) == 2
        assert says in capsys.readouterr().err


def test_a_measured_beam_in_other_programs_files(folder, tmp_path):
    """Its array goes with HoloPath's own folders; of a file, it must be named."""
    np.save(tmp_path / "beam.npy", np.linspace(0.5, 1, 64)[None, :] * np.ones((48, 1)))
    beam = f"amplitude={tmp_path}/beam.npy"
    words = ["encode", str(folder), "--method", "dpac", "--quiet", f"--beam={beam}"]
    assert cli.main(words) == 0
    phase = engine.PhaseHologram.load(folder / "hologram")
    assert phase.hologram.optics.beam == exchange.parse_beam(beam)
    container = exchange.container_of(phase)
    with pytest.raises(engine.InvalidInput, match="Give it by --beam"):
        exchange.hologram_of(container)
    given = exchange.ReadOptions(optics=engine.Optics(exchange.parse_beam(beam)))
    assert exchange.hologram_of(container, given).hologram == phase.hologram


def test_words_of_a_lens():
    lens = engine.Lens
    assert exchange.parse_lens("100") == lens(0.1) == lens(0.1, 0.1)
    assert exchange.parse_lens("100@50") == lens(0.1, 0.05)
    assert exchange.parse_lens("100@50@120") == lens(0.1, 0.05, 0.12)
    assert exchange.parse_lens("-100@50@120") == lens(-0.1, 0.05, 0.12)
    assert exchange.parse_lens("100@100@100@0.7") == lens(0.1, 0.1, 0.1, 0.7)
    assert exchange.parse_lens("none") is None
    for words in ("", "100@", "@50", "1@2@3@1@4", "a@b"):
        with pytest.raises(engine.InvalidInput, match="Expected a lens"):
            exchange.parse_lens(words)


def test_words_of_a_stop(tmp_path):
    stop = engine.Stop
    assert exchange.parse_stop("circle") == stop() and exchange.parse_stop("circle:0.4") == stop(
        "circle", (0.4,)
    )
    assert exchange.parse_stop("half:90") == stop("half", (math.pi / 2,))
    assert exchange.parse_stop("rectangle:1,0.5") == stop("rectangle", (1, 0.5))
    assert exchange.parse_carrier("0.5,-0.25") == (0.5, -0.25) and exchange.parse_carrier("auto") == "auto"
    plane = np.zeros((9, 9), np.uint8)
    plane[3:6, 6:] = 200
    np.save(tmp_path / "plane.npy", plane)
    np.testing.assert_array_equal(exchange.parse_stop(f"{tmp_path}/plane.npy").measured, plane > 0)
    for parse, words in (
        (exchange.parse_stop, "slit"),
        (exchange.parse_stop, "disk:0.3,0.2,0.1"),
        (exchange.parse_stop, "rectangle:a"),
        (exchange.parse_carrier, "0.5"),
        (exchange.parse_carrier, "left"),
    ):
        with pytest.raises(engine.InvalidInput, match=f"Expected .*got '{words}'"):
            parse(words)


def test_a_stop_on_the_command_line(folder, tmp_path, capsys):
    encode = ["encode", str(folder), "--method", "sgd", "--max-steps", "40", "--bits", "1", "--quiet"]
    assert cli.main([*encode, "--stop", "half:-90"]) == 0
    optics = engine.PhaseHologram.load(folder / "hologram").hologram.optics
    assert optics.stop.kind == "half" and optics.carrier == pytest.approx((0, -0.5))
    assert cli.main([*encode, "--carrier", "-0.5,0"]) == 0
    phase = engine.PhaseHologram.load(folder / "hologram")
    assert phase.hologram.optics == engine.Optics(carrier=(-0.5, 0))
    assert cli.main(["export", str(folder), str(tmp_path / "phases.npz"), "--hologram", "--quiet"]) == 0
    assert (
        cli.main(["import", str(tmp_path / "phases.npz"), "--out", str(tmp_path / "again"), "--quiet"]) == 0
    )
    assert engine.PhaseHologram.load(tmp_path / "again" / "hologram").hologram == phase.hologram
    show = ["reconstruct", str(folder), "--hologram", "--focus", "1.2", "--quiet"]
    target = engine.reconstruct(engine.WaveField.load(folder / "wavefield"), [1.2])[0, ..., 0]
    alike = []
    for words in ([], ["--carrier", "0,0", "--stop", "circle"]):
        assert cli.main([*show, *words]) == 0
        alike.append(np.corrcoef(view(folder).ravel(), target.ravel())[0, 1])
    assert alike[0] > 0.5 and abs(alike[1]) < 0.3  # one frame of one bit
    capsys.readouterr()
    for words, says in (
        (["--carrier", "0.9,0.9"], "Expected a carrier within the band"),
        (["--carrier", "0.5,0", "--stop", "circle:0.8"], "reaches 1.3 times as far"),
        (["--stop", "hole"], "Expected a stop"),
    ):
        assert cli.main([*encode, *words]) == 2
        assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("attributes", "differs"),
    [
        ({"units": "degrees"}, "units"),
        ({"row_0": "bottom"}, "row_0"),
        ({"time_dependence": "exp(+i omega t)"}, "time_dependence"),
        ({"axes": "x,y"}, "axes"),
        ({"axes": "wavelength,y,x", "units": "radians", "row_0": "top"}, ""),
    ],
)
def test_a_beam_in_another_convention(attributes, differs, tmp_path):
    h5py = pytest.importorskip("h5py")
    for name in ("amplitude", "phase"):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file.create_dataset(name, data=np.ones((4, 6))).attrs.update(
                attributes if name == "phase" else {}
            )
    text = f"amplitude={tmp_path / 'amplitude.h5'},phase={tmp_path / 'phase.h5'}"
    if not differs:
        assert exchange.parse_beam(text).measured.shape == (4, 6)
        return
    with pytest.raises(engine.InvalidInput, match=f"phase.h5.*got {differs} .*Write it so"):
        exchange.parse_beam(text)
