"""Data sets: views with depths, light fields and fields, against the geometry of the scene."""

import csv
import math

import numpy as np
import pytest

from holopath_addon import cli, engine

# A lamp 0.5 m behind the viewer, in a mirror at 1 m that fills the view; a small disc at 0.5 m before it.
SCENE = """<scene version="3.0.0">
<sensor type="perspective" id="viewer"><float name="fov" value="20"/>
 <transform name="to_world"><lookat origin="0,0,0" target="0,0,1" up="0,1,0"/></transform></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate y="1" angle="180"/>
 <translate z="1"/></transform><bsdf type="conductor"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="9"/><translate z="-0.5"/></transform>
 <emitter type="area"><rgb name="radiance" value="0.2,0.2,0.2"/></emitter></shape>
<shape type="disk"><transform name="to_world"><scale value="0.02"/><rotate y="1" angle="180"/>
 <translate z="0.5"/></transform><emitter type="area"><rgb name="radiance" value="5,5,5"/></emitter></shape>
</scene>"""
SIZE = 48
STUDY = f"""scenes = ["mirror.xml"]

[settings]
resolution = "{SIZE}x{SIZE}"
depth_range = [0.5, 1.5]
wavelengths = 516.5
quality = "preview"
frames = 1
method = "full"
focus = "0.5m,2.5m"
rgbd = true
light_field = 3

"""
PIXELS = SIZE / (2 * math.tan(math.radians(10)))  # of a tangent of 1


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folders of two views of the mirror, and the table's rows."""
    folder = tmp_path_factory.mktemp("views")
    (folder / "mirror.xml").write_text(SCENE)
    views = "[views]\ncount = 2\nseed = 4\nright = 0.02\nforward = [0.0, 0.2]\nturn_left = 1\n"
    (folder / "views.toml").write_text(STUDY + views)
    assert cli.main(["study", str(folder / "views.toml"), "--quiet"]) == 0
    with open(folder / "views" / "table.csv", newline="") as lines:
        rows = list(csv.DictReader(lines))[::2]
    return [folder / "views" / row["folder"] for row in rows], rows


def test_a_sample_is_whole(made):
    folders, rows = made
    for folder, row in zip(folders, rows, strict=True):
        assert {path.name for path in folder.iterdir()} == {
            "wavefield", "reconstruction", "rgbd", "light_field", "report.json",
        }  # fmt: skip
        field = engine.WaveField.load(folder / "wavefield")
        assert field.data.shape == (1, 1, SIZE, SIZE)
        right, up, forward = map(float, row["move"].split(","))
        left, higher = map(float, row["turn"].split(","))
        assert abs(right) <= 0.02 and up == 0 and 0 <= forward <= 0.2 and abs(left) <= 1 and higher == 0
        # Mitsuba's camera looks along +z with x to the left
        np.testing.assert_allclose(field.camera.position, (-right, up, forward), atol=1e-6)
        angle = math.radians(left)
        np.testing.assert_allclose(field.camera.axes[2], (math.sin(angle), 0, math.cos(angle)), atol=1e-6)
    assert [row["view"] for row in rows] == ["0", "1"] and len({row["move"] for row in rows}) == 2


def test_depths_are_those_of_the_mirror_s_images(made):
    for folder, row in zip(*made, strict=True):
        forward, left = float(row["move"].split(",")[2]), math.radians(float(row["turn"].split(",")[0]))
        depth, surface = (np.load(folder / "rgbd" / f"{name}.npy") for name in ("depth", "surface_depth"))
        assert depth.shape == surface.shape == (SIZE, SIZE) and depth.dtype == np.float32
        columns = (np.arange(SIZE) - (SIZE - 1) / 2) / PIXELS
        # a plane z = h, seen by a camera turned to the left: depth times (cos + tangent sin) is h less its place
        slope = math.cos(left) + columns * math.sin(left)
        mirror = surface[0]  # the row at the top sees nothing else
        np.testing.assert_allclose(mirror, (1 - forward) / slope, rtol=1e-4)
        np.testing.assert_allclose(depth[0], (2.5 - forward) / slope, rtol=1e-3)
        disc = surface < 0.9 * surface.max()
        assert 10 < disc.sum() < 0.2 * disc.size
        np.testing.assert_allclose(depth[disc], surface[disc], rtol=1e-6)


def test_the_picture_is_sharp_and_shows_the_scene_s_radiance(made):
    import mitsuba as mi

    folders, _ = made
    rgb = np.array(mi.Bitmap(str(folders[0] / "rgbd" / "rgb.exr")))
    disc = np.load(folders[0] / "rgbd" / "surface_depth.npy") < 0.6
    assert rgb.shape == (SIZE, SIZE, 3)
    inside = rgb[
        disc & np.roll(disc, 1, 1) & np.roll(disc, -1, 1) & np.roll(disc, 1, 0) & np.roll(disc, -1, 0)
    ]
    np.testing.assert_allclose(inside, 5, rtol=1e-3)
    assert rgb[0].max() < 0.25 and (folders[0] / "rgbd" / "rgb.png").is_file()


