"""Gaussian wave splatting by its authors' own code, hsplat, beside the baseline `gaussian`: the same Gaussians.

``python -m benchmarks hsplat FOLDER [PIXELS [FRAMES]]``, the folder ``hsplat`` of a clone of that program, which is
for non-commercial use and no part of this one. It is run on the CPU as it is, but for phases at random, see
`_imported`. What it imports and these Gaussians do not need (PyTorch3D, its CUDA kernels) is left empty.

Its Gaussians lie on z towards the viewer, ours on z away from it. So ours are mirrored in z, and the wave that comes
out is conjugated: the propagation over -z of the conjugate is the conjugate of that over z.
"""

import sys
import time
from importlib import import_module
from types import ModuleType, SimpleNamespace

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.baselines import BaselineInput, gaussians, layers, shots
from holopath_addon.engine.waves.phase_fields import FEW_FRAMES

from .chart import looks
from .chart.figures import figures
from .chart.scenes import SCENES, built
from .parts import joined

GREEN = 516.5e-9
ANY = 2 * np.pi  # standard deviation of a phase, radians, from which on it is as good as evenly spread
PAD = 2  # as its own scripts do
EMPTY = {
    "pytorch3d": (),
    "pytorch3d.transforms": ("matrix_to_quaternion", "quaternion_multiply", "quaternion_to_matrix"),
    "cuda": (),
    "cuda._wrapper": ("cgh_gaussians_naive",),
}


def run(folder, pixels="96", frames="8", *names):
    """PSNR and seconds of both, one color.

    Parameters
    ----------
    folder : str
    pixels, frames : str
        Of the hologram, a side; of fields with random phases.
    *names : str
        Of the chart's scenes; default: planes and suzanne.

    Returns
    -------
    str
        A table.
    """
    algorithms = _imported(folder)
    size, count = int(pixels), int(frames)
    lines = [
        "| scene | Gaussians | | frames | whole pupil | halves | seconds |",
        "|---|---|---|---|---|---|---|",
    ]
    nearer = min(1.0, size / 96)

    def rows(name):
        found = []
        hologram = engine.Hologram(size, size, 8e-6, (GREEN,), 1e-3 * nearer, 3e-3 * nearer)
        scene, camera = built(name, size)
        foci = SCENES[name].foci
        truth = looks.truth_of(scene, camera, hologram, foci, 256)
        settings = engine.Settings(method="gaussian", frames=count)
        plan = engine.plan(scene, camera, hologram, settings)
        job = BaselineInput(scene, camera, hologram, settings, plan.near, plan.z_low, plan.z_high)
        radiance, z = shots.picture_with_depth(job, lambda *_: None)
        disks = gaussians.Gaussians.of(radiance, z, 0.25 * hologram.depth_of_focus)
        depths, _ = layers.sliced(job, z)

        def ours(job=job, disks=disks, depths=depths):
            return gaussians.blended(job, disks, depths, lambda *_: None)

        def theirs(random, count, hologram=hologram, disks=disks):
            return np.stack([_splatted(algorithms, hologram, disks, random) for _ in range(count)])

        for what, frames_of, made in (
            ("hsplat, in phase", 1, lambda theirs=theirs: theirs(0.0, 1)),
            ("hsplat, random phases", count, lambda theirs=theirs: theirs(ANY, count)),
            ("`gaussian`, random phases", count, ours),
        ):
            start = time.perf_counter()
            waves = made()
            seconds = time.perf_counter() - start
            field = engine.WaveField(
                waves, hologram, camera, plan.near, plan.to_dict(), {"frames": frames_of}
            )
            each = figures(looks.seen(field, foci, truth["others"]), truth, hologram)["pictures"]
            whole, halves = (
                np.mean([each[look]["psnr"] for look in group])
                for group in (looks.HEADLINE[:5], tuple(looks.HALVES))
            )
            found.append(
                f"| {name} | {len(disks.z)} | {what} | {frames_of} | {whole:.1f} dB | {halves:.1f} dB | {seconds:.0f} |"
            )
            print(found[-1], file=sys.stderr, flush=True)
        return "\n".join(found)

    tables = {name: lambda name=name: rows(name) for name in names or ("planes", "suzanne")}
    return joined({"head": lambda: "\n".join(lines)} | tables)


def _imported(folder):
    """Its module of algorithms."""
    for name, functions in EMPTY.items():
        module = sys.modules[name] = ModuleType(name)
        module.__path__ = []
        for function in functions:
            setattr(module, function, None)
    sys.path.insert(0, folder)
    import torch

    # its phases at random are complex, as its waves are, and make them larger and smaller without end
    vars(torch)["randn_like"] = lambda wave: torch.randn(wave.shape, device=wave.device)
    vars(import_module("tqdm"))["tqdm"] = lambda each: each  # no bar a Gaussian
    return import_module("algorithms")


def _splatted(algorithms, hologram, disks, random):
    """The wave at the SLM by hsplat's alpha wave blending, shape (wavelength, y, x)."""
    import torch

    def tensor(values):
        return torch.tensor(np.asarray(values), dtype=torch.float32)

    pitch, sigma = hologram.pitch, gaussians.SIGMA * disks.side * hologram.pitch
    center = hologram.width // 2  # of its FFTs
    means = np.stack([(disks.column - center) * pitch, (disks.row - center) * pitch, -disks.z], 1)
    normal = np.stack([disks.right, disks.down, np.full(len(disks.z), pitch)], 1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # its turns: about x by atan2(-n_y, n_z), then about y by -asin(n_x), see its `coordinate_rotation_matrix`
    x, y = np.arctan2(-normal[:, 1], normal[:, 2]) / 2, -np.arcsin(normal[:, 0]) / 2
    turns = np.stack(
        [np.cos(x) * np.cos(y), np.sin(x) * np.cos(y), np.cos(x) * np.sin(y), np.sin(x) * np.sin(y)], 1
    )
    # as wide on the surface as it takes to look as wide as they are
    scales = np.stack([sigma / np.cos(2 * y), sigma / np.cos(2 * x), sigma], 1)
    amplitude = np.sqrt(disks.radiance)
    out = []
    for k, wavelength in enumerate(hologram.wavelengths):
        cfg = SimpleNamespace(
            dev=torch.device("cpu"),
            wavelength=wavelength,
            pixel_pitch=pitch,
            resolution_hologram=(PAD * hologram.height, PAD * hologram.width),
            pad_n=1,
            phase_matching=True,
            return_at_object_depth=True,
            order_front2back=True,
            alpha_wave_blending=True,
            threshold_epsilon=0.0,  # what it cuts off in the plane of the SLM is light of the small ones
            threshold_binary_gaussian=-1.0,
            random_sigma_gaussian=random,
            F_aperture=1.0,
        )
        primitives = import_module("primitives").Gaussians(
            tensor(means),
            tensor(np.ones(len(means))),
            tensor(turns),
            tensor(scales),
            colors=tensor(amplitude[:, k]),
        )
        with torch.no_grad():
            wave = algorithms.alpha_wave_blending(primitives, cfg)[0, 0].numpy()
        rows, columns = hologram.height, hologram.width
        top, left = (PAD - 1) * rows // 2, (PAD - 1) * columns // 2
        gain = layers.gain_for(FEW_FRAMES)  # of random phases
        out.append(gain * np.conj(wave[top : top + rows, left : left + columns]).astype(np.complex64))
    return np.stack(out)
