"""Files as other people write them: what is in them, what the writer means, and what the writer says of it.

`meant` draws one. Numbers and files are made here by formulas and formats of their own: PNG and BMP byte by byte. What
is meant is computed from the numbers that are stored, so that rounding to a type is the writer's own.
"""

import math
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
import safetensors.numpy
import scipy.io
from hypothesis import assume
from hypothesis import strategies as st

from holopath_addon import exchange
from holopath_addon.engine.scene import variants

try:
    import tifffile
except ImportError:
    tifffile = None

AXES = ("frame", "wavelength", "y", "x")
TURN = 2 * math.pi
WAVELENGTHS = {1: [516.5e-9], 2: [640e-9, 455.4e-9], 3: [640e-9, 516.5e-9, 455.4e-9]}
NAMES = {
    "phase": ["phase", "phi", "holo/phase", "SLMPhase", "u", "data"],
    "amplitude": ["amplitude", "amp", "fieldAmplitude", "A", "abs", "v"],
    "intensity": ["intensity", "out_intensity", "I"],
    "real": ["real", "re", "u_re", "a"],
    "imaginary": ["imag", "im", "u_im", "b"],
    "complex": ["u", "field", "E", "slm_field"],
}


@dataclass
class Meant:
    """A file, or two, and the field or phases that the writer means by it."""

    files: dict  # path by role; by None where it is one file
    truth: np.ndarray = field(repr=False)  # radians or complex numbers, shape (frame, wavelength, y, x)
    given: dict = field(default_factory=dict)  # of `exchange.ReadOptions`: what the writer says
    story: str = field(default="", repr=False)

    def read(self):
        """Read the file by HoloPath."""
        given = exchange.ReadOptions(**{"pitch": 8e-6, **self.given})
        if None in self.files:
            container = exchange.read(self.files[None])
        else:
            container = exchange.read_parts(self.files)
        return exchange.hologram_of(container, given)


def phases(draw, rng, shape, kinds):
    """Numbers that stand for phases, what they are in radians, and what may be said of them."""
    kind = draw(st.sampled_from(kinds))
    if kind == "levels":
        return levels(draw, rng, shape)
    # Ends of the range: one turn, a smaller range, or some turns of an unwrapped phase.
    turns = draw(st.sampled_from([1, 1, 1, 0.15, 0.5, 3, 6, 20]))
    start = draw(st.sampled_from([0, -turns / 2]))
    dtype = draw(st.sampled_from([np.float32, np.float64, np.float16]))
    unit = {"radians": 1.0, "turns": TURN, "pi": math.pi, "degrees": math.pi / 180}[kind]
    drawn = rng.random(shape)
    if draw(st.booleans()):  # a picture of few values
        drawn = np.floor(drawn * 4) / 4
    stored = ((start + turns * drawn) * TURN / unit).astype(dtype)
    if kind == "degrees" and draw(st.booleans()):
        stored = np.round(stored).astype(draw(st.sampled_from([np.float32, np.int64, np.int16])))
    return stored, stored.astype(np.float64) * unit, {"units": kind}


