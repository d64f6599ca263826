"""Scene files of Mitsuba: their scene, view and notes.

Films, integrators, samplers and reconstruction filters are read for the view and the length of paths, and then
replaced by Mitsuba's simplest ones. So plugins of older versions and of other programs do not prevent loading.
"""

from __future__ import annotations

import math
import re
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..engine import Camera, InvalidInput
from ..engine.scene import variants
from .built_scene import BuiltScene

if TYPE_CHECKING:
    import mitsuba as mi

DEFAULT_FILM = 768, 576  # pixels, Mitsuba's default
# Vertices of a light path: for integrators without a limit, and the maximum. A closed room with a reflectance of 0.8 is
# within 3 % of Mitsuba's with 32, and 7 % too dark with 8.
UNLIMITED_DEPTH, MAX_DEPTH = 32, 64
# Plugins that replace a node's, by its kind.
REPLACEMENTS = {
    "Film": "hdrfilm",
    "Integrator": "path",
    "Sampler": "independent",
    "ReconstructionFilter": "box",
}
FILM_SIZES = ("width", "height", "crop_width", "crop_height", "crop_offset_x", "crop_offset_y")
# Names of arguments of Mitsuba's parser, which takes parameters as keyword arguments.
RESERVED = ("config", "filename")
ASPECT_TOLERANCE = 0.01  # relative difference of aspects, which are rounded to whole pixels


