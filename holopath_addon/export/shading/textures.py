"""Values of shader sockets: constants, images as Mitsuba bitmaps, or what has been baked of anything else."""

import contextlib
import math
import os
import re
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from ...engine.scene.variants import made
from ..notes import Notes
from .baking import ATLAS, COLOR, EMISSION, NORMAL, NUMBER, Output
from .node_graph import Pin, alphas_upstream, first_link, follow, upstream

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
MAGENTA = (1.0, 0.0, 1.0)
# Sockets whose values are not those of the point of a surface alone, and how they are baked.
_BAKED_AS = (
    (
        "as seen by the camera from straight above the surface",
        {
            *("Fresnel", "LayerWeight", "CameraData"),
            *(("TexCoord", name) for name in ("Camera", "Window", "Reflection")),
            *(("NewGeometry", name) for name in ("Incoming", "Backfacing")),
        },
    ),
    ("as camera rays see it, what other rays alone would see is missing", {"LightPath"}),
    ("of the object alone", {"AmbientOcclusion", "Bevel", "Raycast"}),
    ("of the mesh in triangles", {"Wireframe", ("NewGeometry", "Parametric"), ("NewGeometry", "Pointiness")}),
    ("the same for all instances of a mesh", {"ParticleInfo"}),
)
# Of an object, which a stand-in has otherwise.
_PLACE = ("location", "rotation_", "scale", "matrix_", "delta_", "dimensions", "parent")
_CONSTANT = ("ShaderNodeRGB", "ShaderNodeValue")
_LINEAR_SPACES = ("Non-Color", "Raw", "Linear", "Linear Rec.709", "scene_linear")
_NO_NEGATIVE = "negative values, as of colors outside Rec.709, are shown as zero"
_ANIMATION_SOURCES = ("SEQUENCE", "MOVIE")
# Files whose color Cycles takes to be multiplied by their alpha, whatever the image's alpha mode.
_ASSOCIATED_FILES = ("OPEN_EXR", "OPEN_EXR_MULTILAYER", "HDR")
# Files whose color Cycles multiplies by their alpha. Of others it depends on the file.
_STRAIGHT_FILES = ("PNG", "TARGA", "TARGA_RAW")
_WRAPS = {"REPEAT": "repeat", "MIRROR": "mirror", "EXTEND": "clamp", "CLIP": "black"}
_SMOOTH = ("Cubic", "Smart")  # both are Cycles' B-spline


def stand_in_effect(source):
    """Effect of baking on an output socket's value, which differs in the scene for baking; empty for no effect.

    Parameters
    ----------
    source : Pin

    Returns
    -------
    str
    """
    node = source.node
    kind = node.bl_idname.removeprefix("ShaderNode")
    if kind == "VectorTransform" and "CAMERA" in (node.convert_from, node.convert_to):
        return "as of a camera at the world's origin that looks down"
    if kind == "GeometryNodeInputSceneTime" and source.socket.name == "Seconds":  # since Blender 5.1
        return "as of 24 frames a second"
    if kind == "LightFalloff":
        smooth = follow(source.input("Smooth")).socket
        if source.socket.name != "Quadratic" or smooth.is_output or smooth.default_value > 0:
            return "light falls off with the square of the distance, whatever it says"
    if kind == "Script":
        return "renders black: scripts of Open Shading Language are not run"
    return ""


def effect_beside_surfaces(source):
    """Effect as of `stand_in_effect`, on lights and worlds, whose scene for baking lacks more."""
    node = source.node
    if node.bl_idname == "ShaderNodeAttribute" and node.attribute_type == "VIEW_LAYER":
        return "reads 0, as lights and worlds are baked in a scene of their own"
    if node.bl_idname == "ShaderNodeAttribute" and node.attribute_type == "OBJECT":
        if node.attribute_name.startswith(_PLACE):
            return "the object's location, rotation and scale read as if they were cleared"
    return stand_in_effect(source)


