"""Blender materials to Mitsuba BSDFs and emission.

Roughness conventions: Mitsuba's `principled` squares its roughness itself, as Blender does; its
`roughconductor` and `roughdielectric` take alpha = roughness squared.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from .node_graph import Pin, follow, output_node
from .textures import ImageValue

# Below this roughness a glass or mirror is exported as perfectly smooth.
SMOOTH = 0.02

_BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}

# Principled inputs that are not carried over: (name, value that has no effect)
_PRINCIPLED_IGNORED = (
    ("Subsurface Weight", 0.0),
    ("Coat Weight", 0.0),
    ("Sheen Weight", 0.0),
    ("Anisotropic", 0.0),
    ("Thin Film Thickness", 0.0),
    ("Diffuse Roughness", 0.0),
    ("Specular Tint", (1.0, 1.0, 1.0)),
    ("Alpha", 1.0),
)


@dataclass
class Look:
    """What a shader node amounts to.

    Attributes
    ----------
    bsdf : dict or None
        One-sided Mitsuba BSDF; None reflects nothing.
    emission : number, colour, ImageValue or None
        Emitted radiance.
    transmissive : bool
        Whether light passes through, so that the BSDF must not be made two-sided.
    smooth : bool
        Whether it mirrors so sharply that lamps would be seen in it.
    """

    bsdf: dict | None = None
    emission: object = None
    transmissive: bool = False
    smooth: bool = False


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
    """

    name: str
    bsdf: object
    emission: object
    uv_name: str | None
    smooth: bool


class Materials:
    """Exports each material once.

    Parameters
    ----------
    textures : Textures
    notes : Notes
    """

    def __init__(self, textures, notes):
        self._textures = textures
        self._notes = notes
        self._exported = {}

    def get(self, material):
        """Export a material.

        Parameters
        ----------
        material : bpy.types.Material or None
            None is Blender's default surface, a white of 80 %.

        Returns
        -------
        ExportedMaterial
        """
        key = None if material is None else material.name_full
        if key not in self._exported:
            self._exported[key] = self._export(material)
        return self._exported[key]

    def _export(self, material):
        import mitsuba as mi

        uv_names = []
        name = "default material" if material is None else material.name
        reader = _ShaderReader(name, material, self._textures, self._notes, uv_names)
        look = Look(reader.diffuse((0.8, 0.8, 0.8))) if material is None else reader.read()
        if look.emission is not None and not np.any(self._textures.mean_colour(look.emission) > 0):
            look.emission = None
        if isinstance(look.emission, ImageValue):
            uv_names.append(look.emission.uv_name)
        bsdf = look.bsdf or _BLACK
        if not look.transmissive:
            bsdf = {"type": "twosided", "bsdf": bsdf}
        distinct = list(dict.fromkeys(uv_names))
        if len(distinct) > 1:
            self._notes.add(
                name, "Several UV maps in one material", f"all use {distinct[0] or 'the active one'}"
            )
        uv_name = distinct[0] if distinct else ""
        return ExportedMaterial(name, mi.load_dict(bsdf), look.emission, uv_name, look.smooth)

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


