"""Pictures with depth, point clouds and views: their files, what they mean, and the way through the command line."""

import json
import math

import numpy as np
import pytest

from holopath_addon import cli, engine
from holopath_addon.cli import sources
from holopath_addon.engine.scene import variants
from holopath_addon.exchange.captures import (
    CaptureOptions,
    open_capture,
    read_depth,
    read_picture,
    read_points,
)
from holopath_addon.workflow import output
from tests.exchange import foreign

SIDE = 32
DEPTH = np.where(np.arange(SIDE)[:, None] + np.arange(SIDE) < SIDE, 0.5, 2.0)  # a near half and a far one


def bitmap(array):
    return variants.bitmaps().Bitmap(np.ascontiguousarray(array))


def write(path, array):
    """An image file, or an array's."""
    if path.suffix == ".npy":
        np.save(path, array)
    else:
        bitmap(array).write(str(path))
    return path


@pytest.fixture
def photo(tmp_path):
    """An EXR picture."""
    image = np.random.default_rng(0).uniform(0.1, 1, (SIDE, SIDE, 3)).astype(np.float32)
    path = tmp_path / "photo.exr"
    path.write_bytes(output.encode_exr(image))
    return path


def ray_lengths(fov):
    tangent = (np.arange(SIDE) - 0.5 * (SIDE - 1)) * 2 * math.tan(fov / 2) / SIDE
    return np.sqrt(1 + tangent**2 + tangent[:, None] ** 2)


# Of one depth, in each way that a file may have it: name, numbers and options.
INVERSE = (1 / DEPTH - 0.25) / (4 - 0.25)  # between 4 m and 0.25 m
SAME = [
    ("d.exr", DEPTH.astype(np.float32), {"depth_unit": "m"}),
    ("d.exr", np.repeat(DEPTH[..., None], 3, -1).astype(np.float16), {"depth_unit": "m"}),
    ("d.npy", 1e3 * DEPTH, {"depth_unit": "mm"}),
    ("d.png", (1e3 * DEPTH).astype(np.uint16), {"depth_unit": "mm"}),
    ("d.exr", (1 / DEPTH).astype(np.float32), {"depth_unit": "diopters"}),
    ("d.exr", INVERSE.astype(np.float32), {"depth_unit": "inverse", "depth_ends": (4.0, 0.25)}),
    ("d.png", np.round(65535 * INVERSE).astype(np.uint16), {"depth_unit": "inverse", "depth_ends": (4.0, 0.25)}),
    ("d.png", np.round(255 * INVERSE).astype(np.uint8), {"depth_unit": "inverse", "depth_ends": (4.0, 0.25)}),
    ("d.npy", DEPTH * ray_lengths(0.6), {"depth_unit": "m", "depth_along": "ray", "fov": math.degrees(0.6)}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "numbers", "options"), SAME)
def test_depths_in_all_units_are_one_scene(backend, photo, name, numbers, options):
    """All of these files give the same depth at each pixel's center."""
    path = write(photo.with_name(name), numbers)
    built = open_capture(photo, CaptureOptions(str(path), **options)).build((SIDE, SIDE))
    view = engine.depth_map(built.scene, built.camera, SIDE, SIDE)
    np.testing.assert_allclose(view, DEPTH, rtol=5e-3)  # 8 bits are within 0.4 %


@pytest.mark.parametrize(
    ("name", "numbers", "options", "effect"),
    [
        ("d.npy", 1e3 * DEPTH, {"depth_unit": "m"}, "if they are millimeters, give --depth-unit mm"),
        ("d.npy", 1e6 * DEPTH, {"depth_unit": "mm"}, "check --depth-unit"),
        ("d.npy", 1e-3 / DEPTH, {"depth_unit": "diopters"}, "check --depth-unit"),
        ("d.npy", np.where(DEPTH < 1, 2.0, 1000.0), {"depth_unit": "m"}, None),  # a sky
        ("d.npy", INVERSE, {"depth_unit": "inverse", "depth_ends": (4000.0, 250.0)}, None),  # in meters, as given
    ],
)  # fmt: skip
def test_depths_that_are_all_far_are_noted(backend, photo, name, numbers, options, effect):
    """Their unit is probably another one; 500 to 2000 m here."""
    path = write(photo.with_name(name), numbers)
    built = open_capture(photo, CaptureOptions(str(path), fov=40, **options)).build((SIDE, SIDE))
    expected = [] if effect is None else [("depths from 500 to 2000 m", effect)]
    assert [(note["feature"], note["effect"]) for note in built.notes] == expected


