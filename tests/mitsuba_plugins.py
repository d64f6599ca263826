"""A scene for every plugin that a Mitsuba scene may hold, and what HoloPath makes of it: the table of the tests.

`PLUGINS` has a row for each installed plugin that is a part of a scene. Films, samplers, reconstruction filters and
integrators are none: of a scene file HoloPath takes what is in view, and where the viewer stands.
"""

import struct
import zlib
from dataclasses import dataclass

import numpy as np

KINDS = ("BSDF", "Shape", "Emitter", "Texture", "Medium", "Sensor", "Volume", "PhaseFunction")

SENSOR = """<sensor type="perspective" id="viewer"><float name="fov" value="40"/>
 <transform name="to_world"><lookat origin="0,0,0" target="0,0,-1" up="0,1,0"/></transform>
 <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="24"/></film></sensor>"""
WALL = """<shape type="rectangle" id="wall"><transform name="to_world"><scale value="0.9"/><translate z="-2"/></transform>
 <bsdf type="diffuse"><rgb name="reflectance" value="0.5,0.4,0.3"/></bsdf></shape>"""
LAMP = """<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.4"/>
 <lookat origin="0.3,0.6,0.2" target="0,0,-1.4" up="0,1,0"/></transform>
 <emitter type="area"><rgb name="radiance" value="9,9,9"/></emitter></shape>"""
SCENE = '<scene version="3.0.0">{}</scene>'

# One surface in four ways: a ball, a pane with two sides, a masked ball, and a box that is instanced.
WORN = """<shape type="sphere"><point name="center" value="-0.17,0.17,-1"/><float name="radius" value="0.14"/>{ref}</shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.14"/><rotate y="1" angle="200"/>
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
    bright : float or None
        How far each quarter's brightness may be from the reference's, relative; None where that is wrong itself.
    lit : str
        The lamps, if the case has none.
    seen : str
        Where the viewer stands, and the wall behind all.
    """

    parts: str
    refused: str = ""
    noted: str = ""
    bright: float | None = 0.15
    lit: str = LAMP
    seen: str = SENSOR + WALL

    def xml(self, folder):
        """The scene file's text."""
        return SCENE.format((self.seen + self.lit + self.parts).replace("{folder}", str(folder)))


def surface(bsdf, sides=1, **more):
    """A case with a BSDF worn in four ways; of those with two `sides` of their own the pane needs no `twosided`."""
    named = bsdf.replace("<bsdf ", '<bsdf id="surface" ', 1)
    ref = '<ref id="surface"/>'
    two = ref if sides == 2 else f'<bsdf type="twosided">{ref}</bsdf>'
    return Case(named + WORN.format(ref=ref, two=two), **more)


def textured(texture, **more):
    """A case with a texture on a ball and a pane."""
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
    film = '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/><rfilter type="box"/></film>'
    return Case(
        BALL.format(""),
        seen=f'<sensor type="{kind}" id="viewer">{body}{film}</sensor>{WALL}',
        refused=refused,
    )


BALL = """<shape type="sphere"><point name="center" value="0,0,-1.2"/><float name="radius" value="0.2"/>{}</shape>"""
AT = '<transform name="to_world"><scale value="0.2"/><rotate x="1" y="1" angle="30"/><translate z="-1.2"/></transform>'
FILE = '<string name="filename" value="{{folder}}/{}"/>'.format
RED = '<rgb name="reflectance" value="0.7,0.2,0.1"/>'
NESTED = f'<bsdf type="twosided"><bsdf type="diffuse">{RED}</bsdf></bsdf>'
SPECTRUM = "spectral"
ISOTROPIC = '<phase type="isotropic"/>'


def phased(phase):
    return medium("homogeneous", phase)


