"""Blender materials to Mitsuba BSDFs and emission.

Shader nodes become the closures of `engine.scene.closures`, which take Blender's roughness as it is, put together by
`engine.scene.mixture` as Cycles layers them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ...engine.scene.variants import made
from ..notes import Notes
from .baking import ATLAS
from .node_graph import Pin, first_link, follow, output_node, uses_nodes
from .textures import LUMINANCE, ImageValue, MaterialReading

# Below this roughness a glass, mirror or polished surface is exported as perfectly smooth.
SMOOTH = 0.02
# The same of a coat, so that Blender's default coat roughness of 0.03 is smooth.
SMOOTH_COAT = 0.035
MIN_IOR = 0.1  # a texture or driver may give less
MIN_PRINCIPLED_IOR = 1e-5  # Cycles': it mirrors all

_BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
_CLEAR = {"type": "null"}
_WHITE = (1.0, 1.0, 1.0)

# Closures that serve both sides of a surface by themselves
MAX_SHADERS = 1000  # that are read of a material: each Add Shader may have twice those of the one before
_TWO_SIDED = {"null", "clear", "gloss", "glass", "sheen", "matt"}


@dataclass
class Appearance:
    """Appearance of a shader node.

    Attributes
    ----------
    bsdf : dict or None
        Mitsuba BSDF; None reflects nothing.
    emission : number, color, ImageValue or None
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
        return bsdf if self.transmissive or _two_sided(bsdf) else {"type": "twosided", "bsdf": bsdf}


@dataclass
class ExportedMaterial:
    """A material ready for meshes.

    Attributes
    ----------
    name : str
    bsdf : mitsuba.BSDF
    emission : number, color, ImageValue or None
        Radiance, None where nothing is emitted.
    uv_name : str or None
        UV map its textures read: None for the active one, "" if it reads none.
    smooth : bool
        See `Appearance`.
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
    outputs: dict


def export_material(material, textures, baked):
    """Export a material.

    Parameters
    ----------
    material : bpy.types.Material or None
        None is Blender's default surface, a white of 80 %.
    textures : Textures
    baked : dict of textures.RawImage, or None
        What has been baked of its varying sockets on one object, by `textures.socket_key`, as
        `ExportedMaterial.outputs` asks for; empty before that; None replaces by constants what would have to be baked.

    Returns
    -------
    ExportedMaterial
    """
    reading = MaterialReading(baked)
    name = "default material" if material is None else material.name
    notes = Notes(name)
    with textures.reading(reading, notes):
        try:
            look, uv_names = read_material(material, textures, notes)
        except (RecursionError, _TooManyShaders) as error:
            circle = isinstance(error, RecursionError)
            feature = "Nodes linked in a circle" if circle else f"Over {MAX_SHADERS} shaders in one material"
            notes.add(name, feature, "shown in the default gray")
            look, uv_names = read_material(None, textures, notes)
        if look.emission is not None and not np.any(textures.mean_color(look.emission) > 0):
            look.emission = None
        if isinstance(look.emission, ImageValue):
            uv_names.append(look.emission.uv_name)
    if reading.incomplete:
        bsdf = made(_BLACK)
        return ExportedMaterial(name, bsdf, None, "", False, Notes(), reading.outputs)
    distinct = list(dict.fromkeys(uv_names))
    # what is baked can be read by its own alone
    uv_name = ATLAS if ATLAS in distinct else distinct[0] if distinct else ""
    if len(distinct) > 1:
        notes.add(name, "Several UV maps in one material", f"all use {uv_name or 'the active one'}")
    bsdf = made(look.both_sides)
    return ExportedMaterial(name, bsdf, look.emission, uv_name, look.smooth, notes, {})


def read_material(material, textures, notes):
    """Read a material's nodes.

    Parameters
    ----------
    material : bpy.types.Material or None
    textures : Textures
    notes : Notes

    Returns
    -------
    look : Appearance
    uv_names : list of (str or None)
        UV maps that its BSDF reads, see `ExportedMaterial`.
    """
    reader = _ShaderReader(material, textures, notes)
    return reader.read(), reader.uv_names


class _TooManyShaders(Exception):
    """A material's shaders are more than `MAX_SHADERS`."""


