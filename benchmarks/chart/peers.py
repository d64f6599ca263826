"""Other people's libraries as propagators: RGB-D layers with the same picture, depths and phases, pixel for pixel.

torchoptics (angular spectrum method) and odak (its band-limited one); both where they are installed.
"""

import importlib.util
import time

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.baselines import BaselineInput, layers, shots
from holopath_addon.engine.waves.phase_fields import FEW_FRAMES
from holopath_addon.engine.waves.propagation import carrier, padded_shape

PEERS = {"rgbd-torchoptics": "torchoptics", "rgbd-odak": "odak"}


def missing(name):
    """Why a peer cannot be run, a sentence; None where it can."""
    library = PEERS[name]
    if importlib.util.find_spec(library) is None:
        return f"{name} is skipped: {library} is not installed."
    return None


def render(name, scene, camera, hologram, settings, plan=None, progress=None):
    """As `engine.render`, with a peer's propagation between layers.

    Parameters
    ----------
    name : str
        One of `PEERS`.
    scene, camera, hologram, settings, plan, progress :
        As of `engine.render`.
    """
    progress = progress or (lambda done, message: None)
    start = time.perf_counter()
    plan = plan or engine.plan(scene, camera, hologram, settings)
    job = BaselineInput(scene, camera, hologram, settings, plan.near, plan.z_low, plan.z_high)
    radiance, z = shots.picture_with_depth(job, lambda done, what: progress(0.3 * done, what))
    depths, number = layers.sliced(job, z)
    steps = [*np.diff(depths), -depths[-1]]
    propagate = {"torchoptics": _torchoptics, "odak": _odak}[PEERS[name]]
    out = np.empty((settings.frames, *radiance.shape), np.complex64)
    for k, wavelength in enumerate(hologram.wavelengths):
        padded = padded_shape(job.shape, hologram.pitch, wavelength, max(map(abs, steps)))
        amplitude = np.sqrt(radiance[k]) * np.float32(layers.gain_for(settings.frames))
        if settings.frames < FEW_FRAMES:  # these libraries' waves have their carrier
            amplitude = amplitude * np.array([carrier(wavelength, z - depths[0]) for z in depths])[number]
        sources = np.stack([amplitude * layers.random_phasor(job, m, k) for m in range(settings.frames)])
        waves = np.where(number == 0, sources, 0)
        for layer, step in enumerate(steps, 1):
            arrived = propagate(waves, hologram.pitch, wavelength, float(step), padded)
            waves = np.where(number == layer, sources, arrived)
            done = (k + layer / len(steps)) / len(hologram.wavelengths)
            progress(0.3 + 0.7 * done, "Layers")
        out[:, k] = waves
    report = {"seconds": {name: time.perf_counter() - start}, "frames": settings.frames}
    return engine.WaveField(out, hologram, camera, plan.near, plan.to_dict(), report)


def _torchoptics(waves, pitch, wavelength, distance, padded):
    import torch
    import torchoptics

    margin = [(n - own + 1) // 2 for n, own in zip(padded, waves.shape[1:], strict=True)]
    field = torchoptics.Field(torch.from_numpy(waves.astype(np.complex64)), wavelength, spacing=pitch)
    return field.propagate_to_z(distance, propagation_method="ASM", asm_pad=margin).data.numpy()


def _odak(waves, pitch, wavelength, distance, padded):
    import torch
    from odak.learn.wave import propagate_beam, wavenumber

    rows, columns = waves.shape[1:]
    top, left = ((n - own + 1) // 2 for n, own in zip(padded, (rows, columns), strict=True))
    out = np.empty_like(waves)
    for m, wave in enumerate(waves):  # odak shifts all axes
        field = torch.from_numpy(np.pad(wave.astype(np.complex64), ((top, top), (left, left))))
        arrived = propagate_beam(
            field,
            wavenumber(wavelength),
            distance,
            pitch,
            wavelength,
            propagation_type="Bandlimited Angular Spectrum",
            zero_padding=[False, False, False],
        )
        out[m] = arrived.numpy()[top : top + rows, left : left + columns]
    return out
