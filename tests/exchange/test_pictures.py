"""Pictures are read number by number, and colors as what they are said to be."""

import struct

import numpy as np
import pytest

from holopath_addon import engine, exchange, slm
from holopath_addon.engine import BackendUnavailable, InvalidInput
from holopath_addon.exchange import holograms
from tests.exchange import foreign

WAVELENGTHS = [640e-9, 516.5e-9, 455.4e-9]
rng = np.random.default_rng(4)
GRAY = rng.permutation(256).reshape(16, 16).astype(np.uint8)
COLOR = rng.integers(0, 256, (16, 16, 3), np.uint8)
BINARY = rng.integers(0, 2, (24, 16, 16)).astype(np.uint8)
TURN = 2 * np.pi


def phases(path, count=1, **given):
    """Phases in levels of a turn of 256."""
    given = exchange.ReadOptions(pitch=8e-6, wavelengths=WAVELENGTHS[:count], **given)
    return exchange.hologram_of(exchange.read(path), given).data * (256 / TURN)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif"])
def test_colors(suffix, tmp_path):
    if suffix == ".tif":
        pytest.importorskip("tifffile")
    path = tmp_path / f"a{suffix}"
    foreign.save(path, COLOR)
    channels = np.moveaxis(COLOR, -1, 0)
    np.testing.assert_allclose(phases(path, 3)[0], channels, atol=1e-4)
    np.testing.assert_allclose(phases(path, 3, packing="color")[0], channels, atol=1e-4)
    np.testing.assert_allclose(phases(path, packing="color")[:, 0], channels, atol=1e-4)
    frames = exchange.ReadOptions(
        convention=exchange.Convention(("y", "x", "frame")), pitch=8e-6, wavelengths=[5e-7]
    )
    np.testing.assert_allclose(
        exchange.hologram_of(exchange.read(path), frames).data[:, 0] * (256 / TURN), channels, atol=1e-4
    )
    np.testing.assert_allclose(phases(path, array="green")[0, 0], COLOR[..., 1], atol=1e-4)
    with pytest.raises(
        InvalidInput, match="The picture has three channels for 1 wavelength. Give three --wavelengths"
    ):
        phases(path)
    with pytest.raises(InvalidInput, match="from the longest to the shortest"):
        exchange.hologram_of(
            exchange.read(path), exchange.ReadOptions(pitch=8e-6, wavelengths=WAVELENGTHS[::-1])
        )
    with pytest.raises(InvalidInput, match="3 holograms are not a multiple of 2 wavelengths. Give other"):
        phases(path, 2, packing="color")
    foreign.save(path, np.repeat(GRAY[..., None], 3, -1))
    np.testing.assert_allclose(phases(path)[0, 0], GRAY, atol=1e-4)