class _ShaderReader:
    """Reader of a material's node tree, which makes an `Appearance`."""

    def __init__(self, material, textures, notes):
        self._name = "default material" if material is None else material.name
        self._material = material
        self._textures = textures
        self._notes = notes
        self.uv_names = []  # as `read_material` has them
        settings = getattr(material, "holopath", None)  # there once the properties are registered
        self._abbe = settings.abbe_number if settings else 0.0
        self._disperses = False
        self._shaders = 0
        self._has_displacement = False
        self._emission_pressing = False  # emission of more than one texture

    # -- the material

    def read(self):
        if self._material is None:
            return Appearance(self._matt((0.8, 0.8, 0.8)))
        tree = self._material.node_tree
        if tree is None or not uses_nodes(self._material):
            return self._viewport_look()
        output = output_node(tree)
        if output is None:
            self._note("Material Output", "missing: rendered black, as in Blender")
            return Appearance()
        if output.inputs["Volume"].is_linked:
            self._note("Volume", "ignored: clear")
            if first_link(output.inputs["Surface"]) is None:
                return _clear()
        self._has_displacement = first_link(output.inputs["Displacement"]) is not None
        if self._has_displacement and self._material.displacement_method != "BUMP":
            self._note("Displacement", "shown as bumps: the surface is not moved")
        self._textures.read_alphas(*(Pin(output.inputs[name]) for name in ("Surface", "Displacement")))
        look = self._linked_shader(Pin(output.inputs["Surface"]))
        if self._emission_pressing:
            whole = self._textures.emission(self._name)
            look = replace(look, emission=whole or look.emission)
        if (
            look.transmissive
            and look.bsdf
            and not self._material.use_transparent_shadow
            and _has_holes(look.bsdf)
        ):
            self._note("Transparent Shadow off", "ignored: light passes through what is transparent")
        if self._abbe and not self._disperses:
            self._note("Abbe number", "ignored: only smooth glass disperses")
        return look

    def _viewport_look(self):
        """Materials without nodes: what the viewport shows, which Cycles renders too."""
        material = self._material
        color = tuple(material.diffuse_color)[:3]
        gloss = {"roughness": material.roughness}
        look = self._over(Appearance(self._matt(color)), Appearance(self._dielectric(1.5, _WHITE, gloss)))
        return self._blend(look, self._metal(color, _WHITE, gloss), material.metallic)

    def _shader(self, source):
        self._shaders += 1
        if self._shaders > MAX_SHADERS:
            raise _TooManyShaders
        node = source.node
        reader = getattr(self, "_read_" + node.bl_idname.removeprefix("ShaderNode"), None)
        if reader is None or node.mute:
            self._note(f"{node.bl_label} node", "not supported: shown as the material's viewport color")
            return self._fallback()
        look = reader(source)
        # the Principled BSDF bends its own normals, but not those of what is seen through it
        return look if node.bl_idname == "ShaderNodeBsdfPrincipled" else self._bumpy(source, look)

    def _bumpy(self, node, look):
        """A look under the bump or normal map of its shader node, and the material's displacement."""
        pin = node.input("Normal")
        if look.bsdf is None or pin is None:
            return look
        if not follow(pin).socket.is_output:
            if not self._has_displacement:
                return look
            pin = None
        normals = self._textures.normal(pin, self._name)
        if normals is None:
            return look
        return replace(look, bsdf={"type": "normalmap", "normalmap": self._build(normals), "bsdf": look.bsdf})

    def _fallback(self):
        return Appearance(self._matt(tuple(self._material.diffuse_color)[:3]))

    def _linked_shader(self, pin):
        source = follow(pin)
        return self._shader(source) if source.socket.is_output else Appearance()

    # -- shader nodes

    def _read_BsdfPrincipled(self, node):
        base = self._color(node, "Base Color")
        metallic = self._number(node, "Metallic", 0.0)
        transmission = self._number(node, "Transmission Weight", 0.0)
        gloss = self._microfacets(node, 0.5)
        gloss |= self._burley_anisotropy(node, "Anisotropic", "Anisotropic Rotation")
        tint = self._texture_value(node, "Specular Tint", _WHITE)
        ior = max(self._constant(node, "IOR", 1.5), MIN_PRINCIPLED_IOR)
        self._note_thin_film(node, "Principled ")
        if self._deviates(node, "Thin Wall", False):
            self._note("Principled Thin Wall", "ignored")
        look = Appearance(self._matt(base, self._number(node, "Diffuse Roughness", 0.0)))
        if metallic != 1 and transmission != 1:
            if self._deviates(node, "Subsurface Weight", 0.0):
                self._note("Principled Subsurface Weight", "shown as a diffuse surface of the same color")
            f0 = 2 * self._constant(node, "Specular IOR Level", 0.5) * _f0(ior)
            if f0 > 0:
                smooth = _limit(gloss["roughness"], SMOOTH)
                eta = _eta(f0) if ior >= 1 else 1 / _eta(f0)
                look = self._over(look, Appearance(self._dielectric(eta, tint, gloss), smooth=smooth))
        if transmission != 0 and metallic != 1:
            # Blender's Principled tints by the square root at each of two surfaces, and no reflections
            glass = self._glass(_square_root(base), _WHITE, gloss, ior, tint)
            look = self._blend(look, glass, transmission)
        if metallic != 0:
            look = self._blend(look, self._metal(base, tint, gloss), metallic)
        look.emission = self._emission(node, "Emission Color", "Emission Strength")
        coat = self._number(node, "Coat Weight", 0.0)
        if coat != 0:
            look = self._with_coat(look, node, coat)
        sheen = self._number(node, "Sheen Weight", 0.0)
        if sheen != 0:
            if look.emission is not None:
                self._note("Emission under sheen", "as bright as without")
            fuzz = self._fuzz(
                self._texture_value(node, "Sheen Tint", _WHITE), self._number(node, "Sheen Roughness", 0.5)
            )
            look = self._over(look, Appearance(fuzz), sheen)
        return self._blend(_clear(), self._bumpy(node, look), self._number(node, "Alpha", 1.0))

    def _with_coat(self, look, node, weight):
        """A Principled BSDF's coat over the rest of it."""
        import drjit as dr
        import mitsuba as mi

        pin = node.input("Coat Normal")
        if pin is not None and follow(pin).socket.is_output:
            self._note("Principled Coat Normal", "that of the rest of the surface")
        ior = max(self._constant(node, "Coat IOR", 1.5), 1.001)
        roughness = self._number(node, "Coat Roughness", 0.03)
        if _limit(roughness, SMOOTH_COAT):
            roughness = 0.0
        coat = Appearance(
            self._dielectric(ior, _WHITE, {"roughness": roughness}), smooth=_limit(roughness, SMOOTH)
        )
        result = self._over(look, coat, weight)
        kept = 1 - np.full(3, dr.slice(mi.fresnel_diffuse_reflectance(ior)))
        if self._deviates(node, "Coat Tint", _WHITE):
            tint = self._texture_value(node, "Coat Tint", _WHITE)
            result.bsdf |= {"tint": self._build(tint, limit=1), "int_ior": ior}
            kept *= self._textures.mean_color(tint)
        # the mean over all directions; Blender's emission is dimmed by what the coat reflects this way
        if isinstance(weight, ImageValue) and np.ptp(kept) == 0:
            emission_below = self._product(look.emission, _rest(weight.scaled(1 - kept[0])))
        else:
            share = float(self._textures.mean_color(weight).mean())
            emission_below = _times(look.emission, 1 - share * (1 - kept))
        return replace(result, emission=emission_below)

    def _read_BsdfDiffuse(self, node):
        roughness = self._number(node, "Roughness", 0.0)
        return Appearance(self._matt(self._color(node, "Color"), roughness))

    def _read_BsdfTranslucent(self, node):
        bsdf = self._matt(self._color(node, "Color")) | {"translucent": True}
        return Appearance(bsdf, transmissive=True)

    def _read_SubsurfaceScattering(self, node):
        self._note("Subsurface Scattering node", "shown as a diffuse surface of the same color")
        return Appearance(self._matt(self._color(node, "Color")))

    def _read_BsdfSheen(self, node):
        if node.node.distribution != "MICROFIBER":
            self._note("Sheen BSDF of the Ashikhmin kind", "replaced by microfiber sheen")
        return Appearance(self._fuzz(self._color(node, "Color"), self._number(node, "Roughness", 0.5)))

    def _read_Emission(self, node):
        return Appearance(emission=self._emission(node, "Color", "Strength"))

    def _read_BsdfGlass(self, node):
        self._note_thin_film(node, "Glass BSDF ")
        color = self._color(node, "Color")
        return self._glass(
            color, color, self._microfacets(node, 0.0), self._constant(node, "IOR", 1.5), _WHITE
        )

    def _read_BsdfRefraction(self, node):
        gloss = self._microfacets(node, 0.0)
        bsdf = {
            "type": "glass",
            "fresnel": False,
            "ior": _refracting(self._constant(node, "IOR", 1.45)),
            "transmittance": self._build(self._color(node, "Color"), limit=1),
            **self._rough(gloss["roughness"]),
        }
        if "roughness" in bsdf:
            bsdf["distribution"] = gloss.get("distribution", "ggx")
        return Appearance(bsdf, transmissive=True, smooth=_limit(gloss["roughness"], SMOOTH))

    def _read_BsdfAnisotropic(self, node):
        """The Glossy BSDF: a mirror of the given color, without Fresnel."""
        gloss = self._microfacets(node, 0.5) | self._anisotropy(node)
        return self._mirror(gloss, reflectance=self._color(node, "Color"))

    _read_BsdfGlossy = _read_BsdfAnisotropic

    def _read_BsdfMetallic(self, node):
        self._note_thin_film(node, "Metallic BSDF ")
        gloss = self._microfacets(node, 0.5) | self._burley_anisotropy(node, "Anisotropy", "Rotation")
        if node.node.fresnel_type == "F82":
            return self._metal(
                self._color(node, "Base Color"), self._texture_value(node, "Edge Tint", _WHITE), gloss
            )
        index, extinction = (
            np.broadcast_to(self._textures.constant(node.input(name), self._name, fallback), 3)
            for name, fallback in (("IOR", (2.757, 2.513, 2.231)), ("Extinction", (3.867, 3.404, 3.009)))
        )
        return self._metal(*_f82_of_metal(index, extinction), gloss)

    def _read_BsdfTransparent(self, node):
        color = self._color(node, "Color")
        if _is_white(color):
            return _clear()
        return replace(_clear(), bsdf={"type": "clear", "transmittance": self._build(color, limit=1)})

    def _read_AddShader(self, node):
        first, second = (self._linked_shader(Pin(socket, node.groups)) for socket in node.node.inputs)
        sum_bsdf = self._mixture(first, second, mode="add") if first.bsdf and second.bsdf else None
        return Appearance(
            sum_bsdf or first.bsdf or second.bsdf,
            self._sum(first.emission, second.emission),
            first.transmissive or second.transmissive,
            first.smooth or second.smooth,
        )

    def _read_MixShader(self, node):
        factor, first, second = (Pin(socket, node.groups) for socket in node.node.inputs)
        looks = self._linked_shader(first), self._linked_shader(second)
        by_angle = self._by_angle(follow(factor))
        if by_angle:
            return self._blend(*looks, 1.0, **by_angle)
        return self._blend(*looks, self._gray(self._textures.value(factor, self._name, 0.5)))

    def _by_angle(self, source):
        """Arguments of `engine.scene.mixture` for a Fresnel or Layer Weight node; empty for other sockets."""
        node, name = source.node, source.socket.name
        read = {"ShaderNodeFresnel": "IOR", "ShaderNodeLayerWeight": "Blend"}.get(node.bl_idname)
        if read is None or not source.socket.is_output:
            return {}
        amount = follow(source.input(read))
        if amount.socket.is_output or follow(source.input("Normal")).socket.is_output:
            return {}
        amount = amount.socket.default_value
        if node.bl_idname == "ShaderNodeFresnel":
            return {"fresnel_ior": max(amount, MIN_IOR)}
        amount = min(max(amount, 0.0), 1 - 1e-5)
        if name == "Fresnel":
            return {"fresnel_ior": 1 / (1 - amount)}
        return {"facing": max(2 * amount if amount < 0.5 else 0.5 / (1 - amount), 1e-5)}

    def _blend(self, first, second, weight, **by_angle):
        """Mix of two looks.

        Parameters
        ----------
        first, second : Appearance
        weight : float or ImageValue
            Share of the second.
        **by_angle
            How the share depends on the angle as well, see `engine.scene.mixture`.

        Returns
        -------
        Appearance
        """
        if not isinstance(weight, ImageValue):
            weight = min(max(weight, 0.0), 1.0)
            if weight in (0, 1) and not by_angle:
                return second if weight else first
        mean = weight
        emits = first.emission is not None or second.emission is not None
        if by_angle and emits and not isinstance(weight, ImageValue):
            self._note("Emission mixed by the angle", "as bright from all sides")
            mean = weight * _mean_by_angle(**by_angle)
        result = Appearance(
            emission=self._sum(
                self._product(first.emission, _rest(mean)), self._product(second.emission, mean)
            ),
            transmissive=first.transmissive or second.transmissive,
            smooth=first.smooth or second.smooth,
        )
        if first.bsdf or second.bsdf:
            share = self._build(weight, gray=True, limit=1)
            result.bsdf = self._mixture(first, second, weight=share, **by_angle)
        return result

    def _over(self, below, above, weight=1.0):
        """A look below a reflecting closure with a weight."""
        weight = self._build(weight, gray=True, limit=1)
        bsdf = self._mixture(below, above, mode="over", weight=weight)
        return replace(below, bsdf=bsdf, smooth=below.smooth or above.smooth)

    @staticmethod
    def _mixture(first, second, **how):
        """BSDF of two looks, see `engine.scene.mixture`."""
        through = first.transmissive or second.transmissive
        parts = [look.both_sides if through else look.bsdf or _BLACK for look in (first, second)]
        return {"type": "mixture", "first": parts[0], "second": parts[1], **how}

    # -- closures

    def _matt(self, color, roughness=0.0):
        bsdf = {"type": "matt", "reflectance": self._build(color, limit=1)}
        return bsdf if roughness == 0 else bsdf | {"roughness": self._build(roughness, gray=True, limit=1)}

    def _fuzz(self, color, roughness):
        roughness = self._build(roughness, gray=True, limit=1)
        return {"type": "sheen", "reflectance": self._build(color, limit=1), "roughness": roughness}

    def _microfacets(self, node, roughness):
        """Roughness and distribution of a glossy closure, for `_gloss`."""
        gloss: dict = {"roughness": self._number(node, "Roughness", roughness)}
        distribution = node.node.distribution
        if distribution in ("GGX", "BECKMANN"):
            gloss["distribution"] = distribution.lower()
        elif distribution != "MULTI_GGX" and not _limit(gloss["roughness"], SMOOTH):
            self._note(f"{node.node.bl_label} of the {distribution.title()} kind", "of GGX microfacets")
            gloss["distribution"] = "ggx"
        return gloss

    def _anisotropy(self, node):
        """Anisotropy of the Glossy BSDF."""
        amount = min(max(self._constant(node, "Anisotropy", 0.0), -0.99), 0.99)
        return self._stretch(node, 1 / (1 - amount) if amount > 0 else 1 + amount, "Rotation")

    def _burley_anisotropy(self, node, name, rotation_name):
        """Anisotropy of the others, after Burley 2012."""
        amount = min(max(self._constant(node, name, 0.0), 0.0), 1.0)
        return self._stretch(node, math.sqrt(1 - 0.9 * amount), rotation_name)

    def _stretch(self, node, aspect, rotation_name):
        """Anisotropy for `engine.scene.closures`, along the U of a UV map."""
        if abs(aspect - 1) < 1e-4:
            return {}
        tangent, uv_name = follow(node.input("Tangent")).node, None
        if tangent.bl_idname == "ShaderNodeTangent" and tangent.direction_type == "UV_MAP":
            uv_name = tangent.uv_map or None
        else:
            self._note("Anisotropy about an axis", "along the U of the UV map, as a Tangent node may say")
        self.uv_names.append(uv_name)
        return {"aspect": aspect, "rotation": self._number(node, rotation_name, 0.0)}

    def _rough(self, roughness):
        """Roughness of a closure; empty if it is smooth."""
        if _limit(roughness, SMOOTH):
            return {}
        return {"roughness": self._build(roughness, gray=True, limit=1)}

    def _gloss(self, gloss, **fresnel):
        """A reflecting closure."""
        bsdf = {"type": "gloss", **fresnel, **self._rough(gloss["roughness"])}
        if "roughness" not in bsdf:
            return bsdf
        rotation = gloss.get("rotation", 0.0)
        if rotation != 0:
            bsdf["rotation"] = self._build(rotation, gray=True)
        return bsdf | {key: gloss[key] for key in ("aspect", "distribution") if key in gloss}

    def _dielectric(self, ior, tint, gloss):
        ior = max(ior, 1.001) if ior >= 1 else min(ior, 0.999)
        return self._gloss(gloss, ior=ior, reflectance=self._build(tint, limit=1))

    def _mirror(self, gloss, **colors):
        """A mirror with colors of `engine.scene.closures`."""
        colors = {name: self._build(color, limit=1) for name, color in colors.items()}
        return Appearance(self._gloss(gloss, **colors), smooth=_limit(gloss["roughness"], SMOOTH))

    def _metal(self, color, edge, gloss):
        edge = {} if _is_white(edge) else {"edge": edge}
        return self._mirror(gloss, f0=color, **edge)

    def _glass(self, transmittance, reflectance, gloss, ior, tint):
        colors = [self._build(color, limit=1) for color in (transmittance, reflectance)]
        has_tint = not _is_white(tint)
        ior, roughness = _refracting(ior), gloss["roughness"]
        smooth = _limit(roughness, SMOOTH)
        if smooth and self._abbe:
            self._disperses = True
            if has_tint:
                self._note("Specular Tint of dispersive glass", "ignored")
            bsdf = dict(zip(("specular_transmittance", "specular_reflectance"), colors, strict=True))
            bsdf |= {"type": "dispersive_dielectric", "int_ior": ior, "ext_ior": 1.0, "abbe": self._abbe}
            return Appearance(bsdf, transmissive=True, smooth=True)
        bsdf = dict(zip(("transmittance", "reflectance"), colors, strict=True))
        bsdf |= {"type": "glass", "ior": ior, **self._rough(roughness)}
        if has_tint:
            bsdf["specular_tint"] = self._build(tint, limit=1)
        if not smooth and "distribution" in gloss:
            bsdf["distribution"] = gloss["distribution"]
        return Appearance(bsdf, transmissive=True, smooth=smooth)

    # -- values

    def _color(self, node, name):
        return self._texture_value(node, name, tuple(self._material.diffuse_color)[:3])

    def _number(self, node, name, default):
        return self._gray(self._texture_value(node, name, default))

    @staticmethod
    def _gray(value):
        """A color as a number, which is its luminance in Cycles."""
        return replace(value, gray=True) if isinstance(value, ImageValue) else _luminance(value)

    @staticmethod
    def _deviates(node, name, neutral):
        """Whether an input differs from the value that has no effect."""
        pin = node.input(name)
        if pin is None:
            return False
        socket = follow(pin).socket
        return socket.is_output or not np.allclose(_first(socket.default_value, neutral), neutral)

    def _texture_value(self, node, name, fallback):
        return self._textures.value(node.input(name), self._name, fallback)

    def _constant(self, node, name, default):
        return float(np.mean(self._textures.constant(node.input(name), self._name, default)))

    def _emission(self, node, color_name, strength_name):
        strength = self._textures.value(node.input(strength_name), self._name, 1.0)
        if isinstance(strength, ImageValue):
            color = self._textures.value(node.input(color_name), self._name, _WHITE)
            if isinstance(color, ImageValue):
                self._emission_pressing = True
                color = self._textures.mean_color(color)
            if self._textures.has_negative(strength):
                self._note("Negative emission", "ignored")
            return replace(strength, gray=True).scaled(color)
        strength = _luminance(strength)
        if strength == 0:
            return None
        if strength < 0:
            self._note("Negative emission", "ignored")
            return None
        color = self._textures.value(node.input(color_name), self._name, (1.0, 1.0, 1.0))
        if isinstance(color, ImageValue) and self._textures.has_negative(color):
            self._note("Negative emission", "ignored")
        return _times(color, strength)

    def _product(self, value, weight):
        """A value, or none, times a number or an image."""
        if value is None or not isinstance(weight, ImageValue):
            return _times(value, weight)
        if not isinstance(value, ImageValue):
            return weight.scaled(value)
        self._emission_pressing = True
        return _times(value, float(self._textures.mean_color(weight).mean()))

    def _sum(self, first, second):
        if first is None or second is None:
            return second if first is None else first
        if isinstance(first, ImageValue) or isinstance(second, ImageValue):
            self._emission_pressing = True
            return first if isinstance(first, ImageValue) else second
        return tuple(np.broadcast_to(first, 3) + np.broadcast_to(second, 3))

    def _build(self, value, gray=False, limit=None):
        if isinstance(value, ImageValue):
            self.uv_names.append(value.uv_name)
        if limit is not None and not gray and self._textures.is_above(value, limit):
            self._note(
                "Color above 1", "shown as 1: no surface reflects or transmits more light than it gets"
            )
        return self._textures.build(value, gray, limit)

    def _note(self, feature, effect):
        self._notes.add(self._name, feature, effect)

    def _note_thin_film(self, node, prefix):
        if self._deviates(node, "Thin Film Thickness", 0.0):
            self._note(f"{prefix}Thin Film Thickness", "ignored")