def test_the_depth_that_holopath_writes_can_be_read(photo):
    """A depth.npy of --rgbd."""
    path = write(photo.with_name("depth.npy"), DEPTH.astype(np.float32))
    np.testing.assert_array_equal(read_depth(path, "m"), DEPTH)


def test_pictures_are_decoded(tmp_path):
    """8 and 16 bits are sRGB (IEC 61966-2-1), EXR is linear."""
    levels = np.array([[[0, 64, 128], [188, 255, 10]]], np.uint8)
    share = levels / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(read_picture(write(tmp_path / "a.png", levels)), linear, atol=1e-6)
    wide = levels.astype(np.uint16) * 257
    np.testing.assert_allclose(read_picture(write(tmp_path / "b.png", wide)), linear, atol=1e-6)
    exr = write(tmp_path / "c.exr", share.astype(np.float32))
    np.testing.assert_allclose(read_picture(exr), share, rtol=1e-6)
    gray = read_picture(write(tmp_path / "d.png", levels[..., 0]))
    np.testing.assert_allclose(gray, linear[..., :1].repeat(3, -1), atol=1e-6)


def test_a_larger_picture_is_made_smaller(backend, tmp_path):
    """A picture of 101 pixels becomes one of blocks of three for a hologram of 32, with the remaining view."""
    image = np.zeros((101, 101, 3), np.float32)
    image[:, :50] = 1
    (tmp_path / "photo.exr").write_bytes(output.encode_exr(image))
    depth = write(tmp_path / "d.npy", np.where(np.arange(101) < 51, 0.5, 2.0) * np.ones((101, 1)))
    built = open_capture(tmp_path / "photo.exr", CaptureOptions(str(depth), "m", fov=40)).build((SIDE, SIDE))
    assert built.scene.shapes()[0].primitive_count() < 2 * 45**2
    assert math.tan(built.camera.fov_x / 2) == pytest.approx(99 / 101 * math.tan(math.radians(20)))
    view = engine.depth_map(built.scene, built.camera, 33, 33)
    assert (view[:, :16] < 0.51).all() and (view[:, 17:] > 1.99).all()


def cloud(count=500):
    """Points of a sphere of 1 m, colored by where they are."""
    points = np.random.default_rng(1).normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points.astype(np.float32), (255 * (0.5 + 0.5 * points)).astype(np.uint8)


def ply(path, points, colors, form, before="", after=""):
    """A PLY file of text or binary, with other properties, and elements before and after."""
    kind = {"u1": "uchar", "f4": "float"}[colors.dtype.str[1:]]
    names = "".join(f"property float {name}\n" for name in "xyz") + "property double weight\n"
    names += "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    header = f"ply\nformat {form} 1.0\ncomment made by a test\n{before}element vertex {len(points)}\n{names}{after}"
    rows = np.zeros(
        len(points), [("p", "f4", 3), ("weight", "f8"), ("c", colors.dtype.str[1:], 3)]
    )  # unpadded
    rows["p"], rows["c"] = points, colors
    data = b"" if not before else np.array([7, 8], ">i4" if "big" in form else "<i4").tobytes()
    if form == "ascii":
        data = b"7\n8\n" if before else b""
        data += "".join(
            f"{' '.join(map(str, [*p, 0, *c]))}\n" for p, c in zip(points, colors, strict=True)
        ).encode()
    else:
        order = ">" if "big" in form else "<"
        data += rows.astype(rows.dtype.newbyteorder(order)).tobytes()
    path.write_bytes(f"{header}end_header\n".encode() + data)
    return path


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("before", ["", "element camera 2\nproperty int number\n"])
def test_point_clouds_of_all_forms(tmp_path, form, before):
    points, colors = cloud()
    places, linear = read_points(ply(tmp_path / "p.ply", points, colors, form, before))
    np.testing.assert_array_equal(places, points)
    share = colors / 255
    expected = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(linear, expected, atol=1e-6)
    floats = ply(tmp_path / "f.ply", points, share.astype(np.float32), form, before)
    np.testing.assert_allclose(read_points(floats)[1], share, atol=1e-6)