@dataclass(frozen=True)
class Film:
    """Size of a film and its crop window, in pixels.

    Attributes
    ----------
    width, height : int
    crop : (int, int, int, int)
        Left, top, width and height of the crop window; without one, those of the film.
    has_size : bool
        Whether the file gives a size; otherwise it is Mitsuba's default.
    """

    width: int = DEFAULT_FILM[0]
    height: int = DEFAULT_FILM[1]
    crop: tuple = (0, 0, *DEFAULT_FILM)
    has_size: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture that Mitsuba renders."""
        return self.crop[2], self.crop[3]

    @property
    def is_cropped(self) -> bool:
        """Whether the crop window is smaller than the film."""
        return self.crop != (0, 0, self.width, self.height)


class MitsubaFile:
    """A Mitsuba scene file, parsed but not built.

    Parameters
    ----------
    path : Path
    definitions : dict of str to str, optional
        Values of the file's `$parameters`.
    strict : bool
        Whether to refuse a definition that the file does not use.

    Raises
    ------
    InvalidInput
        If Mitsuba cannot parse it, or a parameter has neither a value nor a default.
    BackendUnavailable
        If Mitsuba cannot run.
    """

    def __init__(self, path: Path, definitions: dict | None = None, strict: bool = True) -> None:
        self.path, self._definitions, self._strict = path, dict(definitions or {}), strict
        variants.activate()
        self._state = self._parse()

    @cached_property
    def sensors(self) -> list[tuple[str, Any]]:
        """Id and properties of each sensor, in the file's order."""
        nodes = [self._state.nodes[index] for index in _sensors_of(self._state)]
        return [(node.props.id(), node.props) for node in nodes]

    def film(self, camera: str | None = None) -> Film:
        """Film of the sensor with the id `camera`, or of the first sensor."""
        props = self._sensor(camera)[1]
        return Film() if props is None else self._film(props)

    @property
    def max_depth(self) -> int:
        """Maximum length of a light path in vertices, the integrator's."""
        for node in self._integrators:
            depth = 2 if node.props.plugin_name() == "direct" else node.props.get("max_depth", -1)
            if isinstance(depth, int) and depth > 0:
                return min(depth, MAX_DEPTH)
        return UNLIMITED_DEPTH

    def build(self, size: tuple[int, int], camera: str | None = None) -> BuiltScene:
        """Build the scene by Mitsuba.

        Parameters
        ----------
        size : (int, int)
            Width and height of the hologram in pixels.
        camera : str, optional
            Id of the sensor. Default: the first one.

        Raises
        ------
        InvalidInput
            If Mitsuba refuses the scene, or it has no such sensor.
        """
        import mitsuba as mi

        from ..engine.scene.meshes import building

        number, props = self._sensor(camera)
        film = Film() if props is None else self._film(props)
        notes = self._notes(props, film, size)
        state, config = self._parse(), self._config()
        if _kind(state.nodes[0]) != "Scene":
            raise InvalidInput(f"{self.path} is not a scene: its outermost element must be <scene>.")
        for node in state.nodes:
            self._replace(node)
        others = set(_sensors_of(state)) - {_sensors_of(state)[number]} if self.sensors else ()
        for index in others:  # of any type
            state.nodes[index].props = _plain("perspective", state.nodes[index])
        try:
            with _beside(self.path):
                mi.parser.transform_all(config, state)
                scene = building.built(config, state)
        except Exception as error:
            raise self._refusal(error) from error
        if props is None or number >= len(scene.sensors()):
            raise InvalidInput(f"{self.path} has no sensor. Add a perspective one.")
        viewer = camera_of(scene.sensors()[number], size, _axis(props))
        if any(node.props.get("hide_emitters", False) for node in self._integrators):
            viewer = replace(viewer, sees_sky=False)
            if any(emitter.get_shape() is not None for emitter in scene.emitters()):
                notes.append(
                    _note(
                        "integrator",
                        "hide_emitters",
                        "the environment is hidden, emitting shapes are visible",
                    )
                )
        return BuiltScene(scene, viewer, notes)

    # -- reading

    def _config(self):
        import mitsuba as mi

        from ..engine.scene.meshes import building

        config = building.configuration()
        config.unused_parameters = mi.LogLevel.Debug  # `_check_definitions` has its own message
        return config

    def _parse(self):
        """Parse the file to Mitsuba's tree, upgraded to the current version and with references resolved."""
        import mitsuba as mi

        if str(self.path).startswith(r"\\"):
            raise InvalidInput(
                f"Mitsuba opens no file of a server, as {self.path} is. Give the share a drive letter."
            )
        config = self._config()
        try:
            with _beside(self.path):
                if self._definitions.keys() & set(RESERVED):
                    state = mi.parser.parse_string(config, self._wrapper())
                else:
                    state = mi.parser.parse_file(config, str(self.path), **self._definitions)
                mi.parser.transform_upgrade(config, state)
                mi.parser.transform_resolve_references(config, state)
        except Exception as error:
            missing = re.search(r"undefined parameter: \$(\w+)", str(error))
            if missing:
                name = missing[1]
                raise InvalidInput(
                    f"{self.path} has a parameter ${name} without a default. Add --define {name}=VALUE."
                ) from error
            raise self._refusal(error) from error
        if self._strict:
            self._check_definitions([Path(str(path)) for path in state.files])
        return state

    def _wrapper(self):
        """A scene that defines the parameters and includes the file, for parameters with names of `RESERVED`."""
        from xml.sax.saxutils import quoteattr

        lines = [
            f"<default name={quoteattr(name)} value={quoteattr(value)}/>"
            for name, value in self._definitions.items()
        ]
        include = f"<include filename={quoteattr(str(self.path.absolute()))}/>"
        return f'<scene version="3.0.0">{"".join(lines)}{include}</scene>'

    def _check_definitions(self, files):
        text = "".join(path.read_text("utf-8", "replace") for path in files if path.is_file())
        for name in self._definitions:
            if not re.search(rf"\${name}\b", text):
                names = sorted(set(re.findall(r"(?<!\\)\$(\w+)", text)))
                known = f"It has {', '.join(names)}" if names else "It has none"
                raise InvalidInput(f"{self.path} has no parameter ${name} to define. {known}.")

    def _refusal(self, error):
        reason = re.sub(r"\[\w+\.cpp:\d+\] ", "", " ".join(str(error).split())).rstrip(".")
        if (
            "incompatible sizes" in reason and 'type "ply"' in reason
        ):  # Mitsuba's error for a mesh without triangles
            return InvalidInput(
                f"{self.path} has a .ply without faces. Give the .ply itself instead of the .xml to show its points."
            )
        end = "" if reason.endswith("!") else "."
        return InvalidInput(f"{self.path} cannot be loaded as a Mitsuba scene: {reason}{end}")

    @property
    def _integrators(self):
        return [node for node in self._state.nodes if _kind(node) == "Integrator"]

    def _sensor(self, camera):
        """Index and properties of a sensor; 0 and None for the default one of a file without sensors."""
        if camera is None:
            return (0, self.sensors[0][1]) if self.sensors else (0, None)
        for number, (name, props) in enumerate(self.sensors):
            if name == camera:
                return number, props
        ids = ", ".join(name for name, _ in self.sensors if name) or "none with an id"
        raise InvalidInput(f"Expected a sensor of {self.path} ({ids}), got '{camera}'.")

    def _film(self, sensor):
        for index in _children(sensor):
            node = self._state.nodes[index]
            if _kind(node) == "Film":
                return self._film_of(node.props)
        return Film()

    def _film_of(self, props):
        for name in FILM_SIZES:
            value = props.get(name, 0)
            if not isinstance(value, int) or isinstance(value, bool) or value < 0:
                raise InvalidInput(
                    f"Expected the film's {name} in {self.path} as a whole number of pixels, got {value}."
                )
        width, height = props.get("width", DEFAULT_FILM[0]), props.get("height", DEFAULT_FILM[1])
        crop = (
            props.get("crop_offset_x", 0),
            props.get("crop_offset_y", 0),
            props.get("crop_width", width),
            props.get("crop_height", height),
        )
        if crop[0] + crop[2] > width or crop[1] + crop[3] > height or min(crop[2:]) < 1:
            raise InvalidInput(
                f"{self.path}: the film's crop window of {crop[2]} x {crop[3]} pixels at {crop[0]}, {crop[1]} does not "
                f"fit its {width} x {height} pixels. Correct its offset or size."
            )
        return Film(width, height, crop, any(name in props for name in FILM_SIZES))

    # -- differences

    def _notes(self, sensor, film, size):
        notes = []
        if sensor is None:
            return notes
        if film.has_size and abs(film.size[0] * size[1] / (film.size[1] * size[0]) - 1) > ASPECT_TOLERANCE:
            name = "crop window" if film.is_cropped else "film"
            effect = (
                f"the hologram's {size[0]} x {size[1]} have another aspect: {_AXES[_axis(sensor)]} of the view stays, "
                "the other side differs; omit --resolution and --display for the same view"
            )
            notes.append(_note(name, f"{film.size[0]} x {film.size[1]} pixels", effect))
        if sensor.plugin_name() == "thinlens":
            radius, focus = sensor.get("aperture_radius", 0.0), sensor.get("focus_distance", math.inf)
            effect = "the hologram has its own pupil, and every depth comes into focus"
            if math.isfinite(focus):
                effect += f"; use --focus {focus:g}m for the file's"
            notes.append(_note("sensor", f"aperture_radius {radius:g}", effect))
        if "srf" in sensor:
            notes.append(_note("sensor", "srf", "ignored: the scene's colors are RGB"))
        for index in _children(sensor):
            node = self._state.nodes[index]
            if _kind(node) != "Film":
                continue
            if node.props.plugin_name() == "specfilm":
                notes.append(
                    _note("film", "specfilm", "its bands are ignored: the hologram has its wavelengths")
                )
            if str(node.props.get("pixel_format", "rgb")).lower().startswith(("luminance", "mono")):
                notes.append(_note("film", "pixel_format", "ignored: the hologram is in color"))
        if any(node.props.plugin_name() == "depth" for node in self._integrators):
            notes.append(_note("integrator", "depth", "ignored: the hologram shows light"))
        return notes

    def _replace(self, node):
        """Replace a plugin by the simplest one of its kind, and remove a sensor's spectral response."""
        kind = _kind(node)
        if kind == "Sensor" and "srf" in node.props:
            del node.props["srf"]
        if kind not in REPLACEMENTS:
            return
        plain = _plain(REPLACEMENTS[kind], node)
        if kind == "Film":
            film = self._film_of(node.props)
            sizes = (film.width, film.height, film.crop[2], film.crop[3], film.crop[0], film.crop[1])
            for name, value in zip(FILM_SIZES, sizes, strict=True):
                plain[name] = value
        node.props = plain


