"""Small fields and phases with every value different from all others."""

import numpy as np

from holopath_addon import engine

WAVELENGTHS = (640e-9, 455.4e-9)


def hologram(height=6, width=9):
    return engine.Hologram(width, height, 8e-6, WAVELENGTHS, 1e-3, 3e-3)


def camera():
    turned = np.array([[0.0, -1, 0, 2], [1, 0, 0, -3], [0, 0, 1, 0.1], [0, 0, 0, 1]])
    return engine.Camera(turned, 0.3, shift_x=0.01, clip_end=100.0)


def field(frames=3, **size):
    what = hologram(**size)
    rng = np.random.default_rng(1)
    parts = rng.normal(size=(2, frames, 2, what.height, what.width)).astype(np.float32)
    return engine.WaveField(parts[0] + 1j * parts[1], what, camera(), 0.7, {"reasons": {"planes": "one"}})


def phases(frames=3):
    angles = np.angle(field(frames).data) % np.float32(2 * np.pi)
    return engine.PhaseHologram(angles, hologram(), camera(), 0.7, "joint", (0.5, 0.25))