@pytest.mark.parametrize(
    ("axes", "axis"), [("y-up", (0, 0, 1)), ("y-down", (0, 0, -1)), ("z-up", (0, -1, 0))]
)
def test_the_side_that_faces_the_viewer(backend, tmp_path, axes, axis):
    """The axes decide the color in the middle and at the right of a sphere that is colored by position."""
    from holopath_addon.engine.viewing.preview import Preview

    points, colors = cloud(4000)
    path = ply(tmp_path / "p.ply", points, (colors / np.float32(255)), "binary_little_endian")
    built = open_capture(path, CaptureOptions(axes=axes, fov=30)).build((SIDE, SIDE))
    shown = Preview(built.scene, built.camera, SIDE, SIDE).refine(16, lambda *_: None)
    np.testing.assert_allclose(shown[15:17, 15:17].mean((0, 1)), 0.5 + 0.5 * np.array(axis), atol=0.1)
    assert shown[SIDE // 2, -5, 0] > 0.75 and shown[SIDE // 2, 4, 0] < 0.25


@pytest.mark.parametrize("kind", ["picture", "points"])
def test_the_way_through_the_command_line(backend, photo, tmp_path, capfd, kind):
    """Plan, render and compare, refocus, and open the scene again by the report."""
    if kind == "picture":
        write(photo.with_name("d.png"), (1e3 * DEPTH).astype(np.uint16))
        words = [str(photo), "--depth", str(photo.with_name("d.png")), "--depth-unit", "mm", "--fov", "35"]
    else:
        path = ply(tmp_path / "p.ply", *cloud(2000), "ascii")
        words = [str(path), "--axes", "z-up", f"--resolution={SIDE}x{SIDE}"]
    assert cli.main(["plan", *words, "--json"]) == 0
    messages = json.loads(capfd.readouterr().out)
    assert messages["hologram"]["width"] == SIDE
    assert any("field of view" in note["feature"] for note in messages["export_notes"]) == (kind == "points")
    out = tmp_path / "out"
    assert cli.main(["render", *words, "--out", str(out), "--compare-reference", "--focus=1m"]) == 0
    report = output.read_report(out)
    assert all(row["psnr_db"] > 15 for row in report["comparison"])
    assert cli.main(["reconstruct", str(out), "--focus", "1m"]) == 0
    assert sources.reopen(out, output.stored_field(out)).same


def test_a_picture_that_moved_with_its_depth_is_found_again(backend, photo, tmp_path, monkeypatch):
    """The files may move together to another folder, as on another machine."""
    first, second = photo.parent / "first", photo.parent / "second"
    first.mkdir()
    photo = photo.rename(first / photo.name)
    depth = write(first / "d.npy", DEPTH)
    out = tmp_path / "out"
    words = [str(photo), "--depth", str(depth), "--depth-unit", "m", "--frames=1", "--quality=draft"]
    assert cli.main(["render", *words, "--out", str(out), "--focus=1m"]) == 0
    first.rename(second)
    assert sources.reopen(out, output.stored_field(out), str(second / photo.name)).same


FOR_PICTURE = ["--depth-unit", "m"]
REFUSALS = [
    ([], [], "is a picture without depth. Add --depth FILE and --depth-unit, or"),
    ([], ["--view-span", "0.1", "--view-focus", "1m"], "The layout of the views in"),
    ("m", ["--depth", "d.npy", *FOR_PICTURE, "--view-span", "0.1"], "has views, without depth. Omit --depth"),
    ("m", ["--depth", "d.npy"], "The unit of the depths in"),
    ("m", ["--depth", "none.png", *FOR_PICTURE], "does not exist"),
    ("m", ["--depth", "photo.hdr", *FOR_PICTURE], "does not exist"),
    ("m", ["--depth", "d.npy", "--depth-unit", "inverse"], "needs --depth-ends FAR,NEAR"),
    ("m", ["--depth", "d.npy", *FOR_PICTURE, "--depth-ends", "4,1"], "needs --depth-ends FAR,NEAR"),
    ("m", ["--depth", "d.npy", "--depth-unit", "inverse", "--depth-ends", "1,4"], "The ends of inverse depths"),
    ("m", ["--depth", "d.npy", "--depth-unit", "inverse", "--depth-ends", "4,1"], "Inverse depths must lie between 0"),
    ("small", ["--depth", "d.npy", *FOR_PICTURE], "32 x 32 pixels and"),
    ("zero", ["--depth", "d.npy", *FOR_PICTURE], "32 pixels without a positive, finite depth, the first of them 0"),
    ("infinite", ["--depth", "d.npy", *FOR_PICTURE], "the first of them inf in column 0, row 5"),
    ("colors", ["--depth", "d.npy", *FOR_PICTURE], "instead of rows and columns"),
    ("m", ["--depth", "photo.exr", *FOR_PICTURE], "has several different channels"),
    ("m", ["--depth", "d.npy", *FOR_PICTURE, "--axes", "y-up"], "is a picture, not a"),
    ("m", ["--depth", "d.npy", *FOR_PICTURE, "--fov", "180"], "The field of view must lie between 0 and 180 degrees"),
    ("m", ["--depth", "d.npy", *FOR_PICTURE, "--camera", "A"], "has no camera 'A'"),
    ("m", ["--depth", "d.npy", *FOR_PICTURE, "--at-frame", "2"], "has no frames"),
    ("m", ["--depth", "d.npy", *FOR_PICTURE, "--define", "a=1"], "Omit --define"),
    ("m", ["--depth", "d.npy", *FOR_PICTURE, "--scene-name", "A"], "Omit --scene-name"),
]  # fmt: skip
DEPTHS = {
    "m": DEPTH,
    "small": DEPTH[:-1],
    "zero": np.where(np.arange(SIDE) == 3, 0, DEPTH),
    "infinite": np.where(np.arange(SIDE)[:, None] == 5, math.inf, DEPTH),
    "colors": np.ones((SIDE, SIDE, 3)),
}


@pytest.mark.parametrize(("depth", "words", "text"), REFUSALS)
def test_what_pictures_refuse(photo, monkeypatch, capfd, depth, words, text):
    monkeypatch.chdir(photo.parent)
    np.save("d.npy", DEPTHS[depth or "m"])
    refused(["photo.exr", *words], text, capfd)


def refused(words, text, capfd):
    """Assert a refusal in one line, with status 2 and nothing written."""
    assert cli.main(["render", *words, "--out", "out", "--quiet"]) == 2
    messages = capfd.readouterr().err.strip().splitlines()
    assert len(messages) == 1 and text in messages[0], messages
    from pathlib import Path

    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("change", "words", "text"),
    [
        ((b"", b""), [], "are unknown. Add --axes with y-up"),
        ((b"", b""), ["--axes", "y-up", "--depth", "d.npy"], "is a point cloud, not a picture. Omit --depth"),
        ((b"", b""), ["--axes", "y-up", "--camera", "A"], "--camera front, before all points, or --camera origin"),
        ((b"", b""), ["--axes", "y-up", "--point-radius", "0"], "must be positive"),
        ((b"ply", b"plx"), ["--axes", "y-up"], "cannot be read as a PLY file"),
        ((b"red", b"rot"), ["--axes", "y-up"], "have no red. Give points with the properties x, y, z"),
        ((b"vertex 50", b"vertex 90"), ["--axes", "y-up"], "it has 50 vertices of 90"),
        ((b"vertex 50", b"vertex 50000000"), ["--axes", "y-up"], "Expected at most 4000000 points, got 50000000 in"),
        ((b"element v", b"element face 0\nelement v"), ["--axes", "y-up", "--animation"], "has no animation"),
        ((b"element v", b"element face 1\nproperty int a\nelement v"), ["--axes", "y-up"], "has faces"),
        ((b"float x", b"floot x"), ["--axes", "y-up"], "cannot be read as a PLY file"),
        ((b"end_header", b"end"), ["--axes", "y-up"], "cannot be read as a PLY file"),
    ],
)  # fmt: skip
def test_what_point_clouds_refuse(tmp_path, monkeypatch, capfd, change, words, text):
    monkeypatch.chdir(tmp_path)
    path = ply(tmp_path / "p.ply", *cloud(50), "binary_little_endian")
    path.write_bytes(path.read_bytes().replace(*change, 1))
    refused(["p.ply", *words], text, capfd)