SURFACES = {
    "diffuse": surface(f'<bsdf type="diffuse">{RED}</bsdf>'),
    "conductor": surface('<bsdf type="conductor"><string name="material" value="Au"/></bsdf>'),
    "roughconductor": surface(
        '<bsdf type="roughconductor"><string name="material" value="Cu"/><float name="alpha" value="0.25"/></bsdf>'
    ),
    "plastic": surface('<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.1,0.2,0.5"/></bsdf>'),
    "roughplastic": surface('<bsdf type="roughplastic"><float name="alpha" value="0.2"/></bsdf>'),
    "pplastic": surface('<bsdf type="pplastic"><float name="alpha" value="0.2"/></bsdf>'),
    "principled": surface(
        """<bsdf type="principled"><rgb name="base_color" value="0.6,0.3,0.1"/><float name="roughness" value="0.4"/>
        <float name="metallic" value="0.3"/><float name="clearcoat" value="0.5"/></bsdf>"""
    ),
    "principledthin": surface(
        '<bsdf type="principledthin"><float name="diff_trans" value="0.6"/><float name="roughness" value="0.4"/></bsdf>',
        2,
    ),
    "dielectric": surface('<bsdf type="dielectric"/>', 2),
    "roughdielectric": surface('<bsdf type="roughdielectric"><float name="alpha" value="0.2"/></bsdf>', 2),
    "thindielectric": surface('<bsdf type="thindielectric"/>', 2),
    "null": surface('<bsdf type="null"/>', 2),
    "hair": surface('<bsdf type="hair"/>', 2),
    "measured": surface(f'<bsdf type="measured">{FILE("measured.bsdf")}</bsdf>'),
    "measured_polarized": surface(
        f'<bsdf type="measured_polarized">{FILE("measured.pbsdf")}</bsdf>', refused="measured_?polarized"
    ),
    "polarizer": surface('<bsdf type="polarizer"/>', 2, noted="polari"),
    "retarder": surface('<bsdf type="retarder"/>', 2, noted="polari"),
    "circular": surface('<bsdf type="circular"/>', 2, noted="polari"),
    "twosided": surface(
        f'<bsdf type="twosided"><bsdf type="diffuse">{RED}</bsdf><bsdf type="conductor"/></bsdf>', 2
    ),
    "mask": surface(f'<bsdf type="mask"><float name="opacity" value="0.4"/>{NESTED}</bsdf>', 2),
    "blendbsdf": surface(
        f'<bsdf type="blendbsdf"><float name="weight" value="0.3"/><bsdf type="diffuse">{RED}</bsdf><bsdf type="roughconductor"/></bsdf>'
    ),
    "bumpmap": surface(
        f'<bsdf type="bumpmap"><texture type="bitmap" name="bump">{FILE("picture.png")}<boolean name="raw" value="true"/></texture>'
        '<float name="scale" value="0.05"/><bsdf type="roughplastic"/></bsdf>'
    ),
    "normalmap": surface(
        f'<bsdf type="normalmap"><texture type="bitmap" name="normalmap">{FILE("normals.png")}<boolean name="raw" value="true"/></texture>'
        '<bsdf type="roughconductor"/></bsdf>'
    ),
}