def _two_sided(bsdf):
    """Whether a BSDF's dictionary is for both sides."""
    if bsdf["type"] == "mixture":
        return _two_sided(bsdf["first"]) and _two_sided(bsdf["second"])
    if bsdf["type"] == "normalmap":
        return _two_sided(bsdf["bsdf"])
    return bsdf["type"] in _TWO_SIDED


def _mean_by_angle(fresnel_ior=None, facing=None) -> float:
    """Cosine-weighted mean over the hemisphere of a weight of `engine.scene.mixture`."""
    import drjit as dr
    import mitsuba as mi

    if facing is not None:
        return facing / (facing + 2)
    return float(dr.slice(mi.fresnel_diffuse_reflectance(fresnel_ior)))


def _times(value, factor):
    if value is None or not np.any(factor):
        return None
    if isinstance(value, ImageValue):
        return value.scaled(factor)
    return tuple(float(v) for v in np.broadcast_to(value, 3) * np.asarray(factor))


def _rest(weight):
    """One minus a weight."""
    return weight.inverted() if isinstance(weight, ImageValue) else 1 - weight


def _has_holes(bsdf):
    """Whether a BSDF lets light pass straight on anywhere."""
    return bsdf.get("type") in ("null", "clear") or any(
        _has_holes(each) for each in bsdf.values() if isinstance(each, dict)
    )


