"""Blender materials to Mitsuba BSDFs and emission.

Roughness conventions: Mitsuba's `principled` squares its roughness itself, as Blender does; its
`roughconductor` and `roughdielectric` take alpha = roughness squared.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from .node_graph import Pin, first_link, follow, output_node
from .notes import Notes
from .textures import LUMINANCE, ImageValue, Reading

# Below this roughness a glass, mirror or polished surface is exported as perfectly smooth.
SMOOTH = 0.02
# The same of a coat, so that Blender's default coat roughness of 0.03 is smooth.
SMOOTH_COAT = 0.035

_BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
_CLEAR = {"type": "null"}

# Principled inputs that are not carried over: (name, value that has no effect)
_PRINCIPLED_IGNORED = (
    ("Subsurface Weight", 0.0),
    ("Sheen Weight", 0.0),
    ("Anisotropic", 0.0),
    ("Thin Film Thickness", 0.0),
    ("Diffuse Roughness", 0.0),
    ("Thin Wall", False),
    ("Specular Tint", (1.0, 1.0, 1.0)),
)


@dataclass
class Look:
    """What a shader node amounts to.

    Attributes
    ----------
    bsdf : dict or None
        Mitsuba BSDF; None reflects nothing.
    emission : number, colour, ImageValue or None
        Emitted radiance.
    transmissive : bool
        Whether light passes through: then the BSDF serves both sides, else the front only.
    smooth : bool
        Whether it mirrors or lets through so sharply that lamps would be seen in it.
    """

    bsdf: dict | None = None
    emission: object = None
    transmissive: bool = False
    smooth: bool = False

    @property
    def both_sides(self):
        """BSDF that serves both sides of a surface."""
        bsdf = self.bsdf or _BLACK
        return bsdf if self.transmissive else {"type": "twosided", "bsdf": bsdf}


@dataclass
class ExportedMaterial:
    """A material ready for meshes.

    Attributes
    ----------
    name : str
    bsdf : mitsuba.BSDF
    emission : number, colour, ImageValue or None
        Radiance, None where nothing is emitted.
    uv_name : str or None
        UV map its textures read: None for the active one, "" if it reads none.
    smooth : bool
        See `Look`.
    notes : Notes
        What was approximated or left out.
    wanted : dict
        `baking.Output` of every socket to be baked on each object first, by `textures.socket_key`; empty where the
        material can be used as it is.
    """

    name: str
    bsdf: object
    emission: object
    uv_name: str | None
    smooth: bool
    notes: Notes
    wanted: dict


class Materials:
    """Exports each material once.

    Parameters
    ----------
    textures : Textures
    """

    def __init__(self, textures):
        self._textures = textures
        self._exported = {}

    def get(self, material, can_bake=True):
        """Export a material.

        Parameters
        ----------
        material : bpy.types.Material or None
            None is Blender's default surface, a white of 80 %.
        can_bake : bool
            False replaces by constants what would have to be baked.

        Returns
        -------
        ExportedMaterial
        """
        key = None if material is None else material.name_full, can_bake
        if key not in self._exported:
            self._exported[key] = self._export(material, Reading({} if can_bake else None))
        return self._exported[key]

    def baked(self, material, pictures):
        """Export a material whose varying sockets have been baked on one object.

        Parameters
        ----------
        material : bpy.types.Material
        pictures : dict of textures.Picture
            By `textures.socket_key`, as `ExportedMaterial.wanted` asks for.

        Returns
        -------
        ExportedMaterial
        """
        return self._export(material, Reading(pictures))

    def _export(self, material, reading):
        import mitsuba as mi

        name = "default material" if material is None else material.name
        notes = Notes(name)
        with self._textures.reading(reading, notes):
            look, uv_names = read_material(material, self._textures, notes)
            if look.emission is not None and not np.any(self._textures.mean_colour(look.emission) > 0):
                look.emission = None
            if isinstance(look.emission, ImageValue):
                uv_names.append(look.emission.uv_name)
        if reading.incomplete:
            bsdf = mi.load_dict(_BLACK)
            return ExportedMaterial(name, bsdf, None, "", False, Notes(), reading.wanted)
        distinct = list(dict.fromkeys(uv_names))
        if len(distinct) > 1:
            notes.add(name, "Several UV maps in one material", f"all use {distinct[0] or 'the active one'}")
        uv_name = distinct[0] if distinct else ""
        bsdf = mi.load_dict(look.both_sides)
        return ExportedMaterial(name, bsdf, look.emission, uv_name, look.smooth, notes, {})

    def emitter(self, material, share):
        """A new area emitter with a material's emission, for one mesh.

        Parameters
        ----------
        material : ExportedMaterial
        share : float
            Relative share of the light samples.

        Returns
        -------
        mitsuba.Emitter
        """
        import mitsuba as mi

        radiance = self._textures.build(material.emission)
        return mi.load_dict({"type": "area", "radiance": radiance, "sampling_weight": share})


def read_material(material, textures, notes):
    """Read a material's nodes.

    Parameters
    ----------
    material : bpy.types.Material or None
    textures : Textures
    notes : Notes

    Returns
    -------
    look : Look
    uv_names : list of (str or None)
        UV maps that its BSDF reads, see `ExportedMaterial`.
    """
    uv_names = []
    if material is None:
        reader = _ShaderReader("default material", None, textures, notes, uv_names)
        return Look(reader.diffuse((0.8, 0.8, 0.8))), uv_names
    return _ShaderReader(material.name, material, textures, notes, uv_names).read(), uv_names


class _ShaderReader:
    """Turns one material's node tree into a `Look`."""

    def __init__(self, name, material, textures, notes, uv_names):
        self._name = name
        self._material = material
        self._textures = textures
        self._notes = notes
        self._uv_names = uv_names
        settings = getattr(material, "holopath", None)  # there once the properties are registered
        self._abbe = settings.abbe_number if settings else 0.0
        self._disperses = False
        self._normal = None  # what feeds the Normal sockets: a pin, or None

    # -- the material

    def read(self):
        tree = self._material.node_tree
        if tree is None or not _uses_nodes(self._material):
            return self._viewport_look()
        output = output_node(tree)
        if output is None:
            self._note("Material Output", "missing: rendered black, as in Blender")
            return Look()
        if output.inputs["Volume"].is_linked:
            self._note("Volume", "ignored")
        look = self._linked_shader(Pin(output.inputs["Surface"]))
        if look.bsdf is not None:
            look = self._perturbed(look, output)
        if self._abbe and not self._disperses:
            self._note("Abbe number", "ignored: only smooth glass disperses")
        return look

    def _perturbed(self, look, output):
        """A look under the normals of its bump and normal maps, and of its displacement."""
        displaced = first_link(output.inputs["Displacement"]) is not None
        if displaced and self._material.displacement_method != "BUMP":
            self._note("Displacement", "shown as bumps: the surface is not moved")
        if self._normal is None and not displaced:
            return look
        normals = self._textures.normal(self._normal, self._name)
        if normals is None:
            return look
        bumpy = {"type": "normalmap", "normalmap": self._build(normals), "bsdf": look.bsdf or _BLACK}
        return replace(look, bsdf=bumpy)

    def _viewport_look(self):
        """Materials without nodes: what the viewport shows, which Cycles renders too."""
        material = self._material
        colour = tuple(material.diffuse_color)[:3]
        return self._opaque(colour, material.metallic, material.roughness, _f0(1.5))

    def _shader(self, source):
        node = source.node
        reader = (
            None if node.mute else getattr(self, "_read_" + node.bl_idname.removeprefix("ShaderNode"), None)
        )
        if reader is None:
            self._note(f"{node.bl_label} node", "not supported: shown as the material's viewport colour")
            return self._fallback()
        return reader(source)

    def _fallback(self):
        return Look(self.diffuse(tuple(self._material.diffuse_color)[:3]))

    def _linked_shader(self, pin):
        source = follow(pin)
        return self._shader(source) if source.socket.is_output else Look()

    # -- shader nodes

    def _read_BsdfPrincipled(self, node):
        base = self._colour(node, "Base Color")
        metallic = self._number(node, "Metallic", 0.0)
        roughness = self._number(node, "Roughness", 0.5)
        transmission = self._number(node, "Transmission Weight", 0.0)
        ior = self._constant(node, "IOR", 1.5)
        level = self._constant(node, "Specular IOR Level", 0.5)
        for name, neutral in _PRINCIPLED_IGNORED:
            if self._deviates(node, name, neutral):
                self._note(f"Principled {name}", "ignored")
        self._note_normals(node, "Normal", "Tangent")
        f0 = 2 * level * _f0(ior)
        if transmission == 0 or metallic == 1:
            look = self._opaque(base, metallic, roughness, f0)
        else:
            if level != 0.5:
                self._note("Principled Specular IOR Level", "ignored where light is transmitted")
            # Blender's Principled tints by the square root at each of two surfaces, and no reflections
            glass = self._glass(_square_root(base), (1.0, 1.0, 1.0), roughness, ior)
            look = self._blend(self._opaque(base, 0.0, roughness, f0), glass, transmission)
            look = self._blend(look, self._opaque(base, 1.0, roughness, f0), metallic)
        look.emission = self._emission(node, "Emission Color", "Emission Strength")
        coat = self._number(node, "Coat Weight", 0.0)
        if coat != 0:
            look = self._coated(look, node, coat)
        return self._blend(_clear(), look, self._number(node, "Alpha", 1.0))

    def _opaque(self, base, metallic, roughness, f0):
        """What a Principled BSDF reflects where it transmits nothing."""
        smooth = _at_most(roughness, 0.15) and metallic != 0
        if not _at_most(roughness, SMOOTH):
            if not isinstance(metallic, ImageValue):
                # Blender takes from the diffuse layer what the gloss over it reflects, Mitsuba does not
                base = _times(base, 1 - (1 - metallic) * min(f0, 1)) or (0.0, 0.0, 0.0)
            return Look(self._principled_bsdf(base, metallic, roughness, _eta(f0)), smooth=smooth)
        polished = Look(self.diffuse(base))
        if f0 > 0:
            polished = self._under_gloss(polished, _eta(f0))
        return self._blend(polished, Look(self._mirror(base, 0.0), smooth=True), metallic)

    def _coated(self, look, node, weight):
        """A Principled BSDF's coat over the rest of it."""
        import drjit as dr
        import mitsuba as mi

        if self._deviates(node, "Coat Tint", (1.0, 1.0, 1.0)):
            self._note("Principled Coat Tint", "ignored")
        self._note_normals(node, "Coat Normal")
        ior = self._constant(node, "Coat IOR", 1.5)
        roughness = self._constant(node, "Coat Roughness", 0.03)
        coated = self._under_gloss(look, ior, weight, 0.0 if roughness < SMOOTH_COAT else roughness)
        reflected = dr.slice(mi.fresnel_diffuse_reflectance(ior))
        kept = _rest(weight.scaled(reflected) if isinstance(weight, ImageValue) else weight * reflected)
        return replace(coated, emission=self._product(look.emission, kept))

    def _under_gloss(self, look, ior, weight=1.0, roughness=0.0):
        """A look below the surface of a clear dielectric, where that is present with a weight."""
        bsdf = self._mixture(look, Look(self._mirror((1.0, 1.0, 1.0), roughness)), weight)
        bsdf["int_ior"] = ior
        return replace(look, bsdf=bsdf, smooth=look.smooth or roughness <= 0.15)

    def _read_BsdfDiffuse(self, node):
        if self._constant(node, "Roughness", 0.0) > 0:
            self._note("Diffuse BSDF Roughness", "ignored")
        self._note_normals(node, "Normal")
        return Look(self.diffuse(self._colour(node, "Color")))

    def _read_Emission(self, node):
        return Look(emission=self._emission(node, "Color", "Strength"))

    def _read_BsdfGlass(self, node):
        self._note_normals(node, "Normal")
        colour = self._colour(node, "Color")
        return self._glass(
            colour, colour, self._number(node, "Roughness", 0.0), self._constant(node, "IOR", 1.5)
        )

    def _read_BsdfAnisotropic(self, node):
        """The Glossy BSDF: a mirror of the given colour, without Fresnel."""
        if self._constant(node, "Anisotropy", 0.0) != 0:
            self._note("Glossy BSDF Anisotropy", "ignored")
        self._note_normals(node, "Normal", "Tangent")
        roughness = self._constant(node, "Roughness", 0.5)
        return Look(self._mirror(self._colour(node, "Color"), roughness), smooth=roughness <= 0.15)

    _read_BsdfGlossy = _read_BsdfAnisotropic

    def _read_BsdfTransparent(self, node):
        colour = self._colour(node, "Color")
        if isinstance(colour, ImageValue) or len(set(colour)) > 1:
            self._note("Transparent BSDF Color", "replaced by a grey")
        return self._blend(Look(_BLACK), _clear(), self._grey(colour))

    def _read_AddShader(self, node):
        first, second = (self._linked_shader(Pin(socket, node.groups)) for socket in node.node.inputs)
        if first.bsdf and second.bsdf:
            self._note("Add Shader of two reflecting or transparent shaders", "only one is used")
        used = first if first.bsdf and not (second.bsdf and first.bsdf is _CLEAR) else second
        return replace(used, emission=self._sum(first.emission, second.emission))

    def _read_MixShader(self, node):
        factor, first, second = (Pin(socket, node.groups) for socket in node.node.inputs)
        weight = self._grey(self._textures.value(factor, self._name, 0.5))
        return self._blend(self._linked_shader(first), self._linked_shader(second), weight)

    def _blend(self, first, second, weight):
        """Mix of two looks.

        Parameters
        ----------
        first, second : Look
        weight : float or ImageValue
            Share of the second.

        Returns
        -------
        Look
        """
        if not isinstance(weight, ImageValue):
            weight = min(max(weight, 0.0), 1.0)
            if weight in (0, 1):
                return second if weight else first
        mixed = Look(
            emission=self._sum(
                self._product(first.emission, _rest(weight)), self._product(second.emission, weight)
            ),
            transmissive=first.transmissive or second.transmissive,
            smooth=first.smooth or second.smooth,
        )
        if first.bsdf or second.bsdf:
            mixed.bsdf = self._mixture(first, second, weight)
        return mixed

    def _mixture(self, first, second, weight):
        """BSDF of two looks, see `engine.mixture`."""
        through = first.transmissive or second.transmissive
        parts = [look.both_sides if through else look.bsdf or _BLACK for look in (first, second)]
        weight = self._build(weight, grey=True, limit=1)
        return {"type": "mixture", "weight": weight, "first": parts[0], "second": parts[1]}

    # -- BSDFs

    def diffuse(self, colour):
        """A diffuse BSDF."""
        return {"type": "diffuse", "reflectance": self._build(colour, limit=1)}

    def _principled_bsdf(self, base, metallic, roughness, eta):
        return {
            "type": "principled",
            "base_color": self._build(base, limit=1),
            "roughness": self._build(roughness, grey=True, limit=1),
            "metallic": self._build(metallic, grey=True, limit=1),
            "eta": max(eta, 1.001),
        }

    def _mirror(self, colour, roughness):
        common = {"material": "none", "specular_reflectance": self._build(colour, limit=1)}
        if roughness < SMOOTH:
            return {"type": "conductor", **common}
        return {"type": "roughconductor", "distribution": "ggx", "alpha": roughness**2, **common}

    def _glass(self, transmittance, reflectance, roughness, ior):
        common = {
            "int_ior": float(ior),
            "ext_ior": 1.0,
            "specular_transmittance": self._build(transmittance, limit=1),
            "specular_reflectance": self._build(reflectance, limit=1),
        }
        if isinstance(roughness, ImageValue):
            self._note("Texture on the roughness of glass", "replaced by its mean")
            roughness = float(self._textures.mean_colour(roughness).mean())
        if abs(ior - 1) < 1e-4:
            common["int_ior"] = 1.0001
        if roughness >= SMOOTH:
            rough = {"type": "roughdielectric", "distribution": "ggx", "alpha": roughness**2, **common}
            return Look(rough, transmissive=True, smooth=roughness <= 0.15)
        if self._abbe:
            self._disperses = True
            common["abbe"] = self._abbe
        kind = "dispersive_dielectric" if self._abbe else "dielectric"
        return Look({"type": kind, **common}, transmissive=True, smooth=True)

    # -- values

    def _colour(self, node, name):
        return self._textured(node, name, tuple(self._material.diffuse_color)[:3])

    def _number(self, node, name, default):
        return self._grey(self._textured(node, name, default))

    @staticmethod
    def _grey(value):
        """As Cycles reads a number from a colour: its luminance."""
        if isinstance(value, ImageValue):
            return replace(value, grey=True)
        return float(np.dot(value, LUMINANCE) if np.ndim(value) else value)

    @staticmethod
    def _deviates(node, name, neutral):
        """Whether an input differs from the value that has no effect."""
        pin = node.input(name)
        if pin is None:
            return False
        source = follow(pin)
        return source.socket.is_output or not np.allclose(
            _first(source.socket.default_value, neutral), neutral
        )

    def _textured(self, node, name, fallback):
        return self._textures.value(node.input(name), self._name, fallback)

    def _constant(self, node, name, default):
        return float(np.mean(self._textures.constant(node.input(name), self._name, default)))

    def _emission(self, node, colour_name, strength_name):
        strength = self._textures.value(node.input(strength_name), self._name, 1.0)
        if isinstance(strength, ImageValue):
            colour = self._textures.constant(node.input(colour_name), self._name, (1.0, 1.0, 1.0))
            return self._grey(strength).scaled(colour)
        strength = float(np.mean(strength))
        if strength == 0:
            return None
        if strength < 0:
            self._note("Negative emission", "ignored")
            return None
        return _times(self._textures.value(node.input(colour_name), self._name, (1.0, 1.0, 1.0)), strength)

    def _product(self, value, weight):
        """A value, or none, times a number or an image."""
        if value is None or not isinstance(weight, ImageValue):
            return _times(value, weight)
        if not isinstance(value, ImageValue):
            return weight.scaled(value)
        self._note("Textured emission mixed by a texture", "mixed by the texture's mean")
        return _times(value, float(self._textures.mean_colour(weight).mean()))

    def _sum(self, first, second):
        if first is None or second is None:
            return second if first is None else first
        if isinstance(first, ImageValue) or isinstance(second, ImageValue):
            self._note("Sum of textured emissions", "only one is used")
            return first if isinstance(first, ImageValue) else second
        return tuple(np.broadcast_to(first, 3) + np.broadcast_to(second, 3))

    def _build(self, value, grey=False, limit=None):
        if isinstance(value, ImageValue):
            self._uv_names.append(value.uv_name)
        return self._textures.build(value, grey, limit)

    def _note(self, feature, effect):
        self._notes.add(self._name, feature, effect)

    def _note_normals(self, node, *names):
        """Remember what feeds a shader's normal; all of a material share one."""
        for name in names:
            pin = node.input(name)
            if pin is None or not follow(pin).socket.is_output:
                continue
            if name != "Normal":
                self._note(f"{name} input", "ignored")
            elif self._normal is None:
                self._normal = pin
            elif follow(pin).socket != follow(self._normal).socket:
                self._note("Several bump or normal maps in one material", "only one is used")


