"""Scenes of Mitsuba's files: their parts come as the file has them, and many small meshes become few."""

import numpy as np
import pytest

from holopath_addon.engine.scene.meshes import joining
from holopath_addon.exchange.mitsuba_file import MitsubaFile

SENSOR = """<sensor type="perspective"><float name="fov" value="50"/><transform name="to_world">
<lookat origin="4,4,-9" target="4,4,0" up="0,1,0"/></transform></sensor>"""
MATERIAL = '<bsdf type="diffuse" id="color {0}"><rgb name="reflectance" value="0.{0}, 0.5, 0.2"/></bsdf>'
BOX = """<shape type="cube" id="box.{number}"><ref id="color {color}"/>{more}
<transform name="to_world"><scale value="0.3"/><translate x="{x}" y="{y}" z="{z}"/></transform></shape>"""
SHINES = '<emitter type="area"><rgb name="radiance" value="{number}, 2, 3"/></emitter>'
FLIPPED = '<boolean name="flip_normals" value="true"/>'
FLAT = '<boolean name="face_normals" value="true"/>'
SKY = '<emitter type="constant"/>'


def boxes(count, colors, more=lambda number: ""):
    """Boxes of so many colors, the next further up, or to the right."""
    return "".join(
        BOX.format(number=n, color=n % colors, more=more(n), x=n % 9, y=n // 9 % 9, z=n // 81)
        for n in range(count)
    )


@pytest.fixture
def built(backend, tmp_path):
    """Build a scene of some elements."""

    def build(*elements, colors=20):
        path = tmp_path / "scene.xml"
        materials = "".join(MATERIAL.format(color) for color in range(colors))
        path.write_text(f'<scene version="3.0.0">{SENSOR}{materials}{"".join(elements)}</scene>')
        return MitsubaFile(path).build((16, 16))

    return build


def names(shapes):
    return [shape.id() for shape in shapes]


def test_parts_come_as_the_file_has_them(built):
    """By Mitsuba's own joining their order is another one in each process."""
    scene = built(boxes(60, 20, lambda n: SHINES.format(number=n) if n % 7 == 3 else "")).scene
    assert names(scene.shapes()) == [f"box.{number}" for number in range(60)]
    assert names(emitter.get_shape() for emitter in scene.emitters()) == [
        f"box.{n}" for n in range(60) if n % 7 == 3
    ]


def test_a_material_on_flipped_and_other_normals(built):
    """Mitsuba refuses it, as it would join them."""
    scene = built(boxes(2, 1, lambda n: FLIPPED if n else "")).scene
    assert [shape.has_flipped_normals() for shape in scene.shapes()] == [False, True]


def seen(built):
    import mitsuba as mi

    from holopath_addon import engine

    return engine.Preview(built.scene, built.camera, 16, 16).refine(16), mi


def test_what_is_joined_looks_the_same_to_the_bit(built, monkeypatch):
    def more(n):
        return "" if n % 50 else FLIPPED if n % 100 else FLAT

    parts = boxes(160, 3, more), SKY
    joined = built(*parts)
    found = names(joined.scene.shapes())
    assert found[:4] == ["box.0", "box.1 and 51 more", "box.2 and 51 more", "box.3 and 51 more"]
    assert len(found) == 3 + 4  # by color, and those that differ in a flag
    image, _ = seen(joined)
    monkeypatch.setattr(joining, "MANY_MESHES", 10**9)
    separate = built(*parts)
    assert len(separate.scene.shapes()) == 160
    assert np.array_equal(image, seen(separate)[0])


def test_meshes_of_many_triangles_are_few_to_a_mesh(built, monkeypatch):
    monkeypatch.setattr(joining, "MAX_TRIANGLES", 120)
    scene = built(boxes(100, 1)).scene
    assert [shape.face_count() for shape in scene.shapes()] == [120] * 10


def test_what_stays_as_it_is(built):
    ground = """<shape type="rectangle"><transform name="to_world"><scale value="20"/></transform></shape>"""
    ball = '<shape type="sphere" id="ball"><ref id="color 0"/></shape>'
    haze = '<medium type="homogeneous" name="interior"/>'
    scene = built(boxes(80, 1, lambda n: haze if n == 5 else ""), ground, ball, SKY).scene
    assert names(scene.shapes())[:2] == ["box.0 and 78 more", "box.5"]
    assert len(scene.shapes()) == 4 and scene.environment() is not None
