"""Fields to encode, and what their phases are held to."""

import math

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.waves.propagation import transfer_function

GREEN, PITCH = 516.5e-9, 8e-6


def band_limited(shape, frames=1, colors=1, seed=0, radius=0.5):
    """Random complex fields, smooth where the radius (cycles a pixel) is small."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(frames, colors, *shape)) + 1j * rng.normal(size=(frames, colors, *shape))
    fy, fx = (np.fft.fftfreq(n) for n in shape)
    data = np.fft.ifft2(np.fft.fft2(noise) * (np.hypot(fx[None, :], fy[:, None]) <= radius))
    return data / np.abs(data).mean()


def wave_field(data, **hologram):
    colors = (GREEN, 640e-9, 455e-9)[: data.shape[1]]
    size = data.shape[-1], data.shape[-2]
    display = engine.Hologram(*size, PITCH, colors, **{"depth_far": 1e-3, "depth_near": 2e-3, **hologram})
    return engine.WaveField(data.astype(np.complex64), display, engine.Camera(np.eye(4), 0.6), 0.5)


def many(data, batch=4):
    """The argument `extra_frames` of `encode`: batches of frames."""
    colors = list(range(data.shape[1]))
    return lambda progress: (
        (colors, data[n : n + batch].astype(np.complex64)) for n in range(0, len(data), batch)
    )


def smooth(frames, seed=0, shape=(64, 64)):
    """Frames of one even gradient, each with phases of its own."""
    rows, columns = np.indices(shape) / 64
    amplitude = 0.4 + 0.5 * rows + 0.3 * np.sin(9 * columns)
    speckled = band_limited(shape, frames, seed=seed)
    return amplitude * speckled / np.abs(speckled)


def between_planes(frames, seed, size=64):
    """Frames of two textures at 1.1 and 1.9 mm, with random phases, at the SLM."""
    rng = np.random.default_rng(seed)
    columns = np.indices((size, size))[1]
    data = 0
    for distance, amplitude in ((1.1e-3, columns % 12 < 6), (1.9e-3, columns % 20 < 8)):
        half = columns < size // 2 if distance < 1.5e-3 else columns >= size // 2
        there = half * (0.3 + 0.7 * amplitude) * np.exp(2j * np.pi * rng.random((frames, size, size)))
        data = data + np.fft.ifft2(
            np.fft.fft2(there) * transfer_function((size, size), PITCH, GREEN, -distance)
        )
    return data[:, None]


def on_levels(phase, bits):
    levels = phase.data * (2**bits / (2 * math.pi))
    np.testing.assert_allclose(levels, np.round(levels), atol=1e-4)
