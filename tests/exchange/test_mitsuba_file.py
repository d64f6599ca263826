"""Mitsuba scene files: film, crop window and view; old plugins; parameters."""

import re

import numpy as np
import pytest

from holopath_addon import cli, engine
from holopath_addon.cli import sources
from holopath_addon.exchange import mitsuba_file

SCENE = """<scene version="{version}">{head}
<sensor type="{sensor}" id="viewer">{fov}{more}
 <transform name="to_world"><lookat origin="0.2,0,0" target="0,0.1,1" up="0,1,0"/>{moved}</transform>
 <sampler type="{sampler}"/>
 <film type="{film}">{size}<rfilter type="{rfilter}"/></film></sensor>
<shape type="sphere"><point name="center" x="0.02" y="0.1" z="0.5"/><float name="radius" value="0.1"/>
 <emitter type="area"><rgb name="radiance" value="1,0.2,0.1"/></emitter></shape>
<shape type="rectangle"><transform name="to_world"><scale x="0.6" y="0.5"/><rotate y="1" angle="180"/>
 <translate z="1.5"/></transform>
 <emitter type="area"><rgb name="radiance" value="0.1,0.4,0.2"/></emitter></shape>
</scene>"""
PLAIN = {
    "version": "3.0.0",
    "head": "",
    "sensor": "perspective",
    "fov": '<float name="fov" value="40"/>',
    "more": "",
    "moved": "",
    "sampler": "independent",
    "film": "hdrfilm",
    "size": "",
    "rfilter": "box",
}
SPP = 64