# The extent that stays for each `fov_axis`, if a hologram has another aspect than the film.
_AXES = {
    "x": "the width",
    "y": "the height",
    "smaller": "the shorter side",
    "larger": "the longer side",
    "diagonal": "the diagonal",
}


def _axis(sensor):
    """The axis of a sensor's field of view."""
    axis = str(sensor.get("fov_axis", "x")).lower() if "fov" in sensor else "diagonal"
    return axis if axis in _AXES else "x"


def _plain(plugin, node):
    """Default properties of a plugin that replaces a node's."""
    import mitsuba as mi

    plain = mi.Properties(plugin)
    plain.set_id(node.props.id())
    return plain


def _sensors_of(state):
    """Indices of the scene's sensors, in the file's order."""
    return [index for index in _children(state.nodes[0]) if _kind(state.nodes[index]) == "Sensor"]


def _kind(node):
    return node.type.name


def _children(props_or_node):
    """Indices of a node's children, in the file's order."""
    props = getattr(props_or_node, "props", props_or_node)
    return [value.index() for _, value in props.items() if type(value).__name__ == "ResolvedReference"]


def _note(thing, feature, effect):
    return {"object": thing, "feature": feature, "effect": effect, "material": ""}


@contextmanager
def _beside(path):
    """Make Mitsuba find files beside a scene file within the block, as `mitsuba.load_file` does."""
    import mitsuba

    mi: Any = mitsuba  # its stubs differ
    previous = mi.file_resolver()
    resolver = mi.FileResolver(previous)
    resolver.prepend(str(path.parent))
    mi.set_file_resolver(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(previous)


def camera_of(sensor: mi.Sensor, size: tuple[int, int] | None = None, axis: str = "x") -> Camera:
    """Convert a Mitsuba `perspective` or `thinlens` sensor to a camera.

    Mitsuba's sensors look along +z with x to the left, Blender's along -z. The view is that of the film's crop window.
    A hologram of another aspect has the same center, and the same extent along one axis, as Mitsuba does by `fov_axis`
    for a film of that size.

    Parameters
    ----------
    sensor : mitsuba.Sensor
    size : (int, int), optional
        Width and height of the hologram. Default: those of the crop window.
    axis : {'x', 'y', 'smaller', 'larger', 'diagonal'}
        The axis whose extent stays.

    Returns
    -------
    Camera

    Raises
    ------
    InvalidInput
        If the sensor is of another kind.
    """
    import mitsuba as mi

    params = mi.traverse(sensor)
    if "x_fov" not in params or "to_world" not in params:
        raise InvalidInput(
            f"The scene's sensor '{sensor.id()}' ({sensor.class_name()}) is not a perspective one. Add one of type "
            "'perspective' or 'thinlens', or choose one by --camera."
        )

    def number(key, default=0.0):
        return float(np.asarray(params[key]).ravel()[0]) if key in params else default

    film = sensor.film()
    (width, height), (crop_width, crop_height) = film.size(), film.crop_size()
    left, top = film.crop_offset()
    # tangents of angles: a pixel, the crop window's half sides, and its center
    pixel = 2 * math.tan(0.5 * math.radians(number("x_fov"))) / width
    half_width, half_height = 0.5 * pixel * crop_width, 0.5 * pixel * crop_height
    right = pixel * (left + 0.5 * crop_width + (number("principal_point_offset_x") - 0.5) * width)
    down = pixel * (top + 0.5 * crop_height + (number("principal_point_offset_y") - 0.5) * height)
    columns, rows = size or (crop_width, crop_height)
    half = _half_width(half_width, half_height, columns / rows, axis)
    return Camera(
        np.asarray(params["to_world"].matrix, np.float64).reshape(4, 4) @ np.diag([-1.0, 1.0, -1.0, 1.0]),
        2 * math.atan(half),
        shift_x=0.5 * right / half,
        shift_y=-0.5 * down / half,
        clip_start=number("near_clip"),
        clip_end=number("far_clip", math.inf),
    )


def _half_width(half_width, half_height, aspect, axis):
    """Half the width of a view of another aspect that has a given view's extent along an axis."""
    if axis == "y":
        return half_height * aspect
    if axis == "diagonal":
        return math.hypot(half_width, half_height) / math.hypot(1, 1 / aspect)
    if axis == "smaller":
        return min(half_width, half_height) * max(1.0, aspect)
    if axis == "larger":
        return max(half_width, half_height) * min(1.0, aspect)
    return half_width
