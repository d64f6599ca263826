"""Command `holopath report` with a comparison with the path tracer."""

import csv
import xml.etree.ElementTree as ElementTree

import pytest

from holopath_addon import cli, engine
from holopath_addon.cli import sources
from holopath_addon.cli.report_page import svg_sketch
from holopath_addon.engine.viewing import bench_sketch
from holopath_addon.exchange.mitsuba_file import UNLIMITED_DEPTH

SCENE = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="40"/>
 <transform name="to_world"><lookat origin="0,0,0" target="0,0,1" up="0,1,0"/></transform></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="{size}"/><rotate y="1" angle="180"/>
 <translate z="0.5"/></transform><emitter type="area"><rgb name="radiance" value="1,0.6,0.3"/></emitter></shape>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate y="1" angle="180"/>
 <translate z="2"/></transform><emitter type="area"><rgb name="radiance" value="0.1,0.2,0.4"/></emitter></shape>
</scene>"""


@pytest.fixture
def scenes(tmp_path):
    """An emissive square before a wall, and one half as large."""
    paths = [tmp_path / f"{size}.xml" for size in (0.08, 0.04)]
    for path in paths:
        path.write_text(SCENE.format(size=path.stem))
    return paths


def test_comparison_with_the_path_tracer(scenes, backend, tmp_path, capsys):
    """Figures are better with the field's own scene; speckle is at most that of the number of frames."""
    out = tmp_path / "out"
    words = ["--resolution", "64x64", "--frames", "8", "--depth-range", "0.5,1", "--phase-field", "random"]
    assert cli.main(["render", str(scenes[0]), *words, "--quiet", "--out", str(out)]) == 0

    def figures_beside(scene):
        assert cli.main(["report", str(out), "--scene", str(scene), "--paths", "8"]) == 0
        with (out / "report.csv").open() as file:
            rows = [row for row in csv.reader(file) if row[0] in ("PSNR, dB", "SSIM", "speckle")]
        return {(what, where): float(value) for what, where, value in rows}

    right, wrong = map(figures_beside, scenes)
    assert "is not the scene of the field" in capsys.readouterr().err
    scenes[0].write_text(scenes[1].read_text())
    assert cli.main(["report", str(out), "--scene"]) == 2
    assert "has changed since the render" in capsys.readouterr().err
    assert right.keys() == wrong.keys() and len(right) == 3 * 7 + 13 + 4
    page = (out / "report.html").read_text()
    assert (
        "<h2>Beside Path Tracing</h2>" in page
        and "<h2>Bench</h2><figure><svg" in page
        and page.count("<img") == 5
        and "http" not in page
    )
    for key, value in right.items():
        if key[0] == "PSNR, dB" and "pupil" not in key[1]:
            assert value > 18 and value > wrong[key] + 3
        if key[0] == "speckle":
            assert 0.1 < value < 1.1 * 8**-0.5  # less in focus, where frames of phases are equally bright


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--scene", "none.xml"], "none.xml does not exist"),
        (["--at-frame", "3"], "Expected --scene with --at-frame. Add it"),
        (["--scene"], "does not name a scene"),
        (["--scene", "0.08.xml", "--at-frame", "3"], "has no frames"),
        (["--scene", "0.08.xml", "--paths", "1"], "2 to 65536 paths"),
    ],
)
def test_refusals_leave_nothing(words, says, scenes, tmp_path, monkeypatch, capsys):
    from tests.exchange import fields

    fields.field().save(tmp_path / "out" / "wavefield")
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert cli.main(["report", "out", *words]) == 2
    assert says in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("integrator", "depth"),
    [
        ("", UNLIMITED_DEPTH),
        ('<integrator type="path"><integer name="max_depth" value="3"/></integrator>', 3),
    ],
)
def test_light_beside_an_imported_hologram_is_the_scenes(integrator, depth, scenes, backend, tmp_path):
    """Its report has no settings."""
    from tests.exchange import fields

    field = fields.field()
    field.save(tmp_path / "out" / "wavefield")
    scenes[0].write_text(scenes[0].read_text().replace("<sensor", f"{integrator}<sensor"))
    reopened = sources.reopen(tmp_path / "out", field, str(scenes[0]))
    assert (reopened.settings, reopened.max_depth, reopened.same) == (None, depth, False)


def test_the_sketch_of_the_bench():
    """The page has all lines and texts of the drawing, and those in ink have the color of its text."""
    hologram = engine.Hologram(256, 128, 8e-6, optics=engine.Optics(carrier="auto"))
    drawing, page = bench_sketch.drawing(hologram), ElementTree.fromstring(svg_sketch(hologram))
    assert [each.text for each in page.iter("text")] == [text.text for text in drawing.texts]
    assert len([*page.iter("polyline"), *page.iter("polygon")]) == len(drawing.lines)
    inks = [each for each in page.iter() if "currentColor" in (each.get("stroke"), each.get("fill"))]
    assert len(inks) == len(drawing.texts) + sum(line.role == bench_sketch.INK for line in drawing.lines)
    assert page.get("viewBox").split()[3] == f"{drawing.height:.0f}"
