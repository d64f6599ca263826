"""Phases on disk."""

from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.encoding import phase_hologram
from holopath_addon.engine.scene import variants
from holopath_addon.engine.waves.modulator import gray_levels


def test_round_trip(field, tmp_path):
    mi = variants.bitmaps()
    phase = engine.encode(field, "dpac")
    phase.save(tmp_path / "hologram")
    names = {path.name for path in (tmp_path / "hologram").iterdir()}
    pictures = {f"frame_00{m}_{nm}nm.png" for m in (0, 1) for nm in (640, 500)}
    assert names == {"phase.npy", "meta.json"} | pictures
    stored = engine.PhaseHologram.load(tmp_path / "hologram")
    np.testing.assert_array_equal(stored.data, phase.data)
    assert (stored.hologram, stored.near, stored.method, stored.gains) == (
        phase.hologram,
        phase.near,
        phase.method,
        phase.gains,
    )
    shown = np.asarray(mi.Bitmap(str(tmp_path / "hologram" / "frame_001_500nm.png")))
    np.testing.assert_array_equal(np.squeeze(shown), gray_levels(phase.data[1, 1]))

    (tmp_path / "hologram" / "phase.npy").write_bytes(b"no")
    with pytest.raises(engine.InvalidInput, match="damaged"):
        engine.PhaseHologram.load(tmp_path / "hologram")
    with pytest.raises(engine.InvalidInput, match="holds no hologram"):
        engine.PhaseHologram.load(tmp_path)
    field.save(tmp_path / "wavefield")
    with pytest.raises(engine.InvalidInput, match="something other"):
        phase.save(tmp_path / "wavefield")
    assert (tmp_path / "wavefield" / "field.npy").exists()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "diary.txt").write_text("mine")
    with pytest.raises(engine.InvalidInput, match="something other"):
        phase.save(tmp_path / "other")
    assert (tmp_path / "other" / "diary.txt").read_text() == "mine"


def test_arrays_of_other_libraries_are_saved(other_library, field, tmp_path):
    """The field and the phases, whole."""
    own = replace(field, data=other_library.asarray(field.data))
    own.save(tmp_path / "wavefield")
    np.testing.assert_array_equal(engine.WaveField.load(tmp_path / "wavefield").data, field.data)
    phase = engine.encode(own, "dpac")
    phase.save(tmp_path / "hologram")
    stored = engine.PhaseHologram.load(tmp_path / "hologram")
    np.testing.assert_array_equal(stored.data, np.asarray(phase.data))


def test_what_is_beside_phases_is_not_lost(field, tmp_path):
    """Pictures that `stream --captures` or `reconstruct` put there, but for what file browsers leave."""
    phase, folder = engine.encode(field, "dpac"), tmp_path / "hologram"
    phase.save(folder)
    (folder / "shots").mkdir()
    with pytest.raises(engine.InvalidInput, match="holds shots beside a hologram, which would be lost"):
        phase.save(folder)
    (folder / "shots").rmdir()
    (folder / ".DS_Store").touch()
    phase.save(folder)
    assert not (folder / ".DS_Store").exists()


def test_close_wavelengths_have_files_of_their_own():
    assert phase_hologram.picture_names(3, (640.2e-9, 640.4e-9)) == [
        "frame_003_640.2nm.png",
        "frame_003_640.4nm.png",
    ]


@pytest.mark.parametrize(
    ("count", "others", "says"),
    [
        (1, {}, "one set of levels for each of the wavelengths, 2, got 1"),
        (2, {"modulator": engine.Modulator(bits=4)}, "Omit one of them"),
        (2, {"display": [None, None]}, "Omit one of them"),
    ],
)
def test_levels_that_do_not_go_with_it(count, others, says, field):
    phase = engine.encode(field, "dpac")
    with pytest.raises(engine.InvalidInput, match=says):
        phase.field(levels=[engine.Levels((0, 1))] * count, **others)


def test_levels_are_the_nearest_of_each_wavelength(field):
    phase = engine.encode(field, "dpac")
    levels = [engine.Levels((0.0, np.pi)), engine.Levels((1.0, 2.0, 4.0))]
    light = phase.field(levels=levels).data
    for color, known in enumerate(((0.0, np.pi), (1.0, 2.0, 4.0))):
        chords = np.abs(np.exp(1j * phase.data[:, color, ..., None]) - np.exp(1j * np.array(known)))
        expected = phase.gains[color] * np.exp(1j * np.array(known))[chords.argmin(-1)]
        np.testing.assert_allclose(light[:, color], expected, atol=1e-5 * phase.gains[color])