def sized(width, height, *crop):
    """The film's size, and its crop window: left, top, width, height."""
    names = ("width", "height", "crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
    return "".join(
        f'<integer name="{name}" value="{value}"/>'
        for name, value in zip(names, (width, height, *crop), strict=False)
    )


@pytest.fixture
def written(backend, tmp_path):
    """Write a scene file."""

    def write(name="scene.xml", **parts):
        path = tmp_path / name
        path.write_text(SCENE.format(**PLAIN | parts))
        return path

    return write


def view(path, size=None):
    """The engine's path-traced view, as large as the file's hologram or as `size`, and the notes."""
    source = sources.open_source(str(path))
    hologram = source.hologram_from()
    loaded = source.load(*(size or (hologram.width, hologram.height)))
    width, height = size or (hologram.width, hologram.height)
    return engine.Preview(loaded.scene, loaded.camera, width, height).refine(SPP), loaded.notes


def by_mitsuba(path):
    import mitsuba as mi

    return np.array(mi.render(mi.load_file(str(path)), integrator=mi.load_dict({"type": "path"}), spp=SPP))


def near(ours, theirs):
    assert ours.shape == theirs.shape
    assert np.abs(ours - theirs).mean() < 0.005 < theirs.std()


REFLECTED = '<scale x="-1"/>'
OFFSET = '<float name="principal_point_offset_x" value="0.1"/><float name="principal_point_offset_y" value="-0.2"/>'


@pytest.mark.parametrize(
    "parts",
    [
        {"size": sized(30, 20)},
        {"size": sized(30, 20, 12, 2, 16, 14), "moved": REFLECTED},
        {"size": sized(30, 20, 4, 5, 20, 12), "more": OFFSET},
        {"size": sized(20, 30), "fov": '<string name="focal_length" value="40mm"/>'},
    ],
)
def test_film_and_crop_window(written, parts):
    """A hologram has the size that Mitsuba's picture has, and shows the same."""
    path = written(**parts)
    picture, notes = view(path)
    near(picture, by_mitsuba(path))
    assert notes == []


@pytest.mark.parametrize("axis", ["x", "y", "smaller", "larger", "diagonal"])
def test_another_shape_than_the_film(written, axis):
    """It is as Mitsuba has it with a film of that size, and that is said."""
    more = f'<string name="fov_axis" value="{axis}"/>'
    picture, [note] = view(written(size=sized(30, 20), more=more), (20, 24))
    near(picture, by_mitsuba(written("other.xml", size=sized(20, 24), more=more)))
    assert note["object"] == "film" and mitsuba_file._AXES[axis] in note["effect"]


def test_a_crop_window_of_another_size(written):
    """It shows the same with more pixels, and where it has another shape its middle stays."""
    path = written(size=sized(30, 20, 12, 2, 16, 14))
    small, _ = view(path)
    large, notes = view(path, (32, 28))
    near(large.reshape(14, 2, 16, 2, 3).mean((1, 3)), small)
    assert notes == []
    wide, [note] = view(path, (16, 10))
    near(wide, small[2:12])
    assert note["object"] == "crop window" and "the width" in note["effect"]


def test_a_film_that_says_nothing_is_mitsubas(written):
    film = sources.open_source(str(written())).hologram_from()
    assert (film.width, film.height) == (768, 576)


def test_of_several_sensors_the_chosen_one(written):
    path = written(size=sized(30, 20))
    second = re.search(r"<sensor.*</sensor>", path.read_text(), re.S)[0].replace("viewer", "other")
    path.write_text(path.read_text().replace("</scene>", second.replace('"30"', '"40"') + "</scene>"))
    source = sources.open_source(str(path))
    assert [source.hologram_from(name).width for name in (None, "viewer", "other")] == [30, 30, 40]
    path.write_text(path.read_text().replace('perspective" id="viewer"', 'sphericalcamera" id="viewer"'))
    assert source.load(40, 20, "other").scene.sensors()[1].film().size()[0] == 40
    with pytest.raises(engine.InvalidInput, match="Expected a sensor of"):
        source.hologram_from("third")


OLD = {"film": "ldrfilm", "sampler": "sobol", "rfilter": "wiener", "size": sized(30, 20)}


def test_unknown_films_integrators_samplers_and_filters_stop_no_scene(written):
    head = '<integrator type="bdpt"><integer name="maxDepth" value="3"/><boolean name="hideEmitters" value="true"/>'
    old = written(**OLD, version="0.6.0", head=f"{head}</integrator>")
    assert "hide_emitters" in [note["feature"] for note in view(old)[1]]
    near(view(old)[0], by_mitsuba(written("plain.xml", size=sized(30, 20))))
    source = sources.open_source(str(old))
    assert source.settings.max_depth == 3 and not source.load(30, 20).camera.sees_sky


@pytest.mark.parametrize(
    ("integrator", "depth"),
    [
        ("", 32),
        ('<integrator type="direct"/>', 2),
        ('<integrator type="path"><integer name="max_depth" value="65"/></integrator>', 64),
        ('<integrator type="path"><integer name="max_depth" value="-1"/></integrator>', 32),
        ('<integrator type="aov"><integrator type="path"><integer name="max_depth" value="2"/></integrator>'
         "</integrator>", 2),
    ],
)  # fmt: skip
def test_paths_are_as_long_as_the_integrators(written, integrator, depth):
    assert sources.open_source(str(written(head=integrator))).settings.max_depth == depth


@pytest.mark.parametrize(
    ("parts", "object_name", "says"),
    [
        ({"sensor": "thinlens", "more": '<float name="aperture_radius" value="0.05"/>'
          '<float name="focus_distance" value="0.5"/>'}, "sensor", "--focus 0.5m"),
        ({"more": '<spectrum name="srf" value="1"/>'}, "sensor", "colors are RGB"),
        ({"film": "specfilm"}, "film", "its bands are ignored"),
        ({"size": '<string name="pixel_format" value="luminance"/>'}, "film", "in color"),
        ({"head": '<integrator type="depth"/>'}, "integrator", "shows light"),
    ],
)  # fmt: skip
def test_what_changes_mitsubas_picture_is_noted(written, parts, object_name, says):
    [note] = sources.open_source(str(written(**parts))).load(24, 18).notes
    assert note["object"] == object_name and says in note["effect"]


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"more": '<bsdf type="phong"/>'}, 'Plugin "phong" not found'),
        ({"more": '<float name="zoom" value="2"/>'}, r'1 unreferenced property in sensor .*"zoom"'),
        ({"moved": '<scale value="2"/>'}, "Scale factors in the camera-to-world transformation"),
        ({"size": sized(30, 20, 12, 2, 20, 14)}, "crop window of 20 x 14 pixels at 12, 2 does"),
        ({"size": '<float name="width" value="2.5"/>'}, "as a whole number of pixels, got 2.5"),
        ({"sensor": "sphericalcamera"}, 'Plugin "sphericalcamera" not found'),
    ],
)  # fmt: skip
def test_what_mitsuba_refuses_is_one_sentence(written, parts, says, capfd):
    assert cli.main(["plan", str(written(**parts)), "--quality", "draft"]) == 2
    [line] = [line for line in capfd.readouterr().err.splitlines() if line.startswith("holopath: ")]
    assert re.search(says, line) and ".cpp" not in line


