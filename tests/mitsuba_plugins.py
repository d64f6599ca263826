"""A scene for every plugin that a Mitsuba scene may hold, and what HoloPath makes of it: the table of the tests.

`PLUGINS` has a row for each installed plugin that is a part of a scene. Films, samplers, reconstruction filters and
integrators are none: of a scene file HoloPath takes what is in view, and where the viewer stands.
"""

import struct
import zlib
from dataclasses import dataclass
from math import inf

import numpy as np

KINDS = ("BSDF", "Shape", "Emitter", "Texture", "Medium", "Sensor", "Volume", "PhaseFunction")

SENSOR = """<sensor type="perspective" id="viewer"><float name="fov" value="40"/>
 <transform name="to_world"><lookat origin="0,0,0" target="0,0,-1" up="0,1,0"/></transform>
 <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="24"/></film></sensor>"""
WALL = """<shape type="rectangle" id="wall"><transform name="to_world"><scale value="0.9"/><translate z="-2"/>
 </transform><bsdf type="diffuse"><rgb name="reflectance" value="0.5,0.4,0.3"/></bsdf></shape>"""
LAMP = """<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.4"/>
 <lookat origin="0.3,0.6,0.2" target="0,0,-1.4" up="0,1,0"/></transform>
 <emitter type="area"><rgb name="radiance" value="9,9,9"/></emitter></shape>"""
PIXEL = """<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/>
 <rfilter type="box"/></film>"""
SCENE = '<scene version="3.0.0">{}</scene>'

# One surface in four ways: a ball, a pane with two sides, a masked ball, and a box that is instanced.
WORN = """<shape type="sphere"><point name="center" value="-0.17,0.17,-1"/><float name="radius" value="0.14"/>{ref}
</shape><shape type="rectangle"><transform name="to_world"><scale value="0.14"/><rotate y="1" angle="200"/>
 <translate x="0.17" y="0.17" z="-1"/></transform>{two}</shape>
<shape type="sphere"><point name="center" value="-0.17,-0.17,-1"/><float name="radius" value="0.14"/>
 <bsdf type="mask"><float name="opacity" value="0.6"/>{ref}</bsdf></shape>
<shape type="shapegroup" id="group"><shape type="cube">{ref}</shape></shape>
<shape type="instance"><ref id="group"/><transform name="to_world"><scale value="0.1"/><rotate x="1" y="1" angle="30"/>
 <translate x="0.17" y="-0.17" z="-1"/></transform></shape>"""


@dataclass(frozen=True)
class Case:
    """A scene with a plugin in it.

    Attributes
    ----------
    parts : str
        Of the scene, as XML; {folder} is that of `write_files`.
    refused : str
        What the refusal says, a regular expression; empty where it renders.
    noted : str
        What a warning of the plan or a note says, likewise.
    bright : float, tuple of float or None
        How far the brightness of each quarter may be from the reference's, relative: upper left, upper right, lower
        left and lower right; None where the reference shows something else.
    lit : str
        The lamps, if the case has none.
    seen : str
        Where the viewer stands, and the wall behind all.
    """

    parts: str
    refused: str = ""
    noted: str = ""
    bright: float | tuple | None = 0.15
    lit: str = LAMP
    seen: str = SENSOR + WALL

    def xml(self, folder):
        """The scene file's text."""
        return SCENE.format((self.seen + self.lit + self.parts).replace("{folder}", str(folder)))


def surface(bsdf, sides=1, polished=False, **more):
    """A case with a BSDF worn in four ways; of those with two `sides` of their own the pane needs no `twosided`.

    Under the mask `polished` surfaces lose their mirror image, and light that passes it is found by chance.
    """
    named = bsdf.replace("<bsdf ", '<bsdf id="surface" ', 1)
    ref = '<ref id="surface"/>'
    two = ref if sides == 2 else f'<bsdf type="twosided">{ref}</bsdf>'
    if polished:
        more = {"noted": "under a BSDF of type 'mask'"} | more
    more = {"bright": (0.15, 0.15, inf if polished else 0.25, 0.2)} | more
    return Case(named + WORN.format(ref=ref, two=two), **more)