def test_light_field_views_shift_by_the_disparity(made):
    for folder, row in zip(*made, strict=True):
        views, points = (np.load(folder / "light_field" / f"{name}.npy") for name in ("views", "points"))
        assert views.shape == (3, 3, SIZE, SIZE, 3) and points.shape == (3, 3, 2)
        light = np.where(views[..., 1] > 1, views[..., 1], 0)  # the disc
        column = (light.sum(-2) * np.arange(SIZE)).sum(-1) / light.sum((-1, -2))
        line = (light.sum(-1) * np.arange(SIZE)).sum(-1) / light.sum((-1, -2))
        depth = np.load(folder / "rgbd" / "surface_depth.npy").min()
        assert depth == pytest.approx(0.5 - float(row["move"].split(",")[2]), rel=0.01)
        shift = (points - points[1, 1]) / depth * PIXELS
        assert shift[1, 2, 0] > 0.3 and shift[0, 1, 1] > 0.3  # u to the right, v down: what is tested is seen
        np.testing.assert_allclose(column - column[1, 1], -shift[..., 0], atol=0.05)
        np.testing.assert_allclose(line - line[1, 1], shift[..., 1], atol=0.05)


def test_a_quilt_of_views(tmp_path, capsys):
    """Views run from the left at the lower left to the right at the upper right; points at the first focus stay."""
    import mitsuba as mi

    (tmp_path / "mirror.xml").write_text(SCENE)
    words = [
        "render",
        str(tmp_path / "mirror.xml"),
        "--out",
        str(tmp_path / "out"),
        "--quiet",
        "--method",
        "direct",
    ]
    words += ["--resolution", "48x32", "--depth-range", "0.5,1.5", "--wavelengths", "516.5", "--frames", "1"]
    words += ["--quality", "draft", "--quilt"]
    for focus, still in (("0.5m", True), ("2m", False)):
        assert cli.main([*words, "3x2", "--focus", focus]) == 0
        (file,) = (tmp_path / "out" / "quilt").iterdir()
        assert file.name == "quilt_qs3x2a1.5.png"
        found = np.array(mi.Bitmap(str(file)))[..., 1].astype(int)
        assert found.shape == (64, 144)
        tiles = [
            found[32 * row : 32 * row + 32, 48 * column : 48 * column + 48]
            for row in (1, 0)
            for column in range(3)
        ]
        discs = [np.where(tile > 200, 1, 0) for tile in tiles]
        columns = [(disc.sum(0) * np.arange(48)).sum() / disc.sum() for disc in discs]
        if still:
            assert np.ptp(columns) < 0.2
        else:  # seen from farther right, what is nearer than the focus lies farther left
            assert (np.diff(columns) < 0).all() and columns[0] - columns[-1] > 0.5, columns
    assert cli.main([*words, "3"]) == 2 and "columns and rows as 8x6" in capsys.readouterr().err


@pytest.fixture
def moving(empty_scene, tmp_path):
    """A .blend in frame 3 of 1 to 5, in which a wall goes from 1 to 2 m."""
    bpy = pytest.importorskip("bpy")
    scene = empty_scene
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    mesh = bpy.data.meshes.new("Wall")
    mesh.from_pydata([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [], [(0, 1, 2, 3)])
    wall = bpy.data.objects.new("Wall", mesh)
    scene.collection.objects.link(wall)
    for frame, depth in ((1, 1.0), (5, 2.0)):
        wall.location.z = -depth
        wall.keyframe_insert("location", frame=frame)
    for curve in _curves(wall):
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    scene.world = bpy.data.worlds.new("World")
    scene.frame_start, scene.frame_end, scene.frame_step = 1, 5, 2
    scene.frame_set(3)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "wall.blend"), check_existing=False)
    return tmp_path / "wall.blend"


def test_depths_are_added_to_frames_that_are_there(moving, tmp_path, monkeypatch):
    words = [
        "render",
        str(moving),
        "--out",
        str(tmp_path / "film"),
        "--animation",
        "--quiet",
        "--focus",
        "1m",
    ]
    words += ["--resolution", "32x32", "--frames", "1", "--quality", "draft", "--wavelengths", "516.5"]
    assert cli.main(words) == 0
    monkeypatch.setattr(engine, "render", None)  # a field holds all views of it
    assert cli.main([*words, "--rgbd"]) == 0
    depths = [np.load(tmp_path / "film" / f"frame_000{n}" / "rgbd" / "depth.npy").mean() for n in (1, 3, 5)]
    np.testing.assert_allclose(depths, [1, 1.5, 2], rtol=1e-4)


def test_frames_of_a_blender_scene(moving, tmp_path):
    """A run for each frame; one without is of the frame that the file is in, whatever came before."""
    study = tmp_path / "frames.toml"
    text = STUDY.replace("mirror.xml", "wall.blend").replace("light_field = 3\n", "")
    study.write_text(text + '[views]\nframes = "1-5:2"\n')
    assert cli.main(["study", str(study), "--quiet"]) == 0
    study.write_text(text + "[[list]]\nat_frame = 5\n[[list]]\n")
    assert cli.main(["study", str(study), "--quiet"]) == 0
    found = {}
    for folder in (tmp_path / "frames" / "runs").glob("wall*"):
        name = folder.name.rpartition("-")[0]
        found.setdefault(name, []).append(np.load(folder / "rgbd" / "depth.npy"))
    assert {name: [round(float(d.mean()), 3) for d in depths] for name, depths in found.items()} == {
        "wall-view0": [1.0], "wall-view1": [1.5], "wall-view2": [2.0], "wall": [1.5],
    }  # fmt: skip


def _curves(thing):
    action = thing.animation_data.action
    if hasattr(action, "layers") and action.layers:
        return action.layers[0].strips[0].channelbag(thing.animation_data.action_slot).fcurves
    return action.fcurves