# nested as scene files nest them
NESTS = {
    "twosided(mask)": surface(
        f'<bsdf type="twosided"><bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="diffuse">{RED}</bsdf></bsdf></bsdf>',
        2,
        refused="twosided|transmission",
    ),
    "twosided(dielectric)": surface(
        '<bsdf type="twosided"><bsdf type="dielectric"/></bsdf>', 2, refused="transmission"
    ),
    "mask(twosided(blend))": surface(
        f"""<bsdf type="mask"><float name="opacity" value="0.7"/><bsdf type="twosided"><bsdf type="blendbsdf">
        <float name="weight" value="0.5"/><bsdf type="diffuse">{RED}</bsdf><bsdf type="plastic"/></bsdf></bsdf></bsdf>""",
        2,
        bright=None,
    ),
    "mask(mask)": surface(
        f'<bsdf type="mask"><float name="opacity" value="0.7"/><bsdf type="mask"><float name="opacity" value="0.6"/>{NESTED}</bsdf></bsdf>',
        2,
    ),
    "mask by an image": surface(
        f'<bsdf type="mask"><texture type="bitmap" name="opacity">{FILE("picture.png")}</texture>{NESTED}</bsdf>',
        2,
    ),
    "blend(glass, diffuse)": surface(
        f'<bsdf type="blendbsdf"><float name="weight" value="0.5"/><bsdf type="dielectric"/><bsdf type="diffuse">{RED}</bsdf></bsdf>',
        2,
        bright=None,
    ),
    "blend(blend)": surface(
        f"""<bsdf type="blendbsdf"><float name="weight" value="0.5"/><bsdf type="blendbsdf"><float name="weight" value="0.5"/>
        <bsdf type="diffuse">{RED}</bsdf><bsdf type="roughplastic"/></bsdf><bsdf type="roughconductor"/></bsdf>"""
    ),
    "blend(null, diffuse)": surface(
        f'<bsdf type="blendbsdf"><float name="weight" value="0.5"/><bsdf type="null"/><bsdf type="diffuse">{RED}</bsdf></bsdf>',
        2,
    ),
    "bump(glass)": surface(
        f'<bsdf type="bumpmap"><texture type="bitmap" name="bump">{FILE("picture.png")}<boolean name="raw" value="true"/></texture>'
        '<float name="scale" value="0.02"/><bsdf type="roughdielectric"/></bsdf>',
        2,
    ),
    "normal(principled)": surface(
        f'<bsdf type="normalmap"><texture type="bitmap" name="normalmap">{FILE("normals.png")}<boolean name="raw" value="true"/></texture>'
        '<bsdf type="principled"><float name="roughness" value="0.3"/></bsdf></bsdf>'
    ),
    "twosided(normal(bump))": surface(
        f"""<bsdf type="twosided"><bsdf type="normalmap"><texture type="bitmap" name="normalmap">{FILE("normals.png")}
        <boolean name="raw" value="true"/></texture><bsdf type="bumpmap"><texture type="bitmap" name="bump">{FILE("picture.png")}
        <boolean name="raw" value="true"/></texture><float name="scale" value="0.02"/><bsdf type="diffuse">{RED}</bsdf></bsdf></bsdf></bsdf>""",
        2,
    ),
    "bump(mask)": surface(
        f"""<bsdf type="bumpmap"><texture type="bitmap" name="bump">{FILE("picture.png")}<boolean name="raw" value="true"/></texture>
        <float name="scale" value="0.02"/><bsdf type="mask"><float name="opacity" value="0.5"/>{NESTED}</bsdf></bsdf>""",
        2,
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
        <point name="center" value="0,1.2,0"/><float name="radius" value="0.5"/><bsdf type="dielectric"/></shape></shape>
        <shape type="instance"><ref id="group"/>{AT}</shape>"""
    ),
    "instance": Case(
        f"""<shape type="shapegroup" id="group"><shape type="ply">{FILE("mesh.ply")}{NESTED}</shape></shape>
        <shape type="instance"><ref id="group"/>{AT}</shape><shape type="instance"><ref id="group"/>
        <transform name="to_world"><scale x="-0.1" y="0.2" z="0.1"/><translate x="0.3" z="-1.4"/></transform></shape>"""
    ),
    "bsplinecurve": shape("bsplinecurve", FILE("curves.txt") + NESTED),
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
        <transform name="to_world"><lookat origin="0.3,0.4,0" target="0,0,-1.4" up="0,1,0"/></transform>""",
    ),
    "spot": emitter(
        "spot",
        '<transform name="to_world"><lookat origin="0.3,0.4,0" target="0,0,-1.4" up="0,1,0"/></transform>'
        '<rgb name="intensity" value="4"/><float name="cutoff_angle" value="30"/>',
    ),
    "sunsky": emitter("sunsky", '<vector name="sun_direction" value="0.3,0.4,0.8"/>'),
    "timed_sunsky": emitter("timed_sunsky"),
}

