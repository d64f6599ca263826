"""Kinds of files: what is written is read again exactly, and what is damaged is refused in one sentence."""

import random

import h5py
import numpy as np
import pytest
import scipy.io

from holopath_addon import exchange
from holopath_addon.engine import BackendUnavailable, InvalidInput
from tests.exchange import fields

WHOLE = [suffix for suffix in exchange.SUFFIXES if suffix != ".npy"]  # which has no attributes
DAMAGED = {".npz": 400, ".safetensors": 400, ".h5": 10, ".mat": 10}  # a process each takes its time


@pytest.mark.parametrize("suffix", WHOLE)
@pytest.mark.parametrize("make", [fields.field, fields.phases])
def test_what_is_written_is_read_again(make, suffix, tmp_path):
    thing, file = make(), tmp_path / f"a{suffix}"
    convention = exchange.CONVENTIONS["matlab"] if suffix == ".mat" else None
    exchange.write(file, exchange.container_of(thing, convention))
    again = exchange.hologram_of(exchange.read(file))
    assert type(again) is type(thing) and again.data.dtype == thing.data.dtype
    assert np.array_equal(again.data, thing.data)
    assert again.hologram == thing.hologram and again.near == thing.near
    assert again.camera.to_dict() == thing.camera.to_dict()
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_hdf5_has_units_and_conventions_as_attributes(tmp_path):
    exchange.write(tmp_path / "a.h5", exchange.container_of(fields.field()))
    with h5py.File(tmp_path / "a.h5") as file:
        stored = file["field"]
        assert stored.shape == (3, 2, 6, 9) and stored.dtype == np.complex64
        assert stored.attrs["pitch_m"] == 8e-6 and list(stored.attrs["wavelengths_m"]) == [640e-9, 455.4e-9]
        assert stored.attrs["axes"] == "frame,wavelength,y,x" and stored.attrs["row_0"] == "top"
        assert stored.attrs["time_dependence"] == "exp(-i omega t)" and stored.attrs["depth_far_m"] == 1e-3


def test_matlab_sees_pictures_as_it_indexes_them(tmp_path):
    """Its files of version 7.3 are HDF5 with axes in reverse, 512 bytes in, and a class for each variable."""
    thing, file = fields.field(), tmp_path / "a.mat"
    exchange.write(file, exchange.container_of(thing, exchange.CONVENTIONS["matlab"]))
    header = file.read_bytes()[:128]
    assert header.startswith(b"MATLAB 7.3 MAT-file") and header[124:] == b"\x00\x02IM"
    with h5py.File(file) as stored:
        field = stored["field"]
        assert field.attrs["MATLAB_class"] == b"single" and field.dtype.names == ("real", "imag")
        assert field.shape == (3, 2, 9, 6)  # in MATLAB: y, x, wavelength, frame
        assert field["real"][1, 0, 4, 2] == thing.data[1, 0, 2, 4].real
        assert stored["pitch_m"].shape == (1, 1) and stored["wavelengths_m"].shape == (2, 1)
        assert bytes(stored["row_0"][:].astype(np.uint8)) == b"top"


def test_older_matlab_files_are_read(tmp_path):
    picture = fields.field(1).data[0, 0]
    scipy.io.savemat(tmp_path / "a.mat", {"u": picture, "pitch_m": 8e-6, "wavelengths_m": [[640e-9]]})
    found = exchange.hologram_of(exchange.read(tmp_path / "a.mat"))
    assert np.array_equal(found.data[0, 0], picture) and found.hologram.pitch == 8e-6


