"""Where does the image in a convex mirror come into focus? Neither on the mirror, nor as far as the light has gone."""

import math

import numpy as np
from pictures import asked, save_rows, shown

from holopath_addon import engine
from holopath_addon.engine.scene import variants

path, pixels = asked(__file__)
variants.activate()
import mitsuba as mi  # noqa: E402 - after a variant is chosen

place = mi.ScalarTransform4f


def squares(bright, dark, count):
    """A checkered surface that shines."""
    scale = place().scale([count, count, 1])
    board = {"type": "checkerboard", "color0": bright, "color1": dark, "to_uv": scale}
    return {"type": "area", "radiance": board}


def rgb(*values):
    return {"type": "rgb", "value": values}


# A chart behind the viewer, OBJECT from a mirror of radius RADIUS, whose front is MIRROR from the viewer.
MIRROR, RADIUS, OBJECT = 0.4, 0.4, 0.8
behind = OBJECT * RADIUS / (RADIUS + 2 * OBJECT)  # the mirror equation, 1/o - 1/i = -2/R
chart = place().translate([0, 0, OBJECT - MIRROR]).rotate([0, 1, 0], 180).scale(0.6)
scene = mi.load_dict(
    {
        "type": "scene",
        "mirror": {
            "type": "sphere",
            "center": [0, 0, -MIRROR - RADIUS],
            "radius": RADIUS,
            "bsdf": {"type": "conductor", "material": "none"},
        },
        "chart": {
            "type": "rectangle",
            "to_world": chart,
            "emitter": squares(rgb(0.95, 0.75, 0.3), rgb(0.05, 0.1, 0.3), 12),
        },
    }
)

hologram = engine.Hologram(pixels, pixels, pitch=8e-6, near=MIRROR)
camera = engine.Camera(np.eye(4), fov_x=math.radians(20))
field = engine.render(scene, camera, hologram, engine.Settings(frames=8))

depths = MIRROR, MIRROR + behind, MIRROR + OBJECT
images = engine.reconstruct(field, depths)
for depth, image in zip(depths, images, strict=True):
    print(f"focused at {depth:.3f} m: contrast {image.std() / image.mean():.2f}")
save_rows(path, shown(images))