TEXTURES = {
    "bitmap": textured(f'<texture type="bitmap" name="reflectance">{FILE("picture.png")}</texture>'),
    "checkerboard": textured(
        """<texture type="checkerboard" name="reflectance"><transform name="to_uv"><scale value="4"/></transform></texture>"""
    ),
    "mesh_attribute": Case(
        f"""<shape type="ply">{FILE("mesh.ply")}{AT}<bsdf type="twosided"><bsdf type="diffuse">
        <texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_color"/></texture></bsdf></bsdf></shape>"""
    ),
    "volume": textured(
        f"""<texture type="volume" name="reflectance"><volume type="gridvolume" name="volume">{FILE("colours.vol")}
        <transform name="to_world"><translate x="-0.5" y="-0.5" z="-1.5"/></transform></volume></texture>"""
    ),
    "rawconstant": textured(
        '<texture type="rawconstant" name="reflectance"><float name="value" value="0.4"/></texture>'
    ),
    "srgb": textured(
        '<texture type="srgb" name="reflectance"><rgb name="color" value="0.4,0.3,0.2"/></texture>'
    ),
    "uniform": textured(
        '<spectrum type="uniform" name="reflectance"><float name="value" value="0.4"/></spectrum>'
    ),
    "d65": Case(BALL.format('<emitter type="area"><spectrum type="d65" name="radiance"/></emitter>')),
    "blackbody": Case(
        BALL.format(
            '<emitter type="area"><spectrum type="blackbody" name="radiance"><float name="temperature" value="4000"/></spectrum></emitter>'
        ),
        refused=SPECTRUM,
    ),
    "regular": textured(
        """<spectrum type="regular" name="reflectance"><float name="wavelength_min" value="400"/><float name="wavelength_max" value="700"/>
        <string name="values" value="0.1,0.3,0.5"/></spectrum>""",
        refused=SPECTRUM,
    ),
    "irregular": textured(
        """<spectrum type="irregular" name="reflectance"><string name="wavelengths" value="400,500,700"/>
        <string name="values" value="0.1,0.3,0.5"/></spectrum>""",
        refused=SPECTRUM,
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
        f'<texture type="volume" name="reflectance"><volume type="gridvolume" name="volume">{FILE("colours.vol")}</volume></texture>'
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
        BALL.format(
            '<sensor type="irradiancemeter"><film type="hdrfilm"><integer name="width" value="1"/>'
            '<integer name="height" value="1"/><rfilter type="box"/></film></sensor>'
        ),
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
    colours = (corners > 0) * 0.8 + 0.1
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "r", "g", "b"))
    rows = "".join(" ".join(map(str, (*p, *c))) + "\n" for p, c in zip(corners, colours, strict=True))
    (folder / "mesh.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 8\n{names}element face 12\nproperty list uchar int vertex_indices\n"
        f"end_header\n{rows}" + "".join(f"3 {a} {b} {c}\n" for a, b, c in faces)
    )
    (folder / "mesh.serialized").write_bytes(_serialized(corners, np.array(faces)))
    (folder / "curves.txt").write_text(
        "".join(f"{x} {0.1 * np.sin(9 * x)} -1.2 0.04\n" for x in np.linspace(-0.3, 0.3, 8))
    )
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
    rows = "-0.15 0 -1.2 0 0 0 1 0.05 0.03 0.05 1 0 0 0\n0.15 0 -1.2 0 0 0 1 0.03 0.05 0.03 1 0 0 0\n"
    (folder / "ellipsoids.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 2\n{header}end_header\n{rows}"
    )
    axis = (np.arange(8) + 0.5) / 8 - 0.5
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    _write_volume(folder / "distance.vol", np.sqrt(x * x + y * y + z * z)[..., None] - 0.35)
    _write_volume(folder / "density.vol", random.uniform(0.2, 1, (4, 4, 4, 1)))
    _write_volume(folder / "colours.vol", random.uniform(0.2, 0.8, (4, 4, 4, 3)))
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
    angles = np.linspace(0, np.pi / 2, 4, dtype=np.float32)
    size = 4

    def even(*shape):
        return np.ones((*shape, size, size), np.float32)

    return {
        "description": np.frombuffer(b"even", np.uint8),
        "theta_i": angles,
        "phi_i": np.zeros(1, np.float32),
        "sigma": even(),
        "ndf": even(),
        "vndf": even(1, len(angles)),
        "luminance": even(1, len(angles)),
        "rgb": np.float32(0.2) * even(1, len(angles), 3),
        "jacobian": np.ones(1, np.uint8),
    }