def test_compounds_that_are_no_complex_numbers_are_left_out(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["table"] = np.zeros((3, 3), [("name", "i4"), ("value", "f8")])
        file["polar"] = np.zeros((3, 3), [("amplitude", "f4"), ("phase", "f4")])
        file["group/u"] = np.ones((4, 5), np.complex128)
    assert list(exchange.read(tmp_path / "a.h5").arrays) == ["group/u"]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("a.pt", "is pickled, and could run any code when it is read"),
        ("a.tga", "Expected a file of"),
        ("none.npz", "does not exist. Give a file of"),
        ("pickle.npy", "cannot be read"),
        ("empty.npz", "has no array of numbers. Give another file"),
    ],
)
def test_what_is_refused(name, says, tmp_path):
    np.save(tmp_path / "pickle.npy", np.array([{"a": 1}], object), allow_pickle=True)
    np.savez(tmp_path / "empty.npz", words=np.array(["a", "b"]))
    with pytest.raises(InvalidInput, match=says) as output:
        exchange.read(tmp_path / name)
    assert "\n" not in str(output.value)


def test_a_library_that_lacks_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "safetensors.numpy", None)
    with pytest.raises(BackendUnavailable, match="pip install safetensors"):
        exchange.write(tmp_path / "a.safetensors", exchange.container_of(fields.field()))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", DAMAGED)
def test_damaged_files_are_refused_in_a_sentence(suffix, tmp_path):
    damage(suffix, DAMAGED[suffix], 0, tmp_path)


def test_a_file_that_is_never_read_to_its_end(tmp_path, monkeypatch):
    """Some damaged files put HDF5's library into an endless loop."""
    from holopath_addon.exchange import containers

    (tmp_path / "hdf5_reader.py").write_text("while True: pass")
    monkeypatch.setattr(containers, "__file__", str(tmp_path / "containers.py"))
    monkeypatch.setattr(containers, "PATIENCE", 0.5)
    exchange.write(tmp_path / "a.h5", exchange.container_of(fields.field()))
    with pytest.raises(InvalidInput, match="a.h5.*does not end"):
        exchange.read(tmp_path / "a.h5")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".h5", ".mat"])
def test_many_damaged_files(suffix, tmp_path, monkeypatch):
    monkeypatch.setattr("holopath_addon.exchange.containers.PATIENCE", 5.0)
    damage(suffix, 500, 1, tmp_path)


def damage(suffix, count, seed, folder):
    """Cut, overwrite and mix up a file so many times; it is read, or refused by one sentence."""
    file, rng, refused = folder / f"a{suffix}", random.Random(seed), 0
    convention = exchange.CONVENTIONS["matlab"] if suffix == ".mat" else None
    exchange.write(file, exchange.container_of(fields.field(), convention))
    whole = file.read_bytes()
    for _ in range(count):
        data, head = bytearray(whole), min(len(whole), 6000)
        way, at, other = rng.randrange(4), rng.randrange(head), rng.randrange(head)
        if way == 0:
            data = data[: rng.randrange(len(data))]
        elif way == 1:
            for _ in range(rng.randrange(1, 20)):
                data[rng.randrange(head)] = rng.randrange(256)
        elif way == 2:
            data[at : at + 8] = rng.choice([b"\xff" * 8, b"\0" * 8, b"\xff" * 7 + b"\x7f"])
        else:
            data[at : at + 64] = data[other : other + 64]
        file.write_bytes(data)
        try:
            exchange.hologram_of(exchange.read(file))
        except InvalidInput as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 500
    assert refused > count / 4
    assert [path.name for path in folder.iterdir()] == [file.name]


def test_a_matlab_array_of_one_wavelength_is_an_array(tmp_path):
    """1 x rows x columns, as other programs have one color; only vectors and numbers are attributes."""
    array = np.random.default_rng(0).random((1, 5, 4))
    scipy.io.savemat(tmp_path / "a.mat", {"phase": array, "wavelengths_m": [[5e-7, 6e-7]], "near_m": 2.0})
    found = exchange.read(tmp_path / "a.mat")
    np.testing.assert_array_equal(found.arrays["phase"], array)
    assert found.attributes.items() >= {"wavelengths_m": [5e-7, 6e-7], "near_m": 2.0}.items()