def textured(kind, body, **more):
    """A case with a texture on a ball and a pane."""
    texture = f'<texture type="{kind}" name="reflectance">{body}</texture>'
    bsdf = f'<bsdf type="twosided"><bsdf type="diffuse">{texture}</bsdf></bsdf>'
    return Case(
        f"""<shape type="sphere"><point name="center" value="-0.17,0.1,-1"/><float name="radius" value="0.16"/>{bsdf}
        </shape><shape type="rectangle"><transform name="to_world"><scale value="0.16"/>
        <translate x="0.17" y="-0.1" z="-1"/></transform>{bsdf}</shape>""",
        **more,
    )


def shape(kind, body, **more):
    """A case with a shape in view."""
    return Case(f'<shape type="{kind}">{body}</shape>', **more)


def emitter(kind, body="", **more):
    """A case with an emitter that is no shape, which lights a ball."""
    ball = BALL.format('<bsdf type="diffuse"/>')
    return Case(f'{ball}<emitter type="{kind}">{body}</emitter>', lit="", **more)


def medium(kind, body, **more):
    """A case with a scattering medium inside glass."""
    inside = f'<bsdf type="dielectric"/><medium type="{kind}" name="interior">{body}</medium>'
    return Case(BALL.format(inside), noted="media.*clear", bright=None, **more)


def sensor(kind, body="", refused="perspective"):
    """A case that is looked at by another sensor."""
    return Case(
        BALL.format(""),
        seen=f'<sensor type="{kind}" id="viewer">{body}{PIXEL}</sensor>{WALL}',
        refused=refused,
    )


BALL = """<shape type="sphere"><point name="center" value="0,0,-1.2"/><float name="radius" value="0.2"/>{}</shape>"""


def phased(phase):
    return medium("homogeneous", phase)


AT = '<transform name="to_world"><scale value="0.2"/><rotate x="1" y="1" angle="30"/><translate z="-1.2"/></transform>'
AIMED = """<transform name="to_world"><lookat origin="0.3,0.4,0" target="0,0,-1.4" up="0,1,0"/></transform>"""
FILE = '<string name="filename" value="{{folder}}/{}"/>'.format
NUMBER = '<float name="{}" value="{}"/>'.format
RED = '<rgb name="reflectance" value="0.7,0.2,0.1"/>'
MATT = f'<bsdf type="diffuse">{RED}</bsdf>'
NESTED = f'<bsdf type="twosided">{MATT}</bsdf>'
RAW = '<boolean name="raw" value="true"/>'
BUMPS = f'<texture type="bitmap" name="bump">{FILE("picture.png")}{RAW}</texture>{NUMBER("scale", 0.02)}'
NORMALS = f'<texture type="bitmap" name="normalmap">{FILE("normals.png")}{RAW}</texture>'
GLOSSY = f'<bsdf type="roughconductor">{NUMBER("alpha", 0.25)}</bsdf>'
LACQUER = f'<bsdf type="roughplastic">{NUMBER("alpha", 0.2)}</bsdf>'
ISOTROPIC = '<phase type="isotropic"/>'


def worn(kind, body="", sides=1, **more):
    """A case with a BSDF of a type, see `surface`."""
    return surface(f'<bsdf type="{kind}">{body}</bsdf>', sides, **more)


def blended(weight, first, second):
    """A blend of two BSDFs."""
    return f'<bsdf type="blendbsdf">{NUMBER("weight", weight)}{first}{second}</bsdf>'


def masked(opacity, bsdf):
    """A BSDF with holes."""
    return f'<bsdf type="mask">{NUMBER("opacity", opacity)}{bsdf}</bsdf>'