# -- parameters

WIDTH = '<integer name="width" value="$width"/><integer name="height" value="20"/>'


@pytest.mark.parametrize(
    ("default", "words", "says"),
    [
        ("", [], "without a default. Add --define width=VALUE"),
        ("", ["-D", "width"], "Expected NAME=VALUE, for example width=640, got 'width'"),
        ("", ["--define=wide th=3"], "Expected NAME=VALUE, for example width=640, got 'wide th=3'"),
        ("", ["-Dwidth=16", "--define", "size=3"], "to define. It has width"),
        ('<default name="width" value="16"/>', ["-D", "wid=3"], r"no parameter \$wid to define"),
        ("", ["-D", "width=wide"], "could not parse integer value \"wide\""),
    ],
)  # fmt: skip
def test_parameters_that_are_wrong(written, default, words, says, capfd):
    assert cli.main(["plan", str(written(head=default, size=WIDTH)), *words]) == 2
    [line] = [line for line in capfd.readouterr().err.splitlines() if line.startswith("holopath: ")]
    assert re.search(says, line)


def test_a_demo_has_no_parameters(capfd):
    assert cli.main(["plan", "demo:planes", "-D", "width=16"]) == 2
    assert "demo:planes has no parameters to define. Omit --define" in capfd.readouterr().err


@pytest.mark.parametrize("name", ["width", "filename"])
def test_parameters(written, name):
    """Also by names that Mitsuba's own reader takes for its own; a default stands back."""
    size = WIDTH.replace("$width", f"${name}")
    path = written(head=f'<default name="{name}" value="3"/>', size=size)
    for define, width in (({}, 3), ({name: "16"}, 16)):
        source = sources.open_source(str(path), define=define)
        assert source.hologram_from().width == width
        assert source.load(16, 20).scene.sensors()[0].film().size()[0] == width


def test_files_that_a_parameter_names(written, tmp_path):
    picture = '<emitter type="envmap"><string name="filename" value="$sky.exr"/></emitter>'
    path = written(head=f'<default name="sky" value="day"/>{picture}')
    for name in ("day.exr", "night.exr"):
        (tmp_path / name).write_bytes(b"")
    assert set(sources.open_source(str(path)).files) == {"scene.xml", "day.exr"}
    assert set(sources.open_source(str(path), define={"sky": "night"}).files) == {"scene.xml", "night.exr"}


def test_the_definitions_of_a_render_are_found_again(written, tmp_path, capfd):
    """`encode` finds the scene and gives the phases of a render that encodes; `report` finds it, too."""
    path = written(head='<default name="width" value="64"/>', size=WIDTH)
    out = tmp_path / "out"
    words = ["--wavelengths", "516.5", "--quality", "draft", "--frames", "2", "--focus", "1m"]
    assert cli.main(["render", str(path), *words, "-D", "width=24", "--out", str(out)]) == 0
    attributes = capfd.readouterr().err
    assert (
        "24 x 20 pixels, the size of the film in scene.xml; --resolution WxH for another one." in attributes
    )
    assert sources.output.read_report(out)["opened"]["define"] == {"width": "24"}
    field = sources.output.stored_field(out)
    assert (field.hologram.width, field.hologram.height) == (24, 20)
    assert sources.reopen(out, field).same
    path.write_text(path.read_text().replace("$width", "24"))  # which no longer has it
    assert sources.reopen(out, field).same
    with pytest.raises(engine.InvalidInput, match="no parameter"):
        sources.reopen(out, field, define={"width": "32"})
