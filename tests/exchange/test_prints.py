"""Prints: what other programs read of them, and what `holopath export --interference` refuses."""

from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import cli, engine, exchange
from holopath_addon.exchange import prints
from holopath_addon.workflow import output
from tests.exchange.fields import field, phases

PIL = pytest.importorskip("PIL.Image")


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("bits", prints.BITS)
def test_pictures_and_the_size_of_their_dots(tmp_path, suffix, bits):
    """Read prints by Pillow, which shares no code with the writer, and by our own reader."""
    file, top = tmp_path / f"a.{suffix}", 2**bits - 1
    picture = np.random.default_rng(0).uniform(size=(5, 11)).round() if bits == 1 else np.linspace(0, 1, 55)
    picture = picture.reshape(5, 11)
    prints.write_print(file, picture, bits, 8e-6)
    with PIL.open(file) as found:
        assert found.mode == {1: "1", 8: "L", 16: "I;16"}[bits]
        assert found.info["dpi"] == pytest.approx((3175, 3175), rel=1e-4)
        np.testing.assert_array_equal(np.array(found).astype(int), np.round(picture * top))
    (again,) = exchange.read(file).arrays.values()
    np.testing.assert_array_equal(again.astype(int), np.round(picture * top))


@pytest.fixture
def folder(tmp_path):
    """Three frames of two wavelengths on axis, of pixels of 8 µm, and their phases off axis."""
    with output.output_folder(tmp_path / "out") as part:
        field(height=32, width=48).save(part / "wavefield")
        phases().save(part / "hologram")
        output.write_report(part, {})
    return tmp_path / "out"


def test_on_the_command_line(folder, tmp_path, capsys):
    file, again = tmp_path / "a.png", tmp_path / "again.png"
    words = ["export", str(folder), str(file), "--interference", "--frame", "1", "--wavelength", "455"]
    assert cli.main([*words, "--dpi", "3175"]) == 0
    messages = capsys.readouterr().err
    # sin(angle) = 455.4 nm / (4 x 8 µm)
    assert (
        "0.384 x 0.256 mm at 3175 dots per inch" in messages
        and "0.815 and 0 degrees to the right" in messages
    )
    optics = engine.Optics(carrier="auto")
    stored = output.stored_field(folder)
    expected = engine.interference(
        engine.WaveField(
            stored.data,
            engine.Hologram(48, 32, 8e-6, stored.hologram.wavelengths, 1e-3, 3e-3, optics=optics),
            stored.camera,
            stored.near,
        ),
        frame=1,
        color=1,
    )
    (found,) = exchange.read(file).arrays.values()
    np.testing.assert_array_equal(found, np.round(255 * expected))
    words[2] = str(again)
    assert cli.main([*words, "--carrier", "0,0.6", "--bits", "1", "--quiet"]) == 0
    with PIL.open(again) as found:
        assert found.mode == "1" and found.info["dpi"] == pytest.approx((3175, 3175), rel=1e-4)


WHICH = ["--frame", "0", "--wavelength", "640"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--interference"], "Expected one frame for a print, got 3. Choose one with --frame N"),
        (["--interference", "--frame", "3"], "Expected a frame from 0 to 2, got 3"),
        (["--interference", "--frame", "0"], "Choose --wavelength 640, 455.4"),
        (
            ["--interference", "--frame", "0", "--wavelength", "532"],
            "Expected a wavelength of the hologram, got 532 nm",
        ),
        (["--interference", *WHICH, "--dpi", "2400"], "2400 dots per inch are 10.583 µm apart, the"),
        (["--interference", *WHICH, "--dpi", "0"], "positive number of dots"),
        (["--interference", *WHICH, "--carrier", "0,0"], "the image and its twin overlap"),
        (["--interference", *WHICH, "--carrier", "1,0"], "Expected a carrier within the band"),
        (["--interference", *WHICH, "--axes", "y,x"], "A print has no convention"),
        (["--interference", *WHICH, "--hologram"], "Encode with --carrier auto"),
        (
            ["--interference", *WHICH, "--hologram", "--carrier", "auto"],
            "Stored phases have their own carrier",
        ),
        (["--dpi", "3175"], "Expected --interference with --dpi. Add it"),
        (["--bits", "1"], "Expected --interference with --bits"),
    ],
)
def test_what_is_refused(folder, tmp_path, capsys, words, says):
    assert cli.main(["export", str(folder), str(tmp_path / "a.png"), *words]) == 2
    assert says in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"out"}


def test_another_kind_of_file(folder, tmp_path, capsys):
    assert cli.main(["export", str(folder), str(tmp_path / "a.jpg"), "--interference", *WHICH]) == 2
    assert "Expected a print of" in capsys.readouterr().err


def test_pixels_that_are_not_square(folder, tmp_path, capsys):
    stored = output.stored_field(folder)
    oblong = replace(stored, hologram=replace(stored.hologram, pitch=(6.4e-6, 8e-6)))
    oblong.save(tmp_path / "oblong" / "wavefield")
    assert (
        cli.main(["export", str(tmp_path / "oblong"), str(tmp_path / "a.png"), "--interference", *WHICH]) == 2
    )
    assert "Expected square pixels for a print, got 6.4" in capsys.readouterr().err