SURFACES = {
    "diffuse": worn("diffuse", RED),
    "conductor": worn("conductor", '<string name="material" value="Au"/>', polished=True),
    "roughconductor": worn("roughconductor", '<string name="material" value="Cu"/>' + NUMBER("alpha", 0.25)),
    "plastic": worn("plastic", '<rgb name="diffuse_reflectance" value="0.1,0.2,0.5"/>', polished=True),
    "roughplastic": surface(LACQUER),
    "pplastic": worn("pplastic", NUMBER("alpha", 0.2)),
    "principled": worn(
        "principled",
        '<rgb name="base_color" value="0.6,0.3,0.1"/>'
        + NUMBER("roughness", 0.4)
        + NUMBER("metallic", 0.3)
        + NUMBER("clearcoat", 0.5),
    ),
    "principledthin": worn("principledthin", NUMBER("diff_trans", 0.6) + NUMBER("roughness", 0.4), 2),
    "dielectric": worn("dielectric", "", 2, polished=True),
    "roughdielectric": worn("roughdielectric", NUMBER("alpha", 0.2), 2),
    "thindielectric": worn("thindielectric", "", 2, polished=True),
    "null": worn("null", "", 2),
    "hair": worn("hair", "", 2),
    "measured": worn("measured", FILE("measured.bsdf")),
    "measured_polarized": worn("measured_polarized", FILE("measured.pbsdf"), refused="measured_?polarized"),
    "polarizer": worn("polarizer", "", 2, noted="Polarization"),
    "retarder": worn("retarder", "", 2, noted="Polarization"),
    "circular": worn("circular", "", 2, noted="Polarization"),
    "twosided": worn("twosided", MATT + '<bsdf type="conductor"/>', 2, polished=True),
    "mask": surface(masked(0.4, NESTED), 2),
    "blendbsdf": surface(blended(0.3, MATT, GLOSSY)),
    "bumpmap": worn("bumpmap", BUMPS + LACQUER),
    "normalmap": worn("normalmap", NORMALS + GLOSSY),
}

# as scene files nest them
NESTS = {
    "bsplinecurve with a bare end": shape(
        "bsplinecurve", FILE("curves.txt") + NESTED, refused="bsplinecurve.*radius 0.*linearcurve"
    ),
    "twosided(mask)": worn("twosided", masked(0.5, MATT), 2, refused="transmission"),
    "twosided(dielectric)": worn("twosided", '<bsdf type="dielectric"/>', 2, refused="transmission"),
    "twosided(blend(plastic))": worn(
        "twosided", blended(0.5, MATT, '<bsdf type="plastic"/>'), 2, polished=True
    ),
    "mask(twosided(blend))": surface(
        masked(0.7, f'<bsdf type="twosided">{blended(0.5, MATT, LACQUER)}</bsdf>'), 2
    ),
    "mask(mask)": surface(masked(0.7, masked(0.6, NESTED)), 2),
    "mask by an image": worn(
        "mask", f'<texture type="bitmap" name="opacity">{FILE("picture.png")}</texture>{NESTED}', 2
    ),
    "blend(glass, diffuse)": surface(blended(0.5, '<bsdf type="dielectric"/>', MATT), 2, polished=True),
    "blend(blend)": surface(blended(0.5, blended(0.5, MATT, LACQUER), GLOSSY)),
    "blend(null, diffuse)": surface(blended(0.5, '<bsdf type="null"/>', MATT), 2),
    "bump(glass)": worn("bumpmap", BUMPS + '<bsdf type="roughdielectric"/>', 2),
    "bump(mask)": worn("bumpmap", BUMPS + masked(0.5, NESTED), 2),
    "normal(principled)": worn(
        "normalmap", f'{NORMALS}<bsdf type="principled">{NUMBER("roughness", 0.3)}</bsdf>'
    ),
    "twosided(normal(bump))": worn(
        "twosided", f'<bsdf type="normalmap">{NORMALS}<bsdf type="bumpmap">{BUMPS}{MATT}</bsdf></bsdf>', 2
    ),
}