@dataclass(frozen=True, eq=False)
class RawImage:
    """Pixels in place of a Blender image.

    Attributes
    ----------
    name_full : str
        Unlike any other picture's.
    pixels : float32 [y, x, channel]
        Linear, bottom row first; one or three channels.
    """

    name_full: str
    pixels: np.ndarray
    is_float: bool = True


@dataclass(frozen=True, eq=False)
class StoredImage:
    """An image's numbers as stored in Cycles, which interpolates between them.

    Attributes
    ----------
    pixels : uint8 or float32 [y, x, 4]
        Bottom row first.
    srgb : bool
        The color is encoded.
    associated : bool
        The color has been multiplied by an alpha that is not one everywhere, encoded or not.
    """

    pixels: np.ndarray
    srgb: bool = False
    associated: bool = False

    @property
    def numbers(self):
        """The pixels as float32, of bytes 0 to 1."""
        return _as_float(self.pixels)


@dataclass(frozen=True)
class ImageValue:
    """A socket fed by an image.

    Attributes
    ----------
    image : bpy.types.Image or RawImage
    alpha : bool
        Read the alpha channel instead of the color.
    alpha_read : bool
        Something reads the alpha too: then Cycles divides the color by it.
    interpolation : str
        Blender's ``Linear``, ``Closest``, ``Cubic`` or ``Smart``.
    extension : str
        Blender's ``REPEAT``, ``EXTEND``, ``CLIP`` or ``MIRROR``.
    uv_name : str or None
        UV map; None for the active one.
    uv_matrix : tuple of 9 floats
        Row-major transform of the UVs.
    gray : bool
        The color's luminance instead of the color.
    scale : tuple of 3 floats
        Factor on the linear color.
    offset : tuple of 3 floats
        Added after the factor.
    power : float
        Exponent on the linear color, before the factor.
    """

    image: Any
    alpha: bool = False
    alpha_read: bool = False
    interpolation: str = "Linear"
    extension: str = "REPEAT"
    uv_name: str | None = None
    uv_matrix: tuple = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    gray: bool = False
    scale: tuple = (1.0, 1.0, 1.0)
    offset: tuple = (0.0, 0.0, 0.0)
    power: float = 1.0

    def scaled(self, factor):
        """The same image times a number or a color."""
        return self._affine(np.asarray(factor, float), 0.0)

    def inverted(self):
        """One minus the image."""
        return self._affine(-1.0, 1.0)

    def _affine(self, factor, offset):
        scale, offset = np.asarray(self.scale) * factor, np.asarray(self.offset) * factor + offset
        return replace(self, scale=tuple(map(float, scale)), offset=tuple(map(float, offset)))


def missing(node, owner, frame, notes):
    """Whether a node's image is missing or unreadable, and note it: it is opaque and magenta, as in Cycles.

    Parameters
    ----------
    node : bpy.types.ShaderNode
        An Image or Environment Texture.
    owner : str
        Name for the note where there is no image.
    frame : float
        Of the scene.
    notes : Notes

    Returns
    -------
    bool
    """
    image = node.image
    if image is None:
        notes.add(owner, "Image Texture without an image", "shown in magenta")
        return True
    what = "Image file"
    if image.source not in (*_ANIMATION_SOURCES, "TILED") or image.packed_files:
        is_missing = not (image.size[0] * image.size[1] and image.channels)
    elif image.source == "TILED":
        path = _path(image)
        tiles = [tile.number for tile in image.tiles if not os.path.isfile(_tile_path(path, tile.number))]
        if image.is_dirty or not image.filepath:  # made here and not saved
            tiles = []
        is_missing = len(tiles) == len(image.tiles)
        for number in () if is_missing else tiles:
            notes.add(image.name, f"UDIM tile {number}", "missing: shown in magenta")
    elif image.source == "SEQUENCE":
        number = frame_shown(node.image_user, frame)
        what, is_missing = (
            f"Frame {number} of a sequence",
            not os.path.isfile(_frame_path(_path(image), number)),
        )
    else:
        is_missing = not os.path.isfile(_path(image))
    if is_missing:
        notes.add(image.name, what, "missing: shown in magenta")
    return is_missing


