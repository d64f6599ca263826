"""Values of shader sockets: constants, images as Mitsuba bitmaps, or what has been baked of anything else."""

import contextlib
import math
from dataclasses import dataclass, replace

import numpy as np

from ..engine.scene.variants import made
from .baking import ATLAS, COLOUR, EMISSION, NORMAL, NUMBER, Output
from .node_graph import follow, upstream
from .notes import Notes

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
    ("of the mesh in triangles", {"Wireframe", ("NewGeometry", "Parametric")}),
    ("the same for all instances of a mesh", {"ParticleInfo"}),
)
# Of an object, which a stand-in has otherwise.
_PLACE = ("location", "rotation_", "scale", "matrix_", "delta_", "dimensions", "parent")
_CONSTANT = ("ShaderNodeRGB", "ShaderNodeValue")
_LINEAR_SPACES = ("Non-Color", "Raw", "Linear", "Linear Rec.709", "scene_linear")


def stand_in_effect(source):
    """How what comes from an output socket differs in a scene that is made for baking; empty where it does not.

    Parameters
    ----------
    source : Pin

    Returns
    -------
    str
    """
    node = source.node
    kind = node.bl_idname.removeprefix("ShaderNode")
    if kind == "Attribute" and node.attribute_type == "OBJECT" and node.attribute_name.startswith(_PLACE):
        return "the object's location, rotation and scale read as if they were cleared"
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


@dataclass(frozen=True, eq=False)
class RawImage:
    """Pixels of our own, in the place of a Blender image.

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


@dataclass(frozen=True)
class ImageValue:
    """A socket fed by an image.

    Attributes
    ----------
    image : bpy.types.Image or RawImage
    alpha : bool
        Read the alpha channel instead of the colour.
    multiplied : bool
        The colour as Cycles has it where nothing reads the alpha: times alpha, before it is made linear.
    closest : bool
        No interpolation between pixels.
    extension : str
        Blender's ``REPEAT``, ``EXTEND``, ``CLIP`` or ``MIRROR``.
    uv_name : str or None
        UV map; None for the active one.
    uv_matrix : tuple of 9 floats
        Row-major transform of the UVs.
    grey : bool
        The colour's luminance instead of the colour.
    scale : tuple of 3 floats
        Factor on the linear colour.
    offset : tuple of 3 floats
        Added after the factor.
    power : float
        Exponent on the linear colour, before the factor.
    """

    image: object
    alpha: bool = False
    multiplied: bool = False
    closest: bool = False
    extension: str = "REPEAT"
    uv_name: str | None = None
    uv_matrix: tuple = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    grey: bool = False
    scale: tuple = (1.0, 1.0, 1.0)
    offset: tuple = (0.0, 0.0, 0.0)
    power: float = 1.0

    def scaled(self, factor):
        """The same image times a number or a colour."""
        return self._affine(np.asarray(factor, float), 0.0)

    def inverted(self):
        """One minus the image."""
        return self._affine(-1.0, 1.0)

    def _affine(self, factor, offset):
        scale, offset = np.asarray(self.scale) * factor, np.asarray(self.offset) * factor + offset
        return replace(self, scale=tuple(map(float, scale)), offset=tuple(map(float, offset)))


def missing(image, owner, notes):
    """Whether an image is none or cannot be read, which is noted: it is opaque and magenta, as in Cycles.

    Parameters
    ----------
    image : bpy.types.Image or None
    owner : str
        Name for the note where there is none.
    notes : Notes

    Returns
    -------
    bool
    """
    if image is None:
        notes.add(owner, "Image Texture without an image", "shown in magenta")
        return True
    if image.size[0] * image.size[1] == 0 or not image.channels:
        notes.add(image.name, "Image file", "missing: shown in magenta")
        return True
    return False


def linear_pixels(image, notes):
    """Pixels of an image that is not `missing` in linear Rec.709, bottom row first.

    Parameters
    ----------
    image : bpy.types.Image
    notes : Notes

    Returns
    -------
    float32 [y, x, 4]
    """
    width, height = image.size
    if image.source in ("SEQUENCE", "MOVIE"):
        notes.add(image.name, "Image sequence or movie", "only the frame loaded now is used")
    elif image.source == "TILED":
        notes.add(image.name, "UDIM tiles", "only the first tile is used")
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, 4)
    space = image.colorspace_settings.name
    if image.is_float or space in _LINEAR_SPACES:
        return pixels
    if space != "sRGB":
        notes.add(image.name, f"Color Space {space}", "read as sRGB")
    pixels[..., :3] = _decoded(pixels[..., :3])
    return pixels


def _decoded(colour):
    """Linear values of sRGB's (IEC 61966-2-1)."""
    return np.where(colour <= 0.04045, colour / 12.92, ((np.maximum(colour, 0) + 0.055) / 1.055) ** 2.4)


