"""Wave fields on disk."""

import numpy as np
import pytest

from holopath_addon import engine


@pytest.fixture
def field():
    rng = np.random.default_rng(0)
    data = (rng.standard_normal((2, 1, 24, 32)) + 1j * rng.standard_normal((2, 1, 24, 32))).astype(
        np.complex64
    )
    hologram = engine.Hologram(32, 24, 8e-6, (516.5e-9,), 1e-3, 3e-3)
    return engine.WaveField(data, hologram, engine.Camera(np.eye(4), 0.4), 0.5, {"wrp": 2e-3}, {"frames": 2})


def test_there_and_back(field, tmp_path):
    field.save(tmp_path / "wavefield")
    again = engine.WaveField.load(tmp_path / "wavefield")
    assert isinstance(again.data, np.memmap)
    np.testing.assert_array_equal(again.data, field.data)
    assert again.hologram == field.hologram and again.near == 0.5 and again.plan == {"wrp": 2e-3}
    np.testing.assert_allclose(engine.reconstruct(again, [0.7]), engine.reconstruct(field, [0.7]))


def test_saving_again_replaces(field, tmp_path):
    for _ in range(2):
        field.save(tmp_path / "wavefield")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["wavefield"]


def test_other_people_s_folders_are_left_alone(field, tmp_path):
    (tmp_path / "thesis.tex").write_text("irreplaceable")
    with pytest.raises(engine.InvalidInput, match="something other"):
        field.save(tmp_path)
    assert (tmp_path / "thesis.tex").read_text() == "irreplaceable"


def test_failed_writing_leaves_nothing(field, tmp_path, monkeypatch):
    field.save(tmp_path / "wavefield")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    with pytest.raises(OSError):
        field.save(tmp_path / "wavefield")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["wavefield"]
    np.testing.assert_array_equal(engine.WaveField.load(tmp_path / "wavefield").data, field.data)


@pytest.mark.parametrize("damage", ["missing", "text", "shape", "version", "pickle"])
def test_damaged_fields_are_refused_in_a_sentence(field, tmp_path, damage):
    folder = tmp_path / "wavefield"
    field.save(folder)
    meta = folder / "meta.json"
    if damage == "missing":
        (folder / "field.npy").unlink()
    elif damage == "text":
        meta.write_text("{")
    elif damage == "shape":
        np.save(folder / "field.npy", np.zeros((1, 1, 2, 2), np.complex64))
    elif damage == "version":
        meta.write_text(meta.read_text().replace('"format_version": 1', '"format_version": 99'))
    else:
        np.save(folder / "field.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(engine.InvalidInput, match="wavefield"):
        engine.WaveField.load(folder)