def _path(image):
    return bpy.path.abspath(image.filepath, library=image.library)


def frame_shown(user, frame):
    """Number of the frame of a sequence or movie that Cycles shows at a frame of the scene.

    Parameters
    ----------
    user : bpy.types.ImageUser
    frame : float

    Returns
    -------
    int
    """
    count = user.frame_duration
    if not count:
        return 0
    number = math.floor(frame) - user.frame_start + 1
    if user.use_cyclic:
        number = (number - 1) % count + 1
    return min(max(number, 0), count) + user.frame_offset


def _frame_path(path, number):
    """File of a frame: the last digits in the name are replaced."""
    folder, name = os.path.split(path)
    stem, end = os.path.splitext(name)
    digits = re.search(r"(\d+)(\D*)$", stem)
    if digits is None:
        return path
    counted = f"{max(number, 0):0{len(digits[1])}d}"
    return os.path.join(folder, stem[: digits.start()] + counted + digits[2] + end)


def _tile_path(path, number):
    column, row = (number - 1001) % 10 + 1, (number - 1001) // 10 + 1
    return path.replace("<UDIM>", str(number)).replace("<UVTILE>", f"u{column}_v{row}")


def stored(image, notes):
    """An image that is not `missing`, as Cycles keeps it.

    Parameters
    ----------
    image : bpy.types.Image
    notes : Notes

    Returns
    -------
    StoredImage
    """
    width, height = image.size
    if image.source in _ANIMATION_SOURCES:
        notes.add(image.name, "Image sequence or movie", "only the frame loaded now is used")
    elif image.source == "TILED":
        notes.add(image.name, "UDIM tiles", "only the first tile is used")
    pixels = np.empty(width * height * 4, np.float32)
    if not pixels.size:
        notes.add(image.name, "Image file", "not loaded by Blender: shown in magenta")
        return StoredImage(np.full((1, 1, 4), (*MAGENTA, 1.0), np.float32))
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, 4)
    space = image.colorspace_settings
    associated = _is_associated(image)
    if image.alpha_mode == "NONE":
        pixels[..., 3] = 1
    color, alpha = pixels[..., :3], pixels[..., 3:]
    associated = associated and bool(alpha.min() < 1)
    if associated and not _is_alpha_known(image):
        notes.add(
            image.name,
            f"Alpha of a {image.file_format} file",
            "the color may be darker or brighter where it is transparent",
        )
    if not image.is_float:
        srgb = space.name not in _LINEAR_SPACES
        if srgb and space.name != "sRGB":
            notes.add(image.name, f"Color Space {space.name}", "read as sRGB")
        levels = np.rint(pixels * 255).astype(np.uint8)
        if associated:
            levels[..., :3] = levels[..., :3].astype(np.uint16) * levels[..., 3:] // 255
        return StoredImage(levels, srgb, associated)
    # Blender has decoded them, and after that multiplied by the alpha
    srgb = _is_from_file(image) and space.name == "sRGB"
    as_it_is = (
        _is_from_file(image) and image.alpha_mode == "STRAIGHT" and image.file_format in _ASSOCIATED_FILES
    )
    if associated and (srgb or as_it_is):
        color[:] = _divide_alpha(color, alpha)
    if srgb:
        color[:] = _encode(color)
        if associated and not as_it_is:
            color *= alpha
    return StoredImage(pixels, srgb, associated)


def _is_from_file(image):
    """Whether Cycles reads the file itself; it has packed and generated images from Blender."""
    return image.source in ("FILE", "SEQUENCE", "TILED") and not image.packed_files


def _is_associated(image):
    """Whether Cycles takes the color as multiplied by the alpha."""
    return not image.colorspace_settings.is_data and image.alpha_mode in ("STRAIGHT", "PREMUL")


def _is_alpha_known(image):
    """Whether Blender's color and alpha tell those that Cycles reads from the file, where that is not opaque."""
    straight = image.alpha_mode == "STRAIGHT" and image.file_format in _STRAIGHT_FILES
    return straight or image.file_format in _ASSOCIATED_FILES or not _is_from_file(image)