@pytest.mark.parametrize("count", [1, 3])
def test_what_our_own_pictures_pack_comes_back(count, tmp_path):
    """24 holograms in the bits, as `holopath stream --packing bits` sends them."""
    foreign.png(tmp_path / "a.png", slm.packing.pack(list(BINARY), "bits"), 8)
    found = phases(tmp_path / "a.png", count, packing="bits")
    assert found.shape == (24 // count, count, 16, 16)
    np.testing.assert_allclose(found.reshape(24, 16, 16), 128 * BINARY)


@pytest.mark.parametrize(
    ("packing", "bits", "each"), [("slm-200", 10, 1), ("slm-200-120hz", 10, 2), ("G7-0,R7-4", 12, 1)]
)
def test_levels_in_the_bits_of_channels_come_back(packing, bits, each, tmp_path):
    path, levels = tmp_path / "a.png", rng.integers(0, 2**bits, (each, 16, 16)).astype(np.uint16)
    foreign.png(path, slm.packing.pack(list(levels), packing), 8)
    found = phases(path, packing=packing)
    assert found.shape == (each, 1, 16, 16)
    np.testing.assert_allclose(found[:, 0], levels * (256 / 2**bits), atol=1e-4)
    assert np.array_equal(phases(path, packing=packing, bits=bits), found)
    with pytest.raises(InvalidInput, match=f"levels of {bits} bits, not 8. Omit --bits"):
        phases(path, packing=packing, bits=8)
    with pytest.raises(InvalidInput, match="levels, not turns"):
        phases(path, packing=packing, units="turns")


def test_bits_that_a_packing_does_not_name_are_refused(tmp_path):
    foreign.png(tmp_path / "a.png", COLOR, 8)
    with pytest.raises(InvalidInput, match="bits besides those of the packing slm-200"):
        phases(tmp_path / "a.png", packing="slm-200")
    with pytest.raises(InvalidInput, match="no packing magic: choose one of color, bits, slm-200"):
        phases(tmp_path / "a.png", packing="magic")
    foreign.png(tmp_path / "a.png", COLOR.astype(np.uint16) << 8, 16)
    with pytest.raises(InvalidInput, match="bits of 8-bit channels, not of uint16"):
        phases(tmp_path / "a.png", packing="slm-200")


def test_packings_are_those_that_are_streamed():
    ours = {name: packing.each for name, packing in slm.PACKINGS.items() if not packing.memory}
    ours |= {"bits": slm.PACKINGS["bits"].each}
    del ours["time"]
    assert ours == holograms.PACKINGS


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
def test_bits_of_a_png(depth, tmp_path):
    levels = (np.arange(65536).reshape(16, -1)[:, ::16] >> (16 - depth)).astype("u2" if depth > 8 else "u1")
    foreign.png(tmp_path / "a.png", levels, depth)
    np.testing.assert_allclose(phases(tmp_path / "a.png")[0, 0], levels * (256 / 2**depth), atol=1e-4)
    if depth < 8:
        with pytest.raises(InvalidInput, match=f"have {depth} bits, not 8. Omit --bits"):
            phases(tmp_path / "a.png", bits=8)


def test_alpha_is_opaque_or_refused(tmp_path):
    opaque = np.dstack([GRAY, np.full_like(GRAY, 255)])
    foreign.png(tmp_path / "a.png", opaque, 8)
    np.testing.assert_allclose(phases(tmp_path / "a.png")[0, 0], GRAY, atol=1e-4)
    opaque[3, 3, 1] = 254
    foreign.png(tmp_path / "a.png", opaque, 8)
    with pytest.raises(InvalidInput, match="has an alpha channel that is not opaque, but pixels of"):
        phases(tmp_path / "a.png")


def test_palettes_of_colors_are_refused(tmp_path):
    palette = np.repeat(np.arange(255, -1, -1, dtype=np.uint8), 4).reshape(256, 4)
    foreign.bmp(tmp_path / "a.bmp", GRAY, palette)
    with pytest.raises(InvalidInput, match="has a palette of colors. Write it as a gray or"):
        phases(tmp_path / "a.bmp")


def test_layers_of_an_exr_are_arrays(tmp_path):
    amplitude, phase = rng.random((16, 9)), rng.random((16, 9)) * TURN
    foreign.exr(tmp_path / "a.exr", {"light.amplitude": amplitude, "light.phase": phase})
    given = exchange.ReadOptions(pitch=8e-6, wavelengths=[5e-7])
    found = exchange.hologram_of(exchange.read(tmp_path / "a.exr"), given)
    assert isinstance(found, engine.WaveField)
    np.testing.assert_allclose(found.data[0, 0], amplitude * np.exp(1j * phase), atol=1e-6)
    foreign.exr(
        tmp_path / "a.exr", {"amplitude": np.dstack([amplitude] * 3), "phase": phase}
    )  # one is gray in RGB
    again = exchange.hologram_of(exchange.read(tmp_path / "a.exr"), given)
    assert np.array_equal(again.data, found.data)
    foreign.exr(tmp_path / "a.exr", {"": rng.random((16, 9))})
    with pytest.raises(InvalidInput, match="--units turns"):
        exchange.hologram_of(exchange.read(tmp_path / "a.exr"), given)


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        (
            "chromaticities",
            struct.pack("<8f", 0.71, 0.29, 0.17, 0.8, 0.13, 0.05, 0.32, 0.34),
            "has other primaries than Rec. 709, which mix its channels. Omit",
        ),
        (
            "displayWindow",
            struct.pack("<4i", 0, 0, 20, 20),
            "holds only a part of its picture. Write it without a",
        ),
        ("flags", struct.pack("<I", 0x1002), "several parts, or deep pixels"),
    ],
)
def test_what_of_an_exr_would_be_mixed_or_left_out(name, value, says, tmp_path):
    """The file's header is changed byte by byte; what it holds is as it was."""
    path = tmp_path / "a.exr"
    foreign.exr(path, {"": rng.random((9, 7, 3)) * TURN})
    data = path.read_bytes()
    if name == "flags":
        data = data[:4] + value + data[8:]
    elif name == "displayWindow":
        at = data.index(b"displayWindow\0box2i\0") + len("displayWindow.box2i.") + 4
        data = data[:at] + value + data[at + 16 :]
    else:  # before the table of one offset, which moves
        kind = name.encode() + b"\0chromaticities\0" + struct.pack("<I", len(value)) + value
        end = data.index(b"screenWindowWidth\0float\0") + len("screenWindowWidth.float.") + 8
        assert data[end] == 0
        (offset,) = struct.unpack_from("<Q", data, end + 1)
        data = data[:end] + kind + b"\0" + struct.pack("<Q", offset + len(kind)) + data[end + 9 :]
    path.write_bytes(data)
    with pytest.raises(InvalidInput, match=says):
        exchange.read(path)


@pytest.mark.parametrize(
    ("array", "words", "says"),
    [
        (
            GRAY,
            {"photometric": "miniswhite"},
            "stores its numbers as MINISWHITE. Write it as gray with black",
        ),
        (np.stack([GRAY, GRAY]), {"photometric": "minisblack"}, "The array of 2 x 16 x 16 has 2 on"),
        (np.dstack([COLOR, GRAY]), {"photometric": "rgb", "extrasamples": ["unassalpha"]}, "not opaque"),
    ],
)
def test_what_of_a_tiff_is_refused(array, words, says, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(tmp_path / "a.tif", array, **words)
    with pytest.raises(InvalidInput, match=says):
        phases(tmp_path / "a.tif")


@pytest.mark.parametrize("dtype", ["u1", "u2", "f2", "f4", "f8", "c8", "?"])
def test_numbers_of_a_tiff(dtype, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    array = (rng.random((8, 9)) * 3).astype(dtype)
    tifffile.imwrite(tmp_path / "a.tiff", array, compression="zlib", photometric="minisblack")
    found = exchange.read(tmp_path / "a.tiff").arrays["picture"]
    assert found.dtype == array.dtype and np.array_equal(found, array)


def test_the_library_for_tiff_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "tifffile", None)
    (tmp_path / "a.tif").touch()
    with pytest.raises(BackendUnavailable, match="Such files need tifffile. Run"):
        exchange.read(tmp_path / "a.tif")