SHAPES = {
    "sphere": shape("sphere", AT + NESTED),
    "cube": shape("cube", AT + NESTED),
    "rectangle": shape("rectangle", AT + NESTED),
    "disk": shape("disk", AT + NESTED),
    "cylinder": shape("cylinder", AT + NESTED),
    "obj": shape("obj", FILE("mesh.obj") + AT + NESTED),
    "ply": shape("ply", FILE("mesh.ply") + AT + NESTED),
    "serialized": shape("serialized", FILE("mesh.serialized") + AT + NESTED),
    "merge": shape(
        "merge",
        f'<shape type="cube">{AT}{NESTED}</shape><shape type="obj">{FILE("mesh.obj")}{NESTED}</shape>',
    ),
    "shapegroup": Case(
        f"""<shape type="shapegroup" id="group"><shape type="cube">{NESTED}</shape><shape type="sphere">
        <point name="center" value="0,1.2,0"/><float name="radius" value="0.5"/><bsdf type="dielectric"/></shape>
        </shape>
        <shape type="instance"><ref id="group"/>{AT}</shape>"""
    ),
    "instance": Case(
        f"""<shape type="shapegroup" id="group"><shape type="ply">{FILE("mesh.ply")}{NESTED}</shape></shape>
        <shape type="instance"><ref id="group"/>{AT}</shape><shape type="instance"><ref id="group"/>
        <transform name="to_world"><scale x="-0.1" y="0.2" z="0.1"/><translate x="0.3" z="-1.4"/></transform></shape>"""
    ),
    "bsplinecurve": shape("bsplinecurve", FILE("ended.txt") + NESTED),
    "linearcurve": shape("linearcurve", FILE("curves.txt") + NESTED),
    "sdfgrid": shape("sdfgrid", FILE("distance.vol") + AT + NESTED),
    "ellipsoids": shape("ellipsoids", FILE("ellipsoids.ply") + NESTED, noted="ellipsoids"),
    "ellipsoidsmesh": shape("ellipsoidsmesh", FILE("ellipsoids.ply") + NESTED, noted="ellipsoids"),
    "blender": shape("blender", "", refused="blender"),
}

EMITTERS = {
    "area": Case(BALL.format('<emitter type="area"><rgb name="radiance" value="3,2,1"/></emitter>'), lit=""),
    "constant": emitter("constant", '<rgb name="radiance" value="0.3,0.4,0.5"/>'),
    "directional": emitter("directional", '<vector name="direction" value="0.2,-0.3,-1"/>'),
    "directionalarea": Case(
        LAMP.replace('id="lamp"', "").replace('type="area"', 'type="directionalarea"') + BALL.format(""),
        lit=LAMP,
        noted="directionalarea",
    ),
    "envmap": emitter("envmap", FILE("sky.exr")),
    "point": emitter("point", '<point name="position" value="0.3,0.4,0"/>'),
    "projector": emitter(
        "projector",
        f"""<texture type="bitmap" name="irradiance">{FILE("picture.png")}</texture><float name="fov" value="50"/>
        {AIMED}""",
    ),
    "spot": emitter(
        "spot",
        f'{AIMED}<rgb name="intensity" value="4"/><float name="cutoff_angle" value="30"/>',
    ),
    "sunsky": emitter("sunsky", '<vector name="sun_direction" value="0.3,0.4,0.8"/>'),
    "timed_sunsky": emitter("timed_sunsky", refused="sunsky"),
}

TEXTURES = {
    "bitmap": textured("bitmap", FILE("picture.png")),
    "checkerboard": textured("checkerboard", '<transform name="to_uv"><scale value="4"/></transform>'),
    "mesh_attribute": shape(
        "ply",
        f"""{FILE("mesh.ply")}{AT}<bsdf type="twosided"><bsdf type="diffuse"><texture type="mesh_attribute"
        name="reflectance"><string name="name" value="vertex_color"/></texture></bsdf></bsdf>""",
    ),
    "volume": textured(
        "volume",
        f"""<volume type="gridvolume" name="volume">{FILE("colors.vol")}<transform name="to_world">
        <translate x="-0.5" y="-0.5" z="-1.5"/></transform></volume>""",
    ),
    "rawconstant": textured("rawconstant", NUMBER("value", 0.4)),
    "srgb": textured("srgb", '<rgb name="color" value="0.4,0.3,0.2"/>'),
    "uniform": textured("uniform", NUMBER("value", 0.4)),
    "d65": Case(BALL.format('<emitter type="area"><spectrum type="d65" name="radiance"/></emitter>')),
    "blackbody": Case(
        BALL.format(
            f"""<emitter type="area"><spectrum type="blackbody" name="radiance">{NUMBER("temperature", 4000)}
            </spectrum></emitter>"""
        ),
        refused="spectral",
    ),
    "regular": textured(
        "regular",
        NUMBER("wavelength_min", 400)
        + NUMBER("wavelength_max", 700)
        + '<string name="values" value="0.1,0.3,0.5"/>',
        refused="spectral",
    ),
    "irregular": textured(
        "irregular",
        '<string name="wavelengths" value="400,500,700"/><string name="values" value="0.1,0.3,0.5"/>',
        refused="spectral",
    ),
}