class _ShaderReader:
    """Turns one material's node tree into a `Look`."""

    def __init__(self, name, material, textures, notes, uv_names):
        self._name = name
        self._material = material
        self._textures = textures
        self._notes = notes
        self._uv_names = uv_names

    # -- the material

    def read(self):
        tree = self._material.node_tree
        if tree is None or not _uses_nodes(self._material):
            return self._viewport_look()
        output = output_node(tree)
        if output is None:
            self._note("Material Output", "missing: rendered black, as in Blender")
            return Look()
        for name in ("Volume", "Displacement"):
            if output.inputs[name].is_linked:
                self._note(name, "ignored")
        surface = follow(Pin(output.inputs["Surface"]))
        if not surface.socket.is_output:
            return Look()
        return self._shader(surface)

    def _viewport_look(self):
        """Materials without nodes: what the viewport shows, which Cycles renders too."""
        material = self._material
        return Look(
            self._principled_bsdf(
                tuple(material.diffuse_color)[:3], material.metallic, material.roughness, 1.5, 0.0
            )
        )

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
            pin = node.input(name)
            if pin is None:
                continue
            source = follow(pin)
            if source.socket.is_output or not np.allclose(
                _first(source.socket.default_value, neutral), neutral
            ):
                self._note(f"Principled {name}", "ignored")
        self._note_normals(node, "Normal", "Tangent")
        emission = self._emission(node, "Emission Color", "Emission Strength")
        if transmission == 1 and metallic == 0:
            # Blender's Principled tints by the square root at each of two surfaces, and no reflections
            look = self._glass(_square_root(base), (1.0, 1.0, 1.0), roughness, ior)
            look.emission = emission
            return look
        if transmission != 0:
            self._note("Principled partial transmission", "approximated: darker inside the object")
        f0 = ((ior - 1) / (ior + 1)) ** 2
        if transmission == 0:
            f0 *= 2 * level
        elif level != 0.5:
            self._note("Principled Specular IOR Level", "ignored where light is transmitted")
        if not isinstance(metallic, ImageValue):
            # Blender takes from the diffuse layer what the coat over it reflects, Mitsuba does not
            base = _times(base, 1 - (1 - metallic) * min(f0, 1)) or (0.0, 0.0, 0.0)
        eta = _eta(f0) if ior >= 1 or transmission == 0 else ior
        return Look(
            self._principled_bsdf(base, metallic, roughness, eta, transmission),
            emission,
            transmissive=transmission != 0,
            smooth=_at_most(roughness, 0.15) and metallic != 0,
        )

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
        colour = self._colour(node, "Color")
        roughness = self._constant(node, "Roughness", 0.5)
        reflectance = self._build(colour, limit=1)
        if roughness < SMOOTH:
            bsdf = {"type": "conductor", "material": "none", "specular_reflectance": reflectance}
        else:
            bsdf = {
                "type": "roughconductor",
                "material": "none",
                "distribution": "ggx",
                "alpha": roughness**2,
                "specular_reflectance": reflectance,
            }
        return Look(bsdf, smooth=roughness <= 0.15)

    _read_BsdfGlossy = _read_BsdfAnisotropic

    def _read_BsdfTransparent(self, node):
        self._note("Transparent BSDF", "not supported: shown opaque")
        return Look()

    def _read_AddShader(self, node):
        first, second = (self._linked_shader(Pin(socket, node.groups)) for socket in node.node.inputs)
        if first.bsdf and second.bsdf:
            self._note("Add Shader of two reflecting shaders", "only the first is used")
        return Look(
            first.bsdf or second.bsdf,
            self._sum(first.emission, second.emission),
            first.transmissive if first.bsdf else second.transmissive,
            first.smooth or second.smooth,
        )

    def _read_MixShader(self, node):
        factor, first, second = (Pin(socket, node.groups) for socket in node.node.inputs)
        sources = [follow(first), follow(second)]
        for source, other in (sources, sources[::-1]):
            if source.socket.is_output and source.node.bl_idname == "ShaderNodeBsdfTransparent":
                self._note("Mix with Transparent BSDF", "transparency ignored: shown opaque")
                return self._shader(other) if other.socket.is_output else Look()
        weight = self._textures.value(factor, self._name, 0.5)
        looks = self._linked_shader(first), self._linked_shader(second)
        if isinstance(weight, ImageValue):
            self._uv_names.append(weight.uv_name)
            constant = float(self._textures.mean_colour(weight).mean())
            if looks[0].emission is not None or looks[1].emission is not None:
                self._note("Mix Shader of emission by a texture", "mixed by the texture's mean")
        else:
            weight = constant = float(np.clip(np.mean(weight), 0, 1))
        emission = self._sum(_times(looks[0].emission, 1 - constant), _times(looks[1].emission, constant))
        if looks[0].bsdf is None and looks[1].bsdf is None:
            return Look(emission=emission)
        if any(look.transmissive for look in looks) and not all(look.transmissive for look in looks):
            self._note("Mix Shader of glass and an opaque shader", "the back of the opaque part is black")
        bsdf = {
            "type": "blendbsdf",
            "weight": self._build(weight, grey=True, limit=1),
            "first": looks[0].bsdf or _BLACK,
            "second": looks[1].bsdf or _BLACK,
        }
        return Look(
            bsdf,
            emission,
            transmissive=any(look.transmissive for look in looks),
            smooth=any(look.smooth for look in looks),
        )

    # -- BSDFs

    def diffuse(self, colour):
        """A diffuse BSDF."""
        return {"type": "diffuse", "reflectance": self._build(colour, limit=1)}

    def _principled_bsdf(self, base, metallic, roughness, eta, transmission):
        bsdf = {
            "type": "principled",
            "base_color": self._build(base, limit=1),
            "roughness": self._build(roughness, grey=True, limit=1),
            "metallic": self._build(metallic, grey=True, limit=1),
            "eta": max(float(eta), 1.001),
        }
        if transmission != 0:
            bsdf["spec_trans"] = self._build(transmission, grey=True, limit=1)
        return bsdf

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
        if roughness < SMOOTH:
            return Look({"type": "dielectric", **common}, transmissive=True, smooth=True)
        rough = {"type": "roughdielectric", "distribution": "ggx", "alpha": roughness**2, **common}
        return Look(rough, transmissive=True, smooth=roughness <= 0.15)

    # -- values

    def _colour(self, node, name):
        return self._textured(node, name, tuple(self._material.diffuse_color)[:3])

    def _number(self, node, name, default):
        value = self._textured(node, name, default)
        return value if isinstance(value, ImageValue) else float(np.mean(value))

    def _textured(self, node, name, fallback):
        return self._textures.value(node.input(name), self._name, fallback)

    def _constant(self, node, name, default):
        return float(np.mean(self._textures.constant(node.input(name), self._name, default)))

    def _emission(self, node, colour_name, strength_name):
        strength = self._textures.value(node.input(strength_name), self._name, 1.0)
        if isinstance(strength, ImageValue):
            colour = self._textures.constant(node.input(colour_name), self._name, (1.0, 1.0, 1.0))
            return strength.scaled(colour)
        strength = float(np.mean(strength))
        if strength == 0:
            return None
        if strength < 0:
            self._note("Negative emission", "ignored")
            return None
        return _times(self._textures.value(node.input(colour_name), self._name, (1.0, 1.0, 1.0)), strength)

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
        for name in names:
            pin = node.input(name)
            if pin is not None and pin.socket.is_linked:
                self._note(f"{name} input (bump or normal map)", "ignored")


def _uses_nodes(material):
    import bpy

    return bpy.app.version >= (5, 0, 0) or material.use_nodes  # always true, and deprecated, since 5.0


def _times(value, factor):
    if value is None or factor == 0:
        return None
    if isinstance(value, ImageValue):
        return value.scaled(factor)
    return tuple(float(v) * factor for v in np.broadcast_to(value, 3))


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