def test_points_that_are_not_numbers_are_left_out_with_a_note(backend, tmp_path):
    points, colors = cloud(50)
    points[3] = math.nan
    path = ply(tmp_path / "p.ply", points, colors, "binary_little_endian")
    built = open_capture(path, CaptureOptions(axes="y-up", fov=40)).build((SIDE, SIDE))
    [note] = built.notes
    assert note["feature"] == "1 points that are not finite numbers" and note["effect"] == "omitted"


def test_options_of_captures_are_refused_elsewhere(tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(
        ["demo:planes", "--fov", "30"],
        "or an .npy or .npz of views for --fov, got demo:planes. Omit it",
        capfd,
    )


def quilted(path, columns, rows, numbers):
    """A quilt whose views, from the lower left to the right and up, are gray of some levels, darker at their top."""
    views = np.repeat(np.asarray(numbers, np.uint8)[:, None, None], 12, 1) * np.ones((1, 1, 16), np.uint8)
    views[:, :2] //= 2
    quilt = np.vstack(
        [np.hstack(views[columns * row : columns * (row + 1)]) for row in reversed(range(rows))]
    )
    return write(path, np.repeat(quilt[..., None], 3, -1))


def test_a_quilt_begins_at_the_lower_left(tmp_path):
    path = quilted(tmp_path / "a_qs3x2a1.6.png", 3, 2, [10, 40, 80, 120, 160, 200])
    views = open_capture(path, CaptureOptions(view_span=(0.1,), view_focus=1.0))
    assert views.size == (16, 10)  # as wide as the name says
    assert views.views.shape == (1, 6, 12, 16, 3)
    encoded = np.array([10, 40, 80, 120, 160, 200]) / 255
    decoded = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(views.views[0, :, -1, 0, 1], decoded, rtol=1e-5)
    assert (views.views[0, :, 0] < views.views[0, :, -1]).all()


def test_a_quilt_that_its_views_do_not_fill(backend, tmp_path):
    """Surplus pixels lie at the right and at the top, and a note says so."""
    whole = quilted(tmp_path / "a_qs3x2a1.33333.png", 3, 2, [10, 40, 80, 120, 160, 200])
    options = CaptureOptions(view_span=(0.1,), view_focus=1.0, fov=40)
    pixels = np.array(variants.bitmaps().Bitmap(str(whole)))
    wider = np.full((pixels.shape[0] + 1, pixels.shape[1] + 2, 3), 255, np.uint8)
    wider[1:, :-2] = pixels
    views = open_capture(write(tmp_path / "b_qs3x2a1.33333.png", wider), options)
    expected = open_capture(whole, options)
    np.testing.assert_array_equal(views.views, expected.views)
    messages, before = ([note["effect"] for note in each.build((16, 12)).notes] for each in (views, expected))
    assert len(messages) == len(before) + 1
    assert any(
        "each has 16 x 12 pixels, from the lower left" in text and "2 at the right and 1 at the top" in text
        for text in messages
    )


def test_arrays_of_views(tmp_path):
    """One row or several, linear or sRGB."""
    numbers = np.random.default_rng(0).integers(1, 65536, (2, 3, 12, 16, 3)).astype(np.uint16)
    options = CaptureOptions(view_span=(0.1, 0.05), view_focus=1.0)
    for array, shape in ((numbers, (2, 3)), (numbers[0], (1, 3)), ((numbers / 65535)[:, :1], (2, 1))):
        path = write(tmp_path / "v.npy", array)
        views = open_capture(path, options)
        assert views.views.shape == (*shape, 12, 16, 3) and views.size == (16, 12)
        if array.dtype == np.uint16:
            share = array.reshape(*shape, 12, 16, 3) / 65535
            expected = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
            np.testing.assert_allclose(views.views, expected, rtol=1e-4)
        else:
            np.testing.assert_allclose(views.views, array, rtol=1e-6)


def test_views_by_their_names(tmp_path):
    """Views are sorted by number, not by letters; grids by row and column; other arrays do not count."""
    options = CaptureOptions(view_span=(0.1,), view_focus=1.0)
    numbers = np.random.default_rng(0).random((12, 4, 5, 3)).astype(np.float32)
    order = np.random.default_rng(1).permutation(12)
    by_name = {
        "row": {f"view_{n + 1}": numbers[n] for n in order} | {"points": np.zeros((12, 3))},
        "grid": {f"u{n // 4}_{n % 4}": numbers[n] for n in order},
        "one": {"lightfield": numbers, "pitch": 8e-6},
    }
    for name, shape in (("row", (1, 12)), ("grid", (3, 4)), ("one", (1, 12))):
        np.savez(tmp_path / f"{name}.npz", **by_name[name])
        found = open_capture(tmp_path / f"{name}.npz", options)
        np.testing.assert_array_equal(found.views, numbers.reshape(*shape, 4, 5, 3))
        assert found.size == (5, 4)


VIEW = np.zeros((4, 5, 3), np.uint8)


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"left": VIEW, "right": VIEW}, "The names of the arrays of"),
        ({"view_0": VIEW, "view_2": VIEW}, "without a gap"),
        ({"view_0": VIEW, "image_1": VIEW}, "The names of the arrays of"),
        ({"v0_0": VIEW, "v0_1": VIEW, "v1_1": VIEW}, "The names of the arrays of"),
        ({"v1": VIEW, "v01": VIEW}, "The names of the arrays of"),
        ({"v0": VIEW, "v1": VIEW[1:]}, "different sizes or types .v0, v1"),
        ({"a": np.stack([VIEW] * 3), "b": np.stack([VIEW] * 3)}, "has 2 arrays that can be views"),
        ({"depth": VIEW[..., 0]}, "has 0 arrays that can be views"),
        ({"v0": VIEW.astype(int), "v1": VIEW.astype(int)}, "numbers of int"),
    ],
)
def test_arrays_that_do_not_say_the_order_of_views(tmp_path, arrays, says):
    np.savez(tmp_path / "v.npz", **arrays)
    views = open_capture(tmp_path / "v.npz", CaptureOptions(view_span=(0.1,), view_focus=1.0))
    with pytest.raises(engine.InvalidInput, match=says):
        assert views.size