def _points_away(pixels):
    """Whether a hundredth of a baked normal map's normals lie below the surface or have no length.

    What is not used of the map is zero.
    """
    used = pixels[pixels.any(axis=-1)]
    return len(used) > 0 and (used[:, 2] < 0.501).mean() > 0.01


def _is_negative(pixels):
    """Whether a hundredth of a color image is below zero, as colors outside Rec.709 are."""
    if pixels.shape[2] < 3:
        return False
    return -np.minimum(pixels, 0).sum(dtype=float) > 0.01 * np.abs(pixels).sum(dtype=float)


def _as_float(pixels):
    return pixels * np.float32(1 / 255) if pixels.dtype == np.uint8 else pixels


def _divide_alpha(color, alpha):
    """Color without the factor of its alpha, as Cycles divides."""
    return color / np.where(alpha == 0, np.float32(1), alpha)


def decode_srgb(color):
    """Linear values of sRGB's (IEC 61966-2-1)."""
    return np.where(color <= 0.04045, color / 12.92, ((np.maximum(color, 0) + 0.055) / 1.055) ** 2.4)


def _encode(color):
    """Inverse of `decode_srgb`."""
    return np.where(color <= 0.0031308, color * 12.92, 1.055 * np.maximum(color, 0) ** (1 / 2.4) - 0.055)


# Stands for what is still to be baked.
PENDING = ImageValue(RawImage("pending", np.ones((1, 1, 3), np.float32)))


class MaterialReading:
    """State of the reading of one material.

    Parameters
    ----------
    baked : dict or None
        Baked `RawImage` by `socket_key`; None where nothing can be baked, so that unsupported nodes are replaced
        by constants.

    Attributes
    ----------
    wanted : dict
        `baking.Output` by `socket_key`, of every socket that is not constant.
    pressing : bool
        Whether there are sockets that only baking can serve.
    uv_names : set of (str or None)
        UV maps of the images read directly.
    alphas_read : set of Pin
        Alpha outputs of images that the material reads.
    """

    def __init__(self, baked):
        self.baked = baked
        self.outputs = {}
        self.pressing = False
        self.uv_names = set()
        self.alphas_read: set[Pin] = set()

    @property
    def incomplete(self):
        """Whether the sockets that vary have to be baked."""
        return self.baked is not None and not self.baked and (self.pressing or len(self.uv_names) > 1)


def socket_key(pin, kind=None):
    """Tells an input socket from all others of a material, also of another evaluation of it."""
    if pin is None:
        return (kind,)
    return (*(group.name for group in pin.groups), pin.node.name, pin.socket.identifier)


