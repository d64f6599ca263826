"""The camera: how it fits, shifts, clips and turns."""

import itertools
import math

from .feature import EVERYWHERE, SQUARE, TALL, WIDE, Feature
from .staging import EMISSION, ball, tan, tiles


def _view(stage):
    """Tiles with a ball in front."""
    glow = stage.material(EMISSION, "tiles")
    stage.texture(glow, tiles(stage, count=8), "Color").interpolation = "Closest"
    stage.plane(6, glow, "tiles")
    ball(stage, tan(stage), 0.4, (0.3, -0.2, 1))
    stage.world((1, 1, 1), 0.3)


def _shifted(stage, data):
    data.shift_x, data.shift_y = 0.2, -0.15


def _clipped_near(stage, data):
    data.clip_start = 2.9


def _clipped_far(stage, data):
    data.clip_end = 3.9


def _turned(stage, data):
    stage.camera.rotation_euler = (0.2, -0.15, 0.4)
    stage.camera.scale = (2, 2, 2)


def _by_angle(stage, data):
    data.lens_unit, data.angle = "FOV", math.radians(30)


def _centimeters(stage, data):
    stage.scene.unit_settings.scale_length = 0.01


CAMERAS = {
    "shift": _shifted,
    "clip start through an object": _clipped_near,
    "clip end before an object": _clipped_far,
    "turned and scaled camera": _turned,
    "field of view": _by_angle,
    "unit scale 0.01": _centimeters,
}


def _through(adjust):
    def build(stage):
        adjust(stage, stage.camera.data)
        _view(stage)

    return build


def _fitted(fit):
    def adjust(stage, data):
        data.sensor_fit, data.sensor_width, data.sensor_height, data.lens = fit, 30, 20, 26

    return _through(adjust)


def _focused(stage, data):
    data.dof.use_dof = True
    data.dof.focus_distance, data.dof.aperture_fstop = 1.0, 0.1


def _sharp(stage):
    stage.camera.data.dof.use_dof = False


FEATURES = [
    *(
        Feature(
            f"sensor fit {fit.lower()}, {shape}", "camera", _fitted(fit), EVERYWHERE, resolution=resolution
        )
        for fit, (shape, resolution) in itertools.product(
            ("AUTO", "HORIZONTAL", "VERTICAL"), {"square": SQUARE, "wide": WIDE, "tall": TALL}.items()
        )
    ),
    *(
        Feature(name, "camera", _through(adjust), EVERYWHERE, resolution=WIDE)
        for name, adjust in CAMERAS.items()
    ),
    Feature(
        "depth of field ignored",
        "camera",
        _through(_focused),
        EVERYWHERE,
        notes=frozenset({"Depth of Field"}),
        reference=_sharp,
    ),
]