def _clear():
    """Appearance of an invisible surface."""
    return Appearance(_CLEAR, transmissive=True, smooth=True)


def _f0(ior):
    return ((ior - 1) / (ior + 1)) ** 2


def _luminance(value):
    """Luminance of a color or a number."""
    return float(np.dot(value, LUMINANCE) if np.ndim(value) else value)


def _square_root(value):
    if isinstance(value, ImageValue):
        return replace(value, power=0.5 * value.power, scale=tuple(math.sqrt(v) for v in value.scale))
    return tuple(math.sqrt(max(v, 0.0)) for v in np.broadcast_to(value, 3))


def _eta(f0):
    root = math.sqrt(min(max(f0, 0.0), 0.98))
    return (1 + root) / (1 - root)


def _refracting(ior):
    """An index of refraction that differs from 1, as Mitsuba requires."""
    ior = max(float(ior), MIN_IOR)
    return ior if abs(ior - 1) >= 1e-4 else 1.0001


def _f82_of_metal(index, extinction):
    """Reflectance at normal incidence, and that at 82 degrees over Schlick's, of a metal in air.

    The model of Kutz, Hasan and Edmondson 2021 through Fresnel's equations at these two angles.
    """

    def fresnel(cosine):
        refractive = index + 1j * extinction
        inside = np.sqrt(refractive**2 - (1 - cosine**2))
        s = (cosine - inside) / (cosine + inside)
        p = (refractive**2 * cosine - inside) / (refractive**2 * cosine + inside)
        return (abs(s) ** 2 + abs(p) ** 2) / 2

    normal = fresnel(1.0)
    schlick = normal + (1 - normal) * (6 / 7) ** 5
    return tuple(normal), tuple(np.minimum(fresnel(1 / 7) / schlick, 1))


def _is_white(value):
    return not isinstance(value, ImageValue) and np.min(value) >= 1


def _limit(value, limit):
    return not isinstance(value, ImageValue) and value <= limit


def _first(value, like):
    return np.asarray(tuple(value)[:3]) if isinstance(like, tuple) else value