class Textures:
    """Reads socket values and builds each Mitsuba texture once.

    Parameters
    ----------
    notes : Notes
    """

    def __init__(self, notes):
        self._notes = notes
        self._stored = {}
        self._cache = {}
        self._reading = MaterialReading(None)
        self.frame = 0.0  # of the scene

    def read_alphas(self, *pins):
        """Find the Alpha outputs that input sockets of the material's output depend on."""
        self._reading.alphas_read = alphas_upstream(*pins)

    @contextlib.contextmanager
    def reading(self, reading, notes):
        """Values read within are those of one material; what they need, and notes, are left in the arguments."""
        outer = self._reading, self._notes
        self._reading, self._notes = reading, notes
        try:
            yield
        finally:
            self._reading, self._notes = outer

    def value(self, pin, owner, fallback):
        """Value that feeds a socket.

        Parameters
        ----------
        pin : Pin or None
            An input socket.
        owner : str
            Name for notes.
        fallback : float or tuple of 3 floats
            Used where the socket is missing or fed by nodes that cannot be exported.

        Returns
        -------
        float, tuple of 3 floats, or ImageValue
        """
        if pin is None:
            return fallback
        source = follow(pin)
        node = source.node
        if not source.socket.is_output or node.bl_idname in _CONSTANT:
            return _plain(source.socket.default_value)
        pictured = node.bl_idname == "ShaderNodeTexImage" and not node.mute
        if pictured and missing(node, owner, self.frame, self._notes):
            return 1.0 if source.socket.name == "Alpha" else MAGENTA
        feature = f"{node.bl_label} node into {pin.socket.name}"
        reading = self._reading
        reading.outputs[socket_key(pin)] = Output(pin, NUMBER if pin.socket.type == "VALUE" else COLOR)
        if reading.baked:
            return self._baked(pin, owner, feature)
        if pictured and (reading.baked is None or self._is_direct(source)):
            return self._image(source, owner)
        reading.pressing = True
        if reading.baked is None:
            self._notes.add(owner, feature, "not supported: replaced by a constant")
            return fallback
        return PENDING

    def normal(self, pin, owner):
        """Tangent-space normal map baked of a linked Normal socket, or of the displacement (None).

        Returns
        -------
        ImageValue or None
        """
        what = "Displacement" if pin is None else f"{follow(pin).node.bl_label} node into {pin.socket.name}"
        normals = self._whole(pin, NORMAL, owner, what)
        if self._reading.baked is None:
            self._notes.add(owner, what, "ignored")
        return normals

    def emission(self, owner):
        """All that a material emits, baked; None where that is not done, or not yet.

        Returns
        -------
        ImageValue or None
        """
        return self._whole(None, EMISSION, owner, "Emission of several textures")

    def _whole(self, pin, kind, owner, what):
        self._reading.outputs[socket_key(pin, kind)] = Output(pin, kind)
        if self._reading.baked:
            return self._baked(pin, owner, what, kind)
        self._reading.pressing = True
        return None

    def _baked(self, pin, owner, feature, kind=None):
        picture = self._reading.baked[socket_key(pin, kind)]
        read, differing = set(), []
        for source in upstream(pin) if pin is not None else ():
            differing.append(stand_in_effect(source))
            name = source.node.bl_idname.removeprefix("ShaderNode")
            read |= {name, (name, source.socket.name)}
        effects = ["baked to a texture", *(how for how, sockets in _BAKED_AS if sockets & read), *differing]
        if kind != NORMAL and _is_negative(picture.pixels):
            effects.append(_NO_NEGATIVE)
        if kind == NORMAL and _points_away(picture.pixels):
            effects.append("normals that point away from the surface reflect nothing there")
        self._notes.add(owner, feature, ", ".join(filter(None, dict.fromkeys(effects))))
        return ImageValue(picture, extension="EXTEND", uv_name=ATLAS)

    def _is_direct(self, source):
        """Whether Mitsuba can read an image as it is."""
        node, image = source.node, source.node.image
        return (
            node.projection == "FLAT"
            and image.source not in ("TILED", *_ANIMATION_SOURCES)
            and self.is_known(image)
            and self._reads_uv(source.input("Vector"))
            and self._is_flat(source)
        )

    @staticmethod
    def _is_flat(source):
        """Whether the node's own Texture Mapping is an affine map of UVs."""
        if source.node.texture_mapping.vector_type == "NORMAL":
            return False
        raised = source.input("Vector") and first_link(source.input("Vector").socket)
        return not raised or not np.any(own_mapping(source.node)[:2, 2])

    def _reads_uv(self, pin):
        """Whether a Vector socket carries a UV map, moved by Mapping nodes in the plane at most."""
        source = follow(pin)
        if not source.socket.is_output:
            return True
        node = source.node
        if node.bl_idname == "ShaderNodeMapping" and node.vector_type in ("POINT", "TEXTURE"):
            sides = [follow(source.input(name)) for name in ("Location", "Rotation", "Scale")]
            if any(side.socket.is_output for side in sides):
                return False
            turned = sides[1].socket.default_value
            return abs(turned[0]) + abs(turned[1]) < 1e-6 and self._reads_uv(source.input("Vector"))
        reads = node.bl_idname == "ShaderNodeUVMap" or (
            node.bl_idname == "ShaderNodeTexCoord" and source.socket.name == "UV"
        )
        return reads and not node.from_instancer

    def constant(self, pin, owner, fallback):
        """Constant value that feeds a socket, for parameters without textures; others are noted and replaced."""
        source = pin and follow(pin)
        if source and source.socket.is_output and source.node.bl_idname not in _CONSTANT:
            feature = f"{source.node.bl_label} node into {pin.socket.name}"
            self._notes.add(owner, feature, "replaced by a constant")
            return fallback
        return self.value(pin, owner, fallback)

    def _image(self, source, owner):
        node = source.node
        if node.projection != "FLAT":
            self._notes.add(owner, f"{node.projection.title()} projection", "mapped by UV instead")
        if node.texture_mapping.vector_type == "NORMAL":
            self._notes.add(owner, "Texture Mapping of the Normal kind", "not normalized")
        if node.image.is_float and not node.image.colorspace_settings.is_data:
            if _is_negative(self.stored(node.image).pixels):
                self._notes.add(owner, f"Colors of {node.image.name}", _NO_NEGATIVE)
        uv_name, matrix = self._coordinates(source.input("Vector"), owner)
        matrix = own_mapping(node)[np.ix_([0, 1, 3], [0, 1, 3])] @ matrix
        self._reading.uv_names.add(uv_name)
        return ImageValue(
            node.image,
            alpha=source.socket.name == "Alpha",
            alpha_read=Pin(node.outputs["Alpha"], source.groups) in self._reading.alphas_read,
            interpolation=node.interpolation,
            extension=node.extension,
            uv_name=uv_name,
            uv_matrix=tuple(float(v) for v in matrix.ravel()),
        )

    def _coordinates(self, pin, owner):
        """UV map and 3x3 UV transform that feed a texture's Vector socket."""
        source = follow(pin)
        if not source.socket.is_output:
            return None, np.eye(3)
        node = source.node
        if node.bl_idname == "ShaderNodeUVMap":
            return node.uv_map or None, np.eye(3)
        if node.bl_idname == "ShaderNodeTexCoord" and source.socket.name == "UV":
            return None, np.eye(3)
        if node.bl_idname == "ShaderNodeMapping" and node.vector_type in ("POINT", "TEXTURE"):
            name, inner = self._coordinates(source.input("Vector"), owner)
            return name, self._mapping(source, owner) @ inner
        self._notes.add(owner, f"Texture coordinates from {node.bl_label}", "mapped by UV instead")
        return None, np.eye(3)

    def _mapping(self, source, owner):
        node = source.node
        location = self.constant(source.input("Location"), owner, (0.0, 0.0, 0.0))
        rotation = self.constant(source.input("Rotation"), owner, (0.0, 0.0, 0.0))
        scale = self.constant(source.input("Scale"), owner, (1.0, 1.0, 1.0))
        if abs(rotation[0]) + abs(rotation[1]) > 1e-6:
            self._notes.add(owner, "Mapping rotation about X or Y", "ignored")
        cos, sin = math.cos(rotation[2]), math.sin(rotation[2])
        matrix = np.array(
            [
                [cos * scale[0], -sin * scale[1], location[0]],
                [sin * scale[0], cos * scale[1], location[1]],
                [0, 0, 1],
            ]
        )
        if node.vector_type == "POINT":
            return matrix
        if scale[0] * scale[1] == 0:
            self._notes.add(owner, "Mapping with zero scale", "ignored")
            return np.eye(3)
        return np.linalg.inv(matrix)

    def stored(self, image):
        """Cached `stored`; a `RawImage` as it is."""
        if isinstance(image, RawImage):
            return StoredImage(image.pixels)
        key = image.name_full
        if key not in self._stored:
            notes = Notes()
            self._stored[key] = stored(image, notes), notes
        kept, notes = self._stored[key]
        for note in notes:
            self._notes.add(note.object, note.feature, note.effect)
        return kept

    def is_known(self, image):
        """Whether the numbers that Blender gives of an image tell those that Cycles has."""
        if not image.is_float and image.colorspace_settings.name not in ("sRGB", *_LINEAR_SPACES):
            return False
        with self.reading(self._reading, Notes()):  # what is not known will be baked
            return _is_alpha_known(image) or not self.stored(image).associated

    def has_negative(self, value):
        """Whether an `ImageValue` has colors below zero."""
        return value.image.is_float and self.stored(value.image).pixels[..., :3].min() < 0

    def is_above(self, value, limit):
        """Whether a color, or a hundredth of the sum of an image's, lies above a limit."""
        if not isinstance(value, ImageValue):
            return np.max(value) > 1.001 * limit
        scale, offset, brightest = np.array(value.scale), np.array(value.offset), 1.0  # of bytes
        if value.image.is_float:
            brightest = float(self.stored(value.image).pixels.max())
        if brightest <= 1 and np.maximum(offset, scale + offset).max() <= 1.001 * limit:
            return False  # also where it is decoded, or to a power
        color = self._scale(self._linear_color(value), value)
        return np.maximum(color - limit, 0).sum(dtype=float) > 0.01 * np.abs(color).sum(dtype=float)

    def mean_color(self, value):
        """Mean linear color of a value, shape (3,)."""
        if not isinstance(value, ImageValue):
            return np.broadcast_to(np.asarray(value, float), 3)
        color = self._scale(self._linear_color(value), value)
        return np.maximum(color, 0).reshape(-1, 3).mean(0, float)

    @staticmethod
    def _scale(color, value):
        color = np.maximum(color, 0) ** np.float32(value.power)
        return color * np.array(value.scale, np.float32) + np.array(value.offset, np.float32)

    def _linear_color(self, value):
        """The channels of an image that count, [y, x, 3]."""
        kept = self.stored(value.image)
        pixels = kept.numbers
        if pixels.shape[2] == 1:
            return np.repeat(pixels, 3, axis=2)
        if value.alpha:
            return np.repeat(pixels[..., 3:], 3, axis=2)
        color = pixels[..., :3]
        if value.alpha_read and kept.associated:
            color = _divide_alpha(color, pixels[..., 3:])
        if kept.srgb:
            color = decode_srgb(color)
        return (
            np.repeat((color @ LUMINANCE.astype(np.float32))[..., None], 3, axis=2) if value.gray else color
        )

    def _is_linear(self, value):
        """Whether interpolation between the values of texels gives what Cycles has."""
        if isinstance(value.image, RawImage) or value.interpolation == "Closest":
            return True
        if value.interpolation in _SMOOTH or value.power != 1:
            return False
        kept = self.stored(value.image)
        if value.alpha or not (kept.srgb or (kept.associated and value.alpha_read)):
            return True
        pixels = kept.pixels if value.alpha_read else kept.pixels[..., :3]
        return bool((pixels == pixels[0, 0]).all()) and value.extension != "CLIP"

    def build(self, value, gray=False, limit=None):
        """A Mitsuba texture or constant.

        Parameters
        ----------
        value : float, tuple of 3 floats, or ImageValue
        gray : bool
            One channel (luminance of a color), for parameters such as roughness.
        limit : float, optional
            Largest value, e.g. 1 for reflectances.

        Returns
        -------
        float, dict or mitsuba.Texture
            To be placed in a dictionary for `mitsuba.load_dict`.
        """
        if isinstance(value, ImageValue):
            return self._bitmap(value, gray, limit)
        color = np.clip(np.broadcast_to(np.asarray(value, float), 3), 0, limit)
        if gray:
            return float(color @ LUMINANCE)
        return {"type": "rgb", "value": [float(v) for v in color]}

    def _bitmap(self, value, gray, limit):
        import mitsuba as mi

        key = (replace(value, image=None), value.image.name_full, gray, limit)
        if key not in self._cache:
            linear = self._is_linear(value)
            parts, to_uv = self._bitmap_parts(value, gray, limit) if linear else self._picture(value, limit)
            texture = made(parts | {"to_uv": mi.ScalarTransform3f(to_uv)})
            if isinstance(value.image, RawImage):  # which is read once, and then no more
                return texture
            self._cache[key] = texture
        return self._cache[key]

    def _picture(self, value, limit):
        """Arguments of `engine.scene.images` to sample an image as Cycles does, and the 3x3 transform of UVs."""
        import mitsuba as mi

        kept = self.stored(value.image)
        divide = value.alpha_read and kept.associated and not value.alpha
        channels = slice(3, 4) if value.alpha else slice(0, 4 if divide else 3)
        parts = {
            "type": "picture",
            "bitmap": mi.Bitmap(np.ascontiguousarray(kept.pixels[..., channels])),
            "filter_type": "cubic" if value.interpolation in _SMOOTH else "bilinear",
            "wrap_mode": _WRAPS[value.extension],
            "srgb": kept.srgb and not value.alpha,
            "unassociate": divide,
            "gray": value.gray and not value.alpha,
            "power": value.power,
        }
        for channel, scale, offset in zip("rgb", value.scale, value.offset, strict=True):
            parts |= {f"scale_{channel}": scale, f"offset_{channel}": offset}
        if limit is not None:
            parts["limit"] = float(limit)
        return parts, np.array(value.uv_matrix).reshape(3, 3)

    def _bitmap_parts(self, value, gray, limit):
        """Mitsuba's own texture, and the 3x3 transform of UVs."""
        import mitsuba as mi

        color = self._linear_color(value)
        to_uv = np.array(value.uv_matrix).reshape(3, 3)
        if value.extension == "CLIP":
            # a black frame of one pixel, repeated outwards
            height, width = color.shape[:2]
            color = np.pad(color, ((1, 1), (1, 1), (0, 0)))
            x, y = width / (width + 2), height / (height + 2)
            frame = np.array([[x, 0, 1 / (width + 2)], [0, y, 1 / (height + 2)], [0, 0, 1]])
            to_uv = frame @ to_uv
        color = np.clip(self._scale(color, value), 0, limit)
        if gray:
            color = (color @ LUMINANCE.astype(np.float32))[..., None]
        # Mitsuba's v = 0 is the bitmap's first row, Blender's first row is the bottom, where v = 0
        parts = {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(color, np.float32)),
            "raw": True,
            "format": "fp16" if not value.image.is_float and max(value.scale) <= 100 else "variant",
            "filter_type": "nearest" if value.interpolation == "Closest" else "bilinear",
            "wrap_mode": "clamp" if value.extension == "CLIP" else _WRAPS[value.extension],
        }
        return parts, to_uv


