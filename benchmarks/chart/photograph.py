"""A photograph with a depth for each pixel, as a phone takes it: what most people have in place of a scene."""

import math
import tempfile
from pathlib import Path

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.viewing.preview import Preview
from holopath_addon.exchange import captures

ANGLE = 50.0  # degrees, the photograph's width
PATHS = 64  # a pixel


def photograph(s, pixels):
    """The scene of the files, as ``holopath render PICTURE --depth FILE`` reads them, and its camera.

    Parameters
    ----------
    s : Scenes
    pixels : int
        Of the hologram and of the photograph, a side.
    """
    with tempfile.TemporaryDirectory(prefix="holopath-photograph-") as folder:
        picture, depth = take(s, pixels, Path(folder))
        options = captures.CaptureOptions(depth=str(depth), depth_unit="mm", fov=ANGLE)
        made = captures.open_capture(picture, options).build((pixels, pixels))
    return made.scene, made.camera


def take(s, pixels, folder):
    """Photograph a street of blocks under the sky, and measure its depth.

    Returns
    -------
    (Path, Path)
        A ``.png`` of 8 bits in sRGB, and one of 16 bits in millimeters along the camera's axis.
    """
    scene, camera = street(s), engine.Camera(np.eye(4), math.radians(ANGLE))
    view = Preview(scene, camera, pixels, pixels, max_depth=4)
    radiance = np.clip(view.refine(PATHS, lambda done, what: None), 0, 1)
    depth = engine.depth_map(scene, camera, pixels, pixels)
    picture, distances = folder / "street.png", folder / "street_depth.png"
    Bitmap, Pixel = s.mi.Bitmap, s.mi.Struct.Type
    Bitmap(radiance.astype(np.float32)).convert(Bitmap.PixelFormat.RGB, Pixel.UInt8, True).write(str(picture))
    levels = np.clip(np.rint(1e3 * depth), 1, 2**16 - 1).astype(np.uint16)
    Bitmap(levels[..., None]).write(str(distances))
    return picture, distances


def street(s):
    """Houses on both sides of a paved street that leads away to a wall, and flowers in front."""
    rng = np.random.default_rng(71)
    shapes = {
        "ground": s.box([-4, -0.62, -8.5], [4, -0.6, 0.3], s.diffuse(s.texture(256, 72, 0.15, 0.7))),
        "wall": s.box([-5, -0.6, -8.1], [5, 4, -8], s.diffuse(s.texture(128, 73, 0.3, 0.9))),
        "sun": {
            "type": "rectangle",
            "to_world": s.T().look_at(origin=[3, 6, 3], target=[0, 0, -2], up=[0, 1, 0]).scale(0.8),
            **s.emissive(s.gray(16.0)),
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.28, 0.36, 0.5]}},
    }
    for k, depth in enumerate((1.6, 2.6, 3.9, 5.5)):
        for side in (-1, 1):
            dye = rng.uniform(0.25, 0.9, 3).astype(np.float32)
            front = s.diffuse(s.texture(64, 80 + 2 * k + side, 0.3 * dye, dye, contrast=2, channels=1))
            low, high = (
                [side * (0.95 + 0.1 * k), -0.6, -depth - 0.7],
                [side * 2.2, rng.uniform(0.2, 0.9), -depth],
            )
            corners = np.sort([low, high], axis=0)
            shapes[f"house_{k}_{side}"] = s.box(*corners, front)
    for k in range(14):
        x, z = rng.uniform(-0.3, 0.3), -rng.uniform(0.65, 1.1)
        foot, height = np.array([x, -0.6, z]), rng.uniform(0.28, 0.48)
        dye = {"type": "rgb", "value": rng.uniform([0.5, 0.05, 0.05], [0.95, 0.7, 0.6]).tolist()}
        green = s.diffuse({"type": "rgb", "value": [0.08, 0.3, 0.06]})
        shapes[f"stem_{k}"] = s.turned([0.005, 0.004], [0, height], foot, green, 12)
        shapes[f"flower_{k}"] = s.ball(rng.uniform(0.02, 0.04), foot + [0, height, 0], s.diffuse(dye))
    return s.scene(**shapes)