MEDIA = {
    "homogeneous": medium(
        "homogeneous", '<rgb name="albedo" value="0.9,0.8,0.7"/><float name="sigma_t" value="5"/>'
    ),
    "heterogeneous": medium(
        "heterogeneous",
        f'<volume type="gridvolume" name="sigma_t">{FILE("density.vol")}</volume><float name="scale" value="5"/>',
    ),
    "constvolume": medium(
        "heterogeneous", '<volume type="constvolume" name="sigma_t"><float name="value" value="3"/></volume>'
    ),
    "gridvolume": textured(
        "volume", f'<volume type="gridvolume" name="volume">{FILE("colors.vol")}</volume>'
    ),
    "isotropic": phased(ISOTROPIC),
    "hg": phased('<phase type="hg"><float name="g" value="0.5"/></phase>'),
    "rayleigh": phased('<phase type="rayleigh"/>'),
    "tabphase": phased('<phase type="tabphase"><string name="values" value="0.5,1,1.5"/></phase>'),
    "sggx": phased(
        f'<phase type="sggx"><volume type="gridvolume" name="S">{FILE("flakes.vol")}</volume></phase>'
    ),
    "blendphase": phased(
        f'<phase type="blendphase"><float name="weight" value="0.5"/>{ISOTROPIC}<phase type="hg"/></phase>'
    ),
}

SENSORS = {
    "perspective": Case(BALL.format("")),
    "thinlens": Case(
        BALL.format(""),
        seen=SENSOR.replace('"perspective"', '"thinlens"').replace(
            "<film", '<float name="aperture_radius" value="0.02"/><film', 1
        )
        + WALL,
    ),
    "orthographic": sensor("orthographic", refused="OrthographicCamera.*perspective"),
    "radiancemeter": sensor("radiancemeter"),
    "distant": sensor("distant"),
    "irradiancemeter": Case(
        BALL.format(f'<sensor type="irradiancemeter">{PIXEL}</sensor>'),
        seen=WALL,
        refused="perspective",
    ),
    "batch": sensor("batch", '<sensor type="perspective"/>', refused="BatchSensor.*perspective"),
}

PLUGINS = SURFACES | SHAPES | EMITTERS | TEXTURES | MEDIA | SENSORS