def own_mapping(node):
    """Matrix of the Texture Mapping that a texture node has besides its sockets, as Cycles applies it.

    Cycles does not read its Min and Max.

    Parameters
    ----------
    node : bpy.types.ShaderNode

    Returns
    -------
    float [4, 4]
        Of coordinates.
    """
    from mathutils import Euler

    mapping = node.texture_mapping
    axes = np.eye(4)
    for row, axis in enumerate((mapping.mapping_x, mapping.mapping_y, mapping.mapping_z)):
        axes[row] = np.eye(4)["XYZ".index(axis)] if axis != "NONE" else 0
    scale = np.array(mapping.scale)
    if mapping.vector_type in ("TEXTURE", "NORMAL"):
        scale = np.where(np.abs(scale) < 1e-5, np.copysign(1e-5, scale), scale)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(Euler(mapping.rotation, "XYZ").to_matrix()) * scale
    if mapping.vector_type in ("POINT", "TEXTURE"):
        matrix[:3, 3] = mapping.translation
    if mapping.vector_type == "TEXTURE":
        matrix = np.linalg.inv(matrix)
    elif mapping.vector_type == "NORMAL":
        matrix[:3, :3] = np.linalg.inv(matrix[:3, :3]).T
    return matrix @ axes


def _plain(value):
    if isinstance(value, (int, float)):
        return float(np.nan_to_num(value))
    return tuple(float(v) for v in np.nan_to_num(np.array(value, float)))[:3]