@pytest.mark.parametrize("kind", ["quilt", "array"])
def test_views_go_the_way_through_the_command_line(backend, tmp_path, capfd, kind):
    """The method is theirs without a word, the notes say what is missing, and the report opens them again."""
    if kind == "quilt":
        path = quilted(tmp_path / "q_qs3x1a1.33333.png", 3, 1, [80, 120, 160])
        words = [str(path), "--view-span", "0.02", "--view-focus", "1m"]
    else:
        path = write(tmp_path / "v.npy", np.random.default_rng(0).random((2, 3, 12, 16, 3)))
        words = [
            str(path),
            "--view-span",
            "0.02,0.01",
            "--view-focus",
            "inf",
            "--view-panel",
            "1m",
            "--fov",
            "30",
        ]
    assert cli.main(["plan", *words, "--json"]) == 0
    messages = json.loads(capfd.readouterr().out)
    assert (messages["hologram"]["width"], messages["hologram"]["height"]) == (16, 12)
    features = [note["feature"] for note in messages["export_notes"]]
    assert ("one row of views" in features) == (kind == "quilt")
    out = tmp_path / "out"
    more = ["--out", str(out), "--frames=1", "--quality=draft", "--wavelengths=516.5", "--focus=1m"]
    assert cli.main(["render", *words, *more, "--quiet"]) == 0
    assert output.read_report(out)["settings"]["method"] == "light-field"
    assert sources.reopen(out, output.stored_field(out)).same


