"""Digests of every input that affects the light on a scene's surfaces, by which baked light is stored and found.

The digest of a part contains its type, the values and nested parts that Mitsuba's traversal returns, and its
description, which has choices and flags. Bitmaps and perturbed normals hide some of theirs: their results count.
Types not known to expose everything get a new digest each time: their light is always baked again, and never taken
from another scene.
"""

from __future__ import annotations

import re
import secrets
from hashlib import blake2b
from itertools import product
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .lobes import held_by

# Types that expose all their inputs, or whose other inputs `_Digests` determines.
SHAPES = """ShapeGroupPlugin Instance Mesh PLYMesh OBJMesh SerializedMesh Cube Rectangle Sphere Disk Cylinder
    BSplineCurve LinearCurve"""
BSDFS = """SmoothDiffuse SmoothPlastic RoughPlastic SmoothConductor RoughConductor SmoothDielectric ThinDielectric
    RoughDielectric Principled PrincipledThin TwoSidedBRDF MaskBSDF BlendBSDF NormalMap BumpMap Null"""
TEXTURES = """UniformSpectrum SRGBReflectanceSpectrum RawConstantTexture BlackBodySpectrum Checkerboard MeshAttribute
    BitmapTextureImpl"""
EMITTERS = """AreaLight DirectionalArea PointLight SpotLight DirectionalEmitter ConstantBackgroundEmitter
    EnvironmentMapEmitter"""
KNOWN = frozenset(f"{SHAPES} {BSDFS} {TEXTURES} {EMITTERS}".split())
MEAN = re.compile(
    r"\n *mean = \S+"
)  # of a bitmap, in its description: depends on the order of a parallel sum
PROBES = 1024  # samples of places and directions on a surface with perturbed normals


def scene_digest(scene: mi.Scene) -> str:
    """Digest of a scene's shapes and their materials, whatever their order, and of its lights.

    Parameters
    ----------
    scene : mitsuba.Scene

    Returns
    -------
    str
        Hexadecimal.
    """
    digests = _Digests(scene)
    return _hashed([*sorted(digests.shapes()), digests.light()])


def text_of_properties(props: mi.Properties) -> str:
    """Text of a plugin's properties, exact to the last bit; nested parts are left out, as they are traversed.

    Parameters
    ----------
    props : mitsuba.Properties

    Returns
    -------
    str
    """
    props = mi.Properties(
        props
    )  # a copy: Mitsuba reports properties that the plugin never reads as misspelled
    # pyrefly: ignore[missing-attribute]  # missing from Mitsuba's stubs
    spectrum, nested = mi.Properties.Type.Spectrum, mi.BSDF | mi.Texture
    values = {name: props[name] for name in sorted(props.keys()) if props.type(name) != spectrum}
    return ", ".join(f"{name}={_exact(v)}" for name, v in values.items() if not isinstance(v, nested))


class _Digests:
    """Digests of a scene's parts, each computed once.

    Parameters
    ----------
    scene : mitsuba.Scene
    """

    def __init__(self, scene):
        self._scene, self._known = scene, {}

    def shapes(self):
        """Digests of all shapes in the order of the scene."""
        groups = [part for _, part in _contents(self._scene) if _type(part) == "ShapeGroupPlugin"]
        names = [group.id() for group in groups]
        try:
            for group in groups:
                group.set_id(self._of(group))  # an instance exposes only the name of its group
            return [self._of(shape) for shape in self._scene.shapes()]
        finally:
            for group, name in zip(groups, names, strict=True):
                group.set_id(name)

    def light(self):
        """Digest of all emitters that are no shapes."""
        return _hashed(sorted(self._of(e) for e in self._scene.emitters() if e.get_shape() is None))

    def _of(self, part):
        if part not in self._known:
            self._known[part] = _hashed(self._traits(part))
        return self._known[part]

    def _traits(self, part):
        kind, contents = _type(part), _contents(part)
        ours = type(part).__module__.startswith(__package__)
        yield kind
        for name, value in contents:
            if isinstance(value, mi.Shape):
                yield self._of(value)
            elif not isinstance(value, mi.Sensor):
                yield f"{name}: {self._of(value) if isinstance(value, mi.Object) else _exact(value)}"
        if isinstance(part, mi.Shape):
            yield f"flipped: {part.has_flipped_normals()}"
        if isinstance(part, mi.Mesh):
            yield f"flat: {part.has_face_normals()}"
        # descriptions of other shapes and emitters add nothing to their traversal and to other parts
        if isinstance(part, mi.BSDF | mi.Texture) or kind == "Instance" or ours:
            yield MEAN.sub("", str(part))
        if kind == "BitmapTextureImpl":
            yield _looked_up(part, **dict(contents))
        if kind in ("NormalMap", "BumpMap"):
            yield _flags(part, **dict(contents))
        hidden = kind == "Rectangle" and part.has_mesh_attributes()  # missing from its traversal
        if hidden or not (ours or kind in KNOWN):
            yield secrets.token_hex()