def levels(draw, rng, shape, types=(np.uint8, np.uint16, np.int32, np.int64, np.float32, bool)):
    """Levels in a type of more bits: as they are, at its top, or stretched."""
    dtype = np.dtype(draw(st.sampled_from(types)))
    max_count = 8 * dtype.itemsize if dtype.kind == "u" else 1 if dtype.kind == "b" else 12
    bits = draw(st.sampled_from([n for n in (1, 2, 4, 5, 8, 10, 12, 16) if n <= max_count]))
    reach = 2**bits if draw(st.booleans()) else max(1, 2**bits // 3)
    values = rng.integers(0, reach, shape)
    truth, described = values * (TURN / 2**bits), {"bits": bits}
    where = draw(st.sampled_from(["low", "top", "stretched"])) if dtype.kind == "u" else "low"
    if where == "top":
        values = values << (max_count - bits)
    elif where == "stretched":
        values = np.round(values * ((2**max_count - 1) / (2**bits - 1)))
    return values.astype(dtype), truth, described


def parts(draw, rng, shape, layout):
    """Arrays by their roles, what they mean, and what may be said of them."""
    if layout == "phase":
        stored, truth, described = phases(draw, rng, shape, ["radians", "turns", "pi", "degrees", "levels"])
        return {"phase": stored}, truth, described
    if layout in ("complex", "real"):
        dtype = draw(st.sampled_from([np.complex64, np.complex128]))
        field = (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(dtype)
        if layout == "complex":
            return {"complex": field}, field, {}
        return {"real": field.real.copy(), "imaginary": field.imag.copy()}, field, {}
    stored, angle, described = phases(draw, rng, shape, ["radians", "turns", "levels"])
    size, value = rng.random(shape).astype(draw(st.sampled_from([np.float32, np.float64]))), None
    if draw(st.booleans()):
        size = rng.integers(0, 256, shape, np.uint8)
        described["transfer"] = draw(st.sampled_from(["linear", "srgb"]))
        value = np.vectorize(decoded if described["transfer"] == "srgb" else float)(size / 255)
    value = size.astype(np.float64) if value is None else value
    value = np.sqrt(value) if layout == "intensity" else value
    return {layout: size, "phase": stored}, value * np.exp(1j * angle), described


def decoded(value):
    """Light of an encoded value, IEC 61966-2-1."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def in_order(draw, arrays, truth, described):
    """Arrays in another order of axes and rows, and with another sign of time; always said, for the default is ours."""
    m, k = truth.shape[:2]
    axes = [
        name
        for name in AXES
        if name not in ("frame", "wavelength") or {"frame": m, "wavelength": k}[name] > 1
    ]
    convention = {}
    if draw(st.booleans()):
        axes = draw(st.permutations(axes))
        convention["axes"] = tuple(axes)
    if draw(st.integers(0, 3)) == 0:
        convention["time"], truth = "+", np.conj(truth) if np.iscomplexobj(truth) else -truth
    if draw(st.integers(0, 3)) == 0:
        convention["rows"], truth = "bottom", truth[..., ::-1, :]
    if not convention and m > 1 and k == 1:
        convention["axes"] = tuple(axes)  # or be refused, which is another test's
    if convention:
        described["convention"] = exchange.Convention(**convention)
    missing = tuple(AXES.index(name) for name in AXES if name not in axes)
    kept = [name for name in AXES if name in axes]
    laid = {r: a.squeeze(missing).transpose([kept.index(n) for n in axes]) for r, a in arrays.items()}
    return laid, truth


def write_arrays(path, arrays, attributes):
    """A file of arrays, by its suffix."""
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    if path.suffix == ".npy":
        np.save(path, next(iter(arrays.values())))
    elif path.suffix == ".npz":
        np.savez(path, **arrays, **attributes)
    elif path.suffix == ".mat":
        scipy.io.savemat(path, {**{n.replace("/", "_"): a for n, a in arrays.items()}, **attributes})
    elif path.suffix == ".safetensors":
        safetensors.numpy.save_file(arrays, path, {name: str(value) for name, value in attributes.items()})
    else:
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                file[name] = array
            file.attrs.update(attributes)
            file["z"] = np.arange(3.0)
            file["z"].attrs["units"] = "m"


def png(path, pixels, depth):
    """PNG of 1 to 16 bits, of 1 to 4 channels, by its specification."""
    pixels = pixels if pixels.ndim == 3 else pixels[..., None]
    height, width, channels = pixels.shape
    lines = b""
    for row in pixels.reshape(height, -1):
        if depth < 8:
            text = "".join(format(int(value), f"0{depth}b") for value in row)
            text += "0" * (-len(text) % 8)
            lines += b"\0" + int(text, 2).to_bytes(len(text) // 8, "big")
        else:
            lines += b"\0" + row.astype(">u2" if depth == 16 else "u1").tobytes()
    head = struct.pack(">IIBBBBB", width, height, depth, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(lines)), (b"IEND", b"")]
    packed = [struct.pack(">I", len(d)) + t + d + struct.pack(">I", zlib.crc32(t + d)) for t, d in chunks]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(packed))


def bmp(path, pixels, palette=None):
    """BMP of 8 or 24 bits, rows from the bottom."""
    palette = np.repeat(np.arange(256, dtype=np.uint8), 4).reshape(256, 4) if palette is None else palette
    colors = palette.tobytes() if pixels.ndim == 2 else b""
    bits, at = (8, 54 + len(colors)) if pixels.ndim == 2 else (24, 54)
    rows = pixels if pixels.ndim == 2 else pixels[..., ::-1].reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 4)))[::-1].tobytes()
    head = b"BM" + struct.pack("<IHHI", at + len(rows), 0, 0, at)
    head += struct.pack(
        "<IiiHHIIiiII", 40, pixels.shape[1], pixels.shape[0], 1, bits, 0, len(rows), 0, 0, 0, 0
    )
    path.write_bytes(head + colors + rows)


def exr(path, layers):
    """EXR of float32, a layer's channels for each name; without one, Y or R, G and B."""
    mi = variants.bitmaps()
    names, planes = [], []
    for name, array in layers.items():
        kinds = "RGB" if array.ndim == 3 else "Y"
        names += [f"{name}.{c}" if name else c for c in kinds]
        planes += [array[..., n] if array.ndim == 3 else array for n in range(len(kinds))]
    pixels = np.stack(planes, -1).astype(np.float32)
    mi.Bitmap(pixels, mi.Bitmap.PixelFormat.MultiChannel, names).write(str(path))


@st.composite
def meant(draw, folder: Path, processes: bool = True):
    """A file, or two, that a writer means something by; `processes` for kinds that take one to be read."""
    if draw(st.integers(0, 2)) == 0:
        return draw(picture(folder))
    rng = np.random.default_rng(draw(st.integers(0, 999)))
    k, m = draw(st.sampled_from([1, 1, 2, 3])), draw(st.sampled_from([1, 1, 2]))
    shape = (m, k, *draw(st.sampled_from([(7, 12), (4, 40), (16, 9)])))
    layout = draw(st.sampled_from(["complex", "phase", "amplitude", "intensity", "real", "stacked"]))
    stacked = layout == "stacked"
    layout = draw(st.sampled_from(["amplitude", "real"])) if stacked else layout
    arrays, truth, described = parts(draw, rng, shape, layout)
    arrays, truth = in_order(draw, arrays, truth, described)
    described = {
        name: value for name, value in described.items() if name == "convention" or draw(st.booleans())
    }
    described["wavelengths"] = WAVELENGTHS[k]
    kinds = [".npz", ".mat", ".safetensors", *([".h5"] if processes else [])]
    attributes = {}
    if "units" in described and draw(st.booleans()):
        attributes["units"] = described.pop("units")
    story = f"{layout} {shape} {described} {attributes}"
    if stacked:  # two numbers of a pixel in one real array, which nothing tells
        described.pop("units", None), described.pop("bits", None), described.pop("transfer", None)
        whole = np.stack([a.astype(np.float64) for a in arrays.values()], draw(st.sampled_from([0, -1])))
        write_arrays(folder / "a.npy", {"u": whole}, {})
        return Meant({None: folder / "a.npy"}, truth, described, f"stacked {story}")
    if len(arrays) == 1 and not attributes and draw(st.booleans()):
        kinds = [".npy"]
    if len(arrays) == 2 and draw(st.integers(0, 2)) == 0:
        files = {}
        for role, array in arrays.items():
            kind = draw(st.sampled_from([".npy", ".npz", ".mat"]))
            name = draw(st.sampled_from(NAMES[role]))
            own = attributes if role == "phase" and kind != ".npy" else {}
            described |= attributes if role == "phase" and kind == ".npy" else {}
            files[role] = folder / f"{role}{kind}"
            write_arrays(files[role], {name: array}, own)
        return Meant(files, truth, described, f"two files {story}")
    file = folder / f"a{draw(st.sampled_from(kinds))}"
    if file.suffix == ".safetensors":  # knows no complex numbers of double precision
        arrays = {r: a.astype(np.complex64) if a.dtype == np.complex128 else a for r, a in arrays.items()}
    names = {role: draw(st.sampled_from(NAMES[role])) for role in arrays}
    held = {names[role]: array for role, array in arrays.items()}
    if len(held) == 2 and draw(st.integers(0, 3)) == 0:
        clean = {
            role: name.replace("/", "_") if file.suffix == ".mat" else name for role, name in names.items()
        }
        described["array"] = clean
    if draw(st.integers(0, 4)) == 0:
        held["mask"] = np.ones(shape[-2:])
    write_arrays(file, held, attributes)
    return Meant({None: file}, truth, described, f"{file.suffix} {names} {story}")


# packings that spread levels over channels: channel, lowest bit there, and how many bits, from the highest on
SPREAD = [
    ("slm-200", [(0, 5, 3), (1, 5, 3), (2, 4, 4)]),
    ("R7-0,G7-4", [(0, 0, 8), (1, 4, 4)]),
    ("B1-0,R3-0", [(2, 0, 2), (0, 0, 4)]),
]


@st.composite
def picture(draw, folder):
    """A picture of phases, or one of phases and one of amplitudes."""
    rng = np.random.default_rng(draw(st.integers(0, 999)))
    size = draw(st.sampled_from([(7, 12), (16, 9)]))
    kind = draw(st.sampled_from([".png", ".bmp", ".exr", *([".tif"] if tifffile else [])]))
    means = draw(
        st.sampled_from(
            ["gray", "gray as color", "wavelengths", "frames", "bits", "spread", "green", "field"]
        )
    )
    if means == "spread" and kind != ".exr":
        packing, runs = draw(st.sampled_from(SPREAD))
        bits = sum(count for _, _, count in runs)
        whole = rng.integers(0, 2**bits, size)
        left, pixels = whole, np.zeros((*size, 3), np.uint8)
        for channel, lowest, count in reversed(runs):
            pixels[..., channel] += (left % 2**count << lowest).astype(np.uint8)
            left = left // 2**count
        save(folder / f"a{kind}", pixels)
        described = {"wavelengths": WAVELENGTHS[1]} | ({"packing": packing} if draw(st.booleans()) else {})
        truth = whole[None, None] * (TURN / 2**bits)
        return Meant({None: folder / f"a{kind}"}, truth, described, f"spread {kind} {packing}")
    if means == "bits" and kind in (".png", ".bmp", ".tif"):
        k = draw(st.sampled_from([1, 3]))
        frames = rng.integers(0, 2, (24, *size))
        bytes_ = np.stack([sum(frames[8 * c + b] << b for b in range(8)) for c in range(3)], -1).astype(
            np.uint8
        )
        save(folder / f"a{kind}", bytes_)
        described = {"wavelengths": WAVELENGTHS[k]}
        if k == 3 or draw(st.booleans()):  # three wavelengths are the default of three channels
            described["packing"] = "bits"
        return Meant(
            {None: folder / f"a{kind}"},
            frames.reshape(24 // k, k, *size) * math.pi,
            described,
            f"bits {kind} {k}",
        )
    channels = 1 if means in ("gray", "bits", "spread", "field") else 3
    if kind == ".exr":
        stored, truth, described = phases(
            draw, rng, (1, channels, *size), ["radians", "turns", "pi", "degrees"]
        )
        stored = stored.astype(np.float32)
        factor = {"radians": 1.0, "turns": TURN, "pi": math.pi, "degrees": math.pi / 180}[described["units"]]
        truth = stored.astype(np.float64) * factor
    elif kind == ".tif":
        stored, truth, described = levels(draw, rng, (1, channels, *size), (np.uint8, np.uint16, np.float32))
    else:
        types = (np.uint8, np.uint16) if kind == ".png" else (np.uint8,)
        stored, truth, described = levels(draw, rng, (1, channels, *size), types)
    k, described = 1, {name: value for name, value in described.items() if draw(st.booleans())}
    pixels = np.moveaxis(stored[0], 0, -1)
    if means == "gray as color":
        pixels, truth = np.repeat(pixels[..., :1], 3, -1), truth[:, :1]
    elif means == "green":
        pixels, truth = pixels * np.array([0, 1, 0], pixels.dtype), truth[:, 1:2]
        described |= {"array": "green"} if draw(st.booleans()) else {}
    elif means == "wavelengths":
        k = 3
    if means in ("wavelengths", "frames"):
        assume((pixels != pixels[..., :1]).any())  # three alike are one
    if means == "frames":
        truth = truth.transpose(1, 0, 2, 3)
        described |= {"packing": "color"} if draw(st.booleans()) else {}
    described["wavelengths"] = WAVELENGTHS[k]
    pixels = pixels[..., 0] if pixels.shape[-1] == 1 else pixels
    path = folder / f"a{kind}"
    if means == "field":
        size_of = rng.integers(0, 256, size, np.uint8)
        save(folder / "b.png", size_of)
        transfer = draw(st.sampled_from(["linear", "srgb"]))
        value = np.vectorize(decoded if transfer == "srgb" else float)(size_of / 255)
        described |= {"transfer": transfer} if draw(st.booleans()) else {}
        save(path, pixels)
        return Meant(
            {"amplitude": folder / "b.png", "phase": path},
            value * np.exp(1j * truth),
            described,
            f"field {kind} {described}",
        )
    save(path, pixels)
    return Meant({None: path}, truth, described, f"{means} {kind} {pixels.dtype} {described}")


def save(path, pixels):
    """A picture, by its suffix."""
    if path.suffix == ".png":
        png(path, pixels, 8 * pixels.dtype.itemsize)
    elif path.suffix == ".bmp":
        bmp(path, pixels)
    elif path.suffix == ".exr":
        exr(path, {"": pixels})
    else:
        tifffile.imwrite(path, pixels, photometric="rgb" if pixels.ndim == 3 else "minisblack")