WHERE = ["--view-span", "0.1", "--view-focus", "1m"]


@pytest.mark.parametrize(
    ("name", "shape", "words", "text"),
    [
        ("v.npy", (3, 8, 8, 3), [], "are unknown. Add --view-span with the meters from the first viewpoint"),
        ("v.npy", (3, 8, 8, 3), ["--view-span", "0.1"], "and --view-focus with the distance"),
        ("v.npy", (3, 8, 8, 3), ["--view-span", "0.1", "--view-focus", "inf"], "Add --view-panel"),
        ("v.npy", (3, 8, 8, 3), ["--view-span", "0", "--view-focus", "1m"], "positive and finite, for 3 of them"),
        ("v.npy", (3, 8, 8, 3), ["--view-span", "0.1,0.1", "--view-focus", "1m"], "of 3 x 1 views in"),
        ("v.npy", (2, 3, 8, 8, 3), WHERE, "Expected 2 numbers for --view-span of 3 x 2 views in"),
        ("v.npy", (1, 8, 8, 3), WHERE, "There is one view: give at least two"),
        ("v.npy", (8, 8), WHERE, "instead of (view, y, x, 3)"),
        ("v.npy", (3, 8, 8, 3), [*WHERE, "--depth", "d.npy"], "has views, without depth. Omit --depth"),
        ("v.npy", (3, 8, 8, 3), [*WHERE, "--camera", "A"], "has no camera 'A'"),
        ("v.npy", (3, 8, 8, 3), [*WHERE, "--method", "full"], "The method full would show views as a flat picture"),
        ("q_qs3x1a1.png", (8, 2, 3), WHERE, "has 2 x 8 pixels, which cannot be 3 x 1"),
        ("q_qs3x1a0.png", (8, 24, 3), WHERE, "has 24 x 8 pixels, which cannot be 3 x 1"),
        ("q_qs3x1a1.png", (8, 24, 3), [], "are unknown. Add --view-span with the meters from the first viewpoint"),
        ("q_qs3x1a1.tga", (8, 24, 3), WHERE, "a .ply, or an .npy or .npz of views, got the scene"),
    ],
)  # fmt: skip
def test_what_views_refuse(backend, tmp_path, monkeypatch, capfd, name, shape, words, text):
    monkeypatch.chdir(tmp_path)
    if name.endswith(".tga"):
        (tmp_path / name).touch()
    else:
        write(tmp_path / name, np.ones(shape, np.uint8))
    refused([name, *words], text, capfd)