def _uses_nodes(material):
    import bpy

    return bpy.app.version >= (5, 0, 0) or material.use_nodes  # always true, and deprecated, since 5.0


def _times(value, factor):
    if value is None or factor == 0:
        return None
    if isinstance(value, ImageValue):
        return value.scaled(factor)
    return tuple(float(v) * factor for v in np.broadcast_to(value, 3))


def _rest(weight):
    """One minus a weight."""
    return weight.inverted() if isinstance(weight, ImageValue) else 1 - weight


def _clear():
    """Look of a surface that is not there."""
    return Look(_CLEAR, transmissive=True, smooth=True)


def _f0(ior):
    return ((ior - 1) / (ior + 1)) ** 2


def _square_root(value):
    if isinstance(value, ImageValue):
        return replace(value, power=0.5 * value.power, scale=tuple(math.sqrt(v) for v in value.scale))
    return tuple(math.sqrt(max(v, 0.0)) for v in np.broadcast_to(value, 3))


def _eta(f0):
    root = math.sqrt(min(max(f0, 0.0), 0.98))
    return (1 + root) / (1 - root)


def _at_most(value, limit):
    return not isinstance(value, ImageValue) and value <= limit


def _first(value, like):
    return np.asarray(tuple(value)[:3]) if isinstance(like, tuple) else value