def write_files(folder):
    """The files that the cases read."""
    import mitsuba as mi

    random = np.random.default_rng(1)
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) * 0.8
    faces = [(0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
    (folder / "mesh.obj").write_text(vertices + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces))
    colors = (corners > 0) * 0.8 + 0.1
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "r", "g", "b"))
    rows = "".join(" ".join(map(str, (*p, *c))) + "\n" for p, c in zip(corners, colors, strict=True))
    (folder / "mesh.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 8\n{names}element face 12\nproperty list uchar int vertex_indices\n"
        f"end_header\n{rows}" + "".join(f"3 {a} {b} {c}\n" for a, b, c in faces)
    )
    (folder / "mesh.serialized").write_bytes(_serialized(corners, np.array(faces)))
    curve = "".join(f"{x} {0.1 * np.sin(9 * x)} -1.2 0.04\n" for x in np.linspace(-0.3, 0.3, 8))
    (folder / "curves.txt").write_text(curve)
    (folder / "ended.txt").write_text(curve + "\n" + "0 0 -1.2 0\n" * 4)
    names = (
        "x",
        "y",
        "z",
        "nx",
        "ny",
        "nz",
        "opacity",
        *(f"scale_{k}" for k in range(3)),
        *(f"rot_{k}" for k in range(4)),
    )
    header = "".join(f"property float {name}\n" for name in names)
    rows = "-0.15 0 -1.2 0 0 0 1 -3 -3.5 -3 1 0 0 0\n0.15 0 -1.2 0 0 0 1 -3.5 -3 -3.5 1 0 0 0\n"
    (folder / "ellipsoids.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 2\n{header}end_header\n{rows}"
    )
    axis = (np.arange(8) + 0.5) / 8 - 0.5
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    _write_volume(folder / "distance.vol", np.sqrt(x * x + y * y + z * z)[..., None] - 0.35)
    _write_volume(folder / "density.vol", random.uniform(0.2, 1, (4, 4, 4, 1)))
    _write_volume(folder / "colors.vol", random.uniform(0.2, 0.8, (4, 4, 4, 3)))
    _write_volume(folder / "flakes.vol", np.broadcast_to((1, 1, 0.2, 0, 0, 0), (2, 2, 2, 6)))
    picture = random.uniform(0.2, 0.9, (8, 8, 3)).astype(np.float32)
    normals = random.normal(0, 0.15, (8, 8, 3)) + (0, 0, 1)
    normals = 0.5 + 0.5 * normals / np.linalg.norm(normals, axis=2, keepdims=True)
    for name, values in (("picture.png", picture), ("normals.png", normals)):
        bitmap = mi.Bitmap(np.round(255 * values).astype(np.uint8))
        bitmap.write(str(folder / name))
    mi.Bitmap(random.uniform(0, 1, (8, 16, 3)).astype(np.float32)).write(str(folder / "sky.exr"))
    _write_tensors(folder / "measured.bsdf", _measured())
    _write_tensors(folder / "measured.pbsdf", {"M": np.zeros((1, 1, 1, 1, 4, 4), np.float32)})


def _serialized(vertices, faces):
    """Mitsuba's format of compressed meshes, version 4: single precision, no normals."""
    content = struct.pack("<I", 0x1000) + b"mesh\0" + struct.pack("<QQ", len(vertices), len(faces))
    content += vertices.astype("<f4").tobytes() + faces.astype("<u4").tobytes()
    mesh = struct.pack("<HH", 0x041C, 4) + zlib.compress(content)
    return mesh + struct.pack("<QI", 0, 1)


def _write_volume(path, values):
    """Mitsuba's format of volumes, version 3, in the unit cube."""
    depth, height, width, channels = values.shape
    header = b"VOL" + struct.pack("<B5i6f", 3, 1, width, height, depth, channels, 0, 0, 0, 1, 1, 1)
    path.write_bytes(header + np.ascontiguousarray(values, "<f4").tobytes())


def _write_tensors(path, fields):
    """Mitsuba's format of tensors, version 1.0."""
    kinds = {"uint8": 1, "uint16": 3, "float32": 10}
    heads = sum(2 + len(name) + 2 + 1 + 8 + 8 * value.ndim for name, value in fields.items())
    header, data, offset = b"tensor_file\0" + struct.pack("<BBI", 1, 0, len(fields)), b"", 18 + heads
    for name, value in fields.items():
        head = struct.pack("<H", len(name)) + name.encode()
        head += struct.pack("<HBQ", value.ndim, kinds[value.dtype.name], offset + len(data))
        header += head + struct.pack(f"<{value.ndim}Q", *value.shape)
        data += value.tobytes()
    path.write_bytes(header + data)


def _measured():
    """A measured surface that scatters evenly."""
    angles, size = np.linspace(0, np.pi / 2, 4, dtype=np.float32), 32

    def even(*shape):
        return np.ones((*shape, size, size), np.float32)

    # microfacets that face all ways: over u = sqrt(2 theta / pi) their density goes as u sin(theta) cos(theta)
    u = np.linspace(0, 1, size, dtype=np.float32)
    facets = (u * np.sin(np.pi * u * u) * even(1, len(angles))).astype(np.float32)
    return {
        "description": np.frombuffer(b"even", np.uint8),
        "theta_i": angles,
        "phi_i": np.zeros(1, np.float32),
        "sigma": even(),
        "ndf": even(),
        "vndf": facets,
        "luminance": even(1, len(angles)),
        "rgb": np.float32(0.2) * even(1, len(angles), 3),
        "jacobian": np.ones(1, np.uint8),
    }