def test_a_ply_without_faces_within_an_xml_is_named(backend, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    ply(tmp_path / "p.ply", *cloud(50), "binary_little_endian")
    (tmp_path / "s.xml").write_text(
        '<scene version="3.0.0"><sensor type="perspective"/><shape type="ply"><string name="filename" value="p.ply"/>'
        "</shape></scene>"
    )
    assert cli.main(["plan", "s.xml"]) == 2
    assert "Give the .ply itself" in capfd.readouterr().err


def cropped_exr(path):
    """An EXR file of 4 x 4 pixels that calls itself a part of 8 x 8."""
    path.write_bytes(output.encode_exr(np.ones((4, 4, 3), np.float32)))
    data = bytearray(path.read_bytes())
    start = data.index(b"displayWindow\0box2i\0") + len(b"displayWindow\0box2i\0") + 4
    data[start : start + 16] = np.array([0, 0, 7, 7], "<i4").tobytes()
    path.write_bytes(data)


def test_pictures_of_indices_or_of_a_part(tmp_path):
    """A palette's indices are no gray levels, and a part is not where the whole is: for depths, too."""
    pixels = np.arange(16, dtype=np.uint8).reshape(4, 4)
    foreign.bmp(tmp_path / "gray.bmp", pixels)
    foreign.bmp(
        tmp_path / "colors.bmp", pixels, np.random.default_rng(0).integers(0, 256, (256, 4), np.uint8)
    )
    cropped_exr(tmp_path / "part.exr")
    assert read_picture(tmp_path / "gray.bmp").shape == (4, 4, 3)
    for name, says in (("colors.bmp", "palette of colors"), ("part.exr", "only a part of its picture")):
        with pytest.raises(engine.InvalidInput, match=says):
            read_picture(tmp_path / name)
        with pytest.raises(engine.InvalidInput, match=says):
            read_depth(tmp_path / name, "mm")
