"""Digests of all that decides the light on a scene's surfaces, by which baked light is kept and found again.

A part of a scene is known by its type, by its numbers and nested parts, as Mitsuba's traversal gives them, and by
its description, which names choices and flags. Bitmaps and perturbed normals tell some of theirs nowhere: they are
known by how they answer. Types of which it is not known that they tell all have another digest each time: then the
light is baked anew, and never taken from another scene.
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

# types that tell all, or of which `_Digests` finds out the rest
SHAPES = """ShapeGroupPlugin Instance Mesh PLYMesh OBJMesh SerializedMesh Cube Rectangle Sphere Disk Cylinder
    BSplineCurve LinearCurve"""
BSDFS = """SmoothDiffuse SmoothPlastic RoughPlastic SmoothConductor RoughConductor SmoothDielectric ThinDielectric
    RoughDielectric Principled PrincipledThin TwoSidedBRDF MaskBSDF BlendBSDF NormalMap BumpMap Null"""
TEXTURES = """UniformSpectrum SRGBReflectanceSpectrum RawConstantTexture BlackBodySpectrum Checkerboard MeshAttribute
    BitmapTextureImpl"""
EMITTERS = """AreaLight DirectionalArea PointLight SpotLight DirectionalEmitter ConstantBackgroundEmitter
    EnvironmentMapEmitter"""
KNOWN = frozenset(f"{SHAPES} {BSDFS} {TEXTURES} {EMITTERS}".split())
MEAN = re.compile(r"\n *mean = \S+")  # of a bitmap, in its description: as a parallel sum came out
PROBES = 1024  # places on a surface with perturbed normals, and directions


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
    """What a plugin is told, but for nested parts, which are traversed, as text from which no bit is lost.

    Parameters
    ----------
    props : mitsuba.Properties

    Returns
    -------
    str
    """
    props = mi.Properties(props)  # a copy: those that the plugin never reads stay known as misspelt
    # pyrefly: ignore[missing-attribute]  # missing from Mitsuba's stubs
    spectrum, nested = mi.Properties.Type.Spectrum, mi.BSDF | mi.Texture
    values = {name: props[name] for name in sorted(props.keys()) if props.type(name) != spectrum}
    return ", ".join(f"{name}={_exact(v)}" for name, v in values.items() if not isinstance(v, nested))


class _Digests:
    """Digests of a scene's parts, each found once.

    Parameters
    ----------
    scene : mitsuba.Scene
    """

    def __init__(self, scene):
        self._scene, self._found = scene, {}

    def shapes(self):
        """In the order of the scene."""
        groups = [part for _, part in _contents(self._scene) if _type(part) == "ShapeGroupPlugin"]
        names = [group.id() for group in groups]
        try:
            for group in groups:
                group.set_id(self._of(group))  # an instance tells nothing of its group but the name
            return [self._of(shape) for shape in self._scene.shapes()]
        finally:
            for group, name in zip(groups, names, strict=True):
                group.set_id(name)

    def light(self):
        """Of all emitters that are no shapes."""
        return _hashed(sorted(self._of(e) for e in self._scene.emitters() if e.get_shape() is None))

    def _of(self, part):
        if part not in self._found:
            self._found[part] = _hashed(self._traits(part))
        return self._found[part]

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
        # other shapes and emitters describe only what is traversed, and what follows from that and from other parts
        if isinstance(part, mi.BSDF | mi.Texture) or kind == "Instance" or ours:
            yield MEAN.sub("", str(part))
        if kind == "BitmapTextureImpl":
            yield _looked_up(part, **dict(contents))
        if kind in ("NormalMap", "BumpMap"):
            yield _flags(part, **dict(contents))
        untold = kind == "Rectangle" and part.has_mesh_attributes()  # which its traversal leaves out
        if untold or not (ours or kind in KNOWN):
            yield secrets.token_hex()


def _type(part):
    """Mitsuba's name of the type of a part, "" of what is none."""
    return part.class_name().partition("[")[0] if isinstance(part, mi.Object) else ""


def _contents(part) -> list[tuple[str, Any]]:
    """Names of a part's nested parts and values, and these."""
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
    """A value as text: long arrays by their digest."""
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)
    # not hasattr(value, "matrix"): to a vector of Dr.Jit's every name is a swizzle
    array = np.ascontiguousarray(value.matrix if "Transform" in type(value).__name__ else value)
    if array.dtype == object:
        return secrets.token_hex()
    if array.size <= 16:
        return repr(array.tolist())
    return f"{array.dtype.str}{array.shape} {blake2b(array, digest_size=16).hexdigest()}"


def _looked_up(texture, data, to_uv):
    """Values of a bitmap, given its texels, that differ wherever its filter or its wrap mode makes a difference."""
    texels = np.asarray(data)
    height, width = texels.shape[:2]
    places = []
    for other in (np.broadcast_to(texels[:1, :1], texels.shape), texels[:, ::-1], texels[::-1]):
        x, y = _difference(texels, other)
        # between texels, and where repeated, mirrored and clamped ones lie
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
    """First texel (x, y) in which two images differ, the corner if they do not."""
    for y, (row, others) in enumerate(zip(image, other, strict=True)):
        columns = np.flatnonzero(((row != others) & ~np.isnan(row)).any(-1))
        if len(columns):
            return columns[0], y
    return 0, 0


def _flags(bsdf, nested_bsdf, **parts):
    """Flags of a surface of perturbed normals: those with which the same parts answer as it does, bit by bit.

    What it answers itself differs in its last digits between processors, and the digest must not.
    """
    kind = _type(bsdf).lower()
    answer = _scattered(bsdf)
    for flip, shadow in product((True, False), repeat=2):
        flags = {"flip_invalid_normals": flip, "use_shadowing_function": shadow}
        twin = mi.load_dict({"type": kind, "nested_bsdf": nested_bsdf, **parts, **flags})
        if np.array_equal(_scattered(twin), answer, equal_nan=True):
            return repr(flags)
    return secrets.token_hex()


def _scattered(bsdf):
    """What a surface of perturbed normals does with light from all sides, much of it grazing."""
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