def _type(part):
    """Mitsuba's name of a part's type; empty for other values."""
    return part.class_name().partition("[")[0] if isinstance(part, mi.Object) else ""


def _contents(part) -> list[tuple[str, Any]]:
    """Names and values of a part's nested parts and parameters."""
    return [
        (name, value if kind is None else mi.get_property(value, kind, part))
        for name, value, kind in held_by(part)
    ]


def _hashed(texts):
    digest = blake2b(str(mi.__version__).encode(), digest_size=16)
    for text in texts:
        digest.update(f"{len(text)} {text}\n".encode())
    return digest.hexdigest()


def _exact(value):
    """Text of a value; that of long arrays is their digest."""
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)
    # not hasattr(value, "matrix"): for a Dr.Jit vector every name is a swizzle
    array = np.ascontiguousarray(value.matrix if "Transform" in type(value).__name__ else value)
    if array.dtype == object:
        return secrets.token_hex()
    if array.size <= 16:
        return repr(array.tolist())
    return f"{array.dtype.str}{array.shape} {blake2b(array, digest_size=16).hexdigest()}"


def _looked_up(texture, data, to_uv):
    """Values of a bitmap at places where every filter and wrap mode gives another one, if its texels differ at all."""
    texels = np.asarray(data)
    height, width = texels.shape[:2]
    places = []
    for other in (np.broadcast_to(texels[:1, :1], texels.shape), texels[:, ::-1], texels[::-1]):
        x, y = _difference(texels, other)
        # between texels, and beyond the edges, for repeated, mirrored and clamped ones
        places += [(x - 0.3 * (x > 0), y - 0.3 * (y > 0)), (-1 - x, y), (x, -1 - y), (-1 - x, -1 - y)]
        places += [(x - width, y - height)]
    size, matrix = np.array([width, height]), np.array(to_uv.matrix)
    towards, origin = matrix[:2, :2], matrix[:2, 2]
    uv = ((np.array(places) + 0.5) / size - origin) @ np.linalg.pinv(towards).T
    uv = uv.astype(np.float32)
    if not np.allclose(
        (uv @ towards.astype(np.float32).T + origin.astype(np.float32)) * size - 0.5, places, atol=0.2
    ):
        return secrets.token_hex()
    si = dr.zeros(mi.SurfaceInteraction3f, len(uv))
    si.uv = mi.Point2f(uv.T)
    return _exact(texture.eval(si))


def _difference(image, other):
    """First texel (x, y) in which two images differ, or the corner."""
    for y, (row, others) in enumerate(zip(image, other, strict=True)):
        columns = np.flatnonzero(((row != others) & ~np.isnan(row)).any(-1))
        if len(columns):
            return columns[0], y
    return 0, 0


def _flags(bsdf, nested_bsdf, **parts):
    """Flags of a surface with perturbed normals: those with which the same parts scatter the same, bit by bit.

    Its own results differ in their last digits between processors, and the digest must not.
    """
    kind = _type(bsdf).lower()
    result = _scattered(bsdf)
    for flip, shadow in product((True, False), repeat=2):
        flags = {"flip_invalid_normals": flip, "use_shadowing_function": shadow}
        twin = mi.load_dict({"type": kind, "nested_bsdf": nested_bsdf, **parts, **flags})
        if np.array_equal(_scattered(twin), result, equal_nan=True):
            return repr(flags)
    return secrets.token_hex()


def _scattered(bsdf):
    """Directions and values of light that a surface scatters, from all sides, much of it grazing."""
    number = np.random.default_rng(0).random((8, PROBES), np.float32)
    cosine = np.copysign(10 ** (-4 * number[0]), number[1] - 0.5)
    sine, azimuth = np.sqrt(1 - cosine**2), 2 * np.pi * number[2]
    si = dr.zeros(mi.SurfaceInteraction3f, PROBES)
    si.wi = mi.Vector3f(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine)
    si.uv, si.dp_du, si.dp_dv = mi.Point2f(number[3:5]), mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    si.n = si.sh_frame.n = mi.Normal3f(0, 0, 1)
    si.initialize_sh_frame()
    sample, value = bsdf.sample(mi.BSDFContext(), si, mi.Float(number[5]), mi.Point2f(number[6:]))
    return np.vstack([sample.wo, value])