def _encoded(colour):
    """Inverse of `_decoded`."""
    return np.where(colour <= 0.0031308, colour * 12.92, 1.055 * np.maximum(colour, 0) ** (1 / 2.4) - 0.055)


# Stands for what is still to be baked.
PENDING = ImageValue(RawImage("pending", np.ones((1, 1, 3), np.float32)))


class MaterialReading:
    """What one reading of a material needs.

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
    """

    def __init__(self, baked):
        self.baked = baked
        self.wanted = {}
        self.pressing = False
        self.uv_names = set()

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
        self._pixels = {}
        self._built = {}
        self._reading = MaterialReading(None)

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
        """What feeds a socket.

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
        if pictured and missing(node.image, owner, self._notes):
            return 1.0 if source.socket.name == "Alpha" else MAGENTA
        feature = f"{node.bl_label} node into {pin.socket.name}"
        reading = self._reading
        reading.wanted[socket_key(pin)] = Output(pin, NUMBER if pin.socket.type == "VALUE" else COLOUR)
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
        self._reading.wanted[socket_key(pin, kind)] = Output(pin, kind)
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
        self._notes.add(owner, feature, ", ".join(filter(None, dict.fromkeys(effects))))
        return ImageValue(picture, extension="EXTEND", uv_name=ATLAS)

    def _is_direct(self, source):
        """Whether Mitsuba can read an image as it is."""
        node, image = source.node, source.node.image
        return (
            node.projection == "FLAT"
            and image.source not in ("TILED", "MOVIE", "SEQUENCE")
            and (image.is_float or image.colorspace_settings.name in ("sRGB", *_LINEAR_SPACES))
            and self._reads_uv(source.input("Vector"))
        )

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
        return node.bl_idname == "ShaderNodeUVMap" or (
            node.bl_idname == "ShaderNodeTexCoord" and source.socket.name == "UV"
        )

    def constant(self, pin, owner, fallback):
        """Like `value`, for parameters that take no texture; what varies is noted and replaced."""
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
        uv_name, matrix = self._coordinates(source.input("Vector"), owner)
        self._reading.uv_names.add(uv_name)
        return ImageValue(
            node.image,
            alpha=source.socket.name == "Alpha",
            multiplied=not node.outputs["Alpha"].is_linked and node.image.alpha_mode == "STRAIGHT",
            closest=node.interpolation == "Closest",
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

    def pixels(self, image):
        """Cached `linear_pixels`."""
        if isinstance(image, RawImage):
            return image.pixels
        key = image.name_full
        if key not in self._pixels:
            notes = Notes()
            self._pixels[key] = linear_pixels(image, notes), notes
        pixels, notes = self._pixels[key]
        for note in notes:
            self._notes.add(note.object, note.feature, note.effect)
        return pixels

    def has_negative(self, value):
        """Whether an `ImageValue` has colors below zero."""
        return value.image.is_float and self.pixels(value.image)[..., :3].min() < 0

    def mean_colour(self, value):
        """Mean linear colour of a value, shape (3,)."""
        if not isinstance(value, ImageValue):
            return np.broadcast_to(np.asarray(value, float), 3)
        colour = self._scaled(self._linear_colour(value), value)
        return np.maximum(colour, 0).reshape(-1, 3).mean(0, float)

    @staticmethod
    def _scaled(colour, value):
        colour = np.maximum(colour, 0) ** np.float32(value.power)
        return colour * np.array(value.scale, np.float32) + np.array(value.offset, np.float32)

    def _linear_colour(self, value):
        """The channels of an image that count, [y, x, 3]."""
        pixels = self.pixels(value.image)
        if pixels.shape[2] == 1:
            return np.repeat(pixels, 3, axis=2)
        if value.alpha:
            return np.repeat(pixels[..., 3:], 3, axis=2)
        colour = pixels[..., :3]
        if value.multiplied and pixels.shape[2] == 4 and pixels[..., 3].min() < 1:
            if value.image.is_float or value.image.colorspace_settings.name != "sRGB":
                colour = colour * pixels[..., 3:]
            else:
                colour = _decoded(_encoded(colour) * pixels[..., 3:])
        return (
            np.repeat((colour @ LUMINANCE.astype(np.float32))[..., None], 3, axis=2) if value.grey else colour
        )

    def build(self, value, grey=False, limit=None):
        """A Mitsuba texture or constant.

        Parameters
        ----------
        value : float, tuple of 3 floats, or ImageValue
        grey : bool
            One channel (luminance of a colour), for parameters such as roughness.
        limit : float, optional
            Largest value, e.g. 1 for reflectances.

        Returns
        -------
        float, dict or mitsuba.Texture
            To be placed in a dictionary for `mitsuba.load_dict`.
        """
        if isinstance(value, ImageValue):
            return self._bitmap(value, grey, limit)
        colour = np.clip(np.broadcast_to(np.asarray(value, float), 3), 0, limit)
        if grey:
            return float(colour @ LUMINANCE)
        return {"type": "rgb", "value": [float(v) for v in colour]}

    def _bitmap(self, value, grey, limit):
        import mitsuba as mi

        key = (replace(value, image=None), value.image.name_full, grey, limit)
        if key in self._built:
            return self._built[key]
        colour = self._linear_colour(value)
        to_uv = np.array(value.uv_matrix).reshape(3, 3)
        if value.extension == "CLIP":
            # a black frame of one pixel, repeated outwards
            height, width = colour.shape[:2]
            colour = np.pad(colour, ((1, 1), (1, 1), (0, 0)))
            x, y = width / (width + 2), height / (height + 2)
            frame = np.array([[x, 0, 1 / (width + 2)], [0, y, 1 / (height + 2)], [0, 0, 1]])
            to_uv = frame @ to_uv
        colour = np.clip(self._scaled(colour, value), 0, limit)
        if grey:
            colour = (colour @ LUMINANCE.astype(np.float32))[..., None]
        wrap = {"REPEAT": "repeat", "MIRROR": "mirror"}.get(value.extension, "clamp")
        # Mitsuba's v = 0 is the bitmap's first row, Blender's first row is the bottom, where v = 0
        texture = made(
            {
                "type": "bitmap",
                "bitmap": mi.Bitmap(np.ascontiguousarray(colour, np.float32)),
                "raw": True,
                "format": "fp16" if not value.image.is_float and max(value.scale) <= 100 else "variant",
                "filter_type": "nearest" if value.closest else "bilinear",
                "wrap_mode": wrap,
                "to_uv": mi.ScalarTransform3f(to_uv),
            }
        )
        if not isinstance(value.image, RawImage):  # which is read once, and then no more
            self._built[key] = texture
        return texture


def _plain(value):
    if isinstance(value, (int, float)):
        return float(np.nan_to_num(value))
    return tuple(float(v) for v in np.nan_to_num(np.array(value, float)))[:3]
