"""Fields made by other libraries, in their own conventions, refocus here as they do there."""

import math

import numpy as np
import pytest

from holopath_addon import cli, engine
from holopath_addon.engine.waves.propagation import propagate

pytestmark = pytest.mark.oracle
N, PITCH, WAVELENGTH = 128, 8e-6, 516.5e-9
AT = N * PITCH**2 / WAVELENGTH  # meters: a Fresnel transform of N points has the same pitch there


def picture():
    """Something that looks different from each side, within the middle of the grid, rows from the top."""
    image = np.zeros((N, N))
    image[40:88, 44:52] = 1
    image[40:48, 44:80] = 0.7
    image[60:66, 44:68] = 0.4
    return image


def phases():
    """Hologram of the picture with a smooth random phase; [y, x], row 0 at the top."""
    rng = np.random.default_rng(2)
    bins = np.hypot(*np.meshgrid(np.fft.fftfreq(N), np.fft.fftfreq(N))) < 0.05
    smooth = np.fft.ifft2(np.fft.fft2(rng.normal(size=(N, N))) * bins).real
    there = np.sqrt(picture()) * np.exp(1j * 3 * smooth / smooth.std())
    return np.angle(propagate(there, PITCH, WAVELENGTH, -AT))


def psnr(image):
    target = picture()
    scale = (image * target).sum() / (image**2).sum()
    return -10 * math.log10(np.mean((scale * image - target) ** 2))


def alike(one, other):
    """Correlation of two pictures."""
    return np.corrcoef(one.ravel(), other.ravel())[0, 1]


def shown(file, folder, *words):
    """Import a file by the command line, and refocus the field at a distance."""
    more = ["--pitch", "8", "--wavelengths", "516.5", "--depth-range", f"{5e2 * AT},{2e3 * AT}", *words]
    assert cli.main(["import", str(file), "--out", str(folder), *more, "--quiet"]) == 0
    phase = [] if (folder / "wavefield").exists() else ["--hologram"]
    assert cli.main(["reconstruct", str(folder), "--distances", f"{1e3 * AT}", *phase, "--quiet"]) == 0
    load = engine.PhaseHologram if phase else engine.WaveField
    thing = load.load(folder / ("hologram" if phase else "wavefield"))
    field = thing.field() if phase else thing
    return engine.reconstruct(field, [float(field.mapping.z_to_depth(AT))])[0, ..., 0]


def test_torchoptics(tmp_path):
    """Its arrays are [x, y], both rising."""
    torch = pytest.importorskip("torch")
    fields = pytest.importorskip("torchoptics")
    light = np.exp(1j * phases())[::-1].T  # in its own convention
    field = fields.Field(torch.tensor(light.copy()), WAVELENGTH, spacing=PITCH)
    theirs = field.propagate_to_z(AT).intensity().numpy().T[::-1]
    file = tmp_path / "u.safetensors"
    __import__("safetensors.torch", fromlist=["torch"]).save_file(
        {"u": field.data.to(torch.complex64).contiguous()}, str(file)
    )
    ours = shown(file, tmp_path / "out", "--convention", "torchoptics")
    assert psnr(ours) == pytest.approx(psnr(theirs), abs=0.05)
    assert psnr(theirs) > 15
    assert alike(ours, theirs) > 0.99 and alike(ours[::-1], theirs) < 0.9 and alike(ours.T, theirs) < 0.9


def test_odak(tmp_path, monkeypatch):
    """Its arrays are [wavelength, y, x], row 0 at the top; not among what the tests install.

    Light that leaves its grid comes back from the other side, so that it is given a wider one. It keeps the corners of
    the square band, which are not within our circle.
    """
    torch = pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)  # it writes a log there when it is imported
    wave = pytest.importorskip("odak.learn.wave")
    light = torch.tensor(np.exp(1j * phases())).to(torch.complex64)
    wide = torch.nn.functional.pad(light, (N // 2,) * 4)
    there = wave.propagate_beam(wide, wave.wavenumber(WAVELENGTH), AT, PITCH, WAVELENGTH, "Angular Spectrum")
    theirs = (there.abs() ** 2).numpy().reshape(2 * N, 2 * N)[N // 2 : -N // 2, N // 2 : -N // 2]
    file = tmp_path / "u.safetensors"
    __import__("safetensors.torch", fromlist=["torch"]).save_file({"u": light[None].contiguous()}, str(file))
    ours = shown(file, tmp_path / "out", "--convention", "odak")
    assert psnr(ours) == pytest.approx(psnr(theirs), abs=0.05)
    assert psnr(theirs) > 15 and alike(ours, theirs) > 0.96 and alike(ours[::-1], theirs) < 0.9


def test_slmsuite(tmp_path):
    """Its phases, and its propagation: a lens as kernel, and a Fourier transform."""
    algorithms = pytest.importorskip("slmsuite.holography.algorithms")
    toolbox = pytest.importorskip("slmsuite.holography.toolbox")
    hologram = algorithms.Hologram(np.ones((N, N)), phase=phases(), slm_shape=(N, N))
    grid = np.meshgrid(*(2 * [(np.arange(N) - N / 2) * PITCH / WAVELENGTH]))
    kernel = toolbox.phase.lens(grid, f=AT / WAVELENGTH)
    theirs = np.abs(hologram.get_farfield(propagation_kernel=kernel)) ** 2
    np.savez(tmp_path / "u.npz", phase=hologram.phase)
    ours = shown(tmp_path / "u.npz", tmp_path / "out", "--convention", "slmsuite")
    assert psnr(ours) == pytest.approx(psnr(theirs), abs=0.05)
    assert psnr(theirs) > 15 and alike(ours, theirs) > 0.99
