"""The documentation agrees with the program, its links lead somewhere, and its sentences are short."""

import ast
import importlib.util
import math
import re
import shlex
import shutil
import statistics
from pathlib import Path

import numpy as np
import pytest
from markdown_it import MarkdownIt
from PIL import Image

from documentation import pages, pictures, prose
from documentation import words as vocabulary
from holopath_addon import cli, engine, exchange, slm
from holopath_addon.slm.drivers import video

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
TOP = [ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md")]
PAGES = [*TOP, ROOT / "distribution" / "pypi.md", *sorted(DOCS.rglob("*.md"))]
MODULES = {"engine": engine, "slm": slm, "exchange": exchange}
# Options of other programs that the pages name: Dask's, SLURM's, those of benchmarks, and of the program that designs
# phase fields.
OTHERS = {
    "--host", "--protocol", "--interface",
    "--lifetime", "--nthreads", "--array", "--cpus-per-task", "--mem", "--requeue", "--time",
    "--background", "--command", "--markdown", "--pictures", "--narrow", "--plane", "--prefixes", "--rate", "--reach",
    "--docs", "--smallest", "--start", "--steps", "--help",
}  # fmt: skip


def name(path):
    return str(path.relative_to(ROOT))


def tokens(path):
    """All tokens of a page, those within lines, too."""
    for token in MarkdownIt().enable("table").parse(path.read_text("utf-8")):
        yield token
        yield from token.children or ()


def fences(path, *kinds):
    return [
        t.content for t in tokens(path) if t.type == "fence" and t.info.split()[:1] in [[k] for k in kinds]
    ]


def slugs(path):
    """Anchors of a page's headings, as a code forge makes them."""
    parsed = MarkdownIt().parse(path.read_text("utf-8"))
    headings = (b.children for a, b in zip(parsed, parsed[1:], strict=False) if a.type == "heading_open")
    texts = ("".join(t.content for t in children) for children in headings)
    return {re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-") for text in texts}


def shell_commands():
    """Page and words of each command in a block of shell code, without the variables that are set for it."""
    for path in PAGES:
        for block in fences(path, "sh", "bat"):
            for line in block.replace("\\\n", " ").splitlines():
                words = shlex.split(line.replace("\\", "/"), comments=True)
                while words and re.match(r"[A-Z_]+=", words[0]):
                    words = words[1:]
                if words:
                    yield name(path), words


def holopath_words(words):
    """Those after `holopath`, however it is called; None for another command."""
    if words[:1] == ["blender"] and "holopath" in words:
        return words[words.index("holopath") + 1 :]
    return words[1:] if words[0].rpartition("/")[2] == "holopath" else None


COMMANDS = [(page, words) for page, line in shell_commands() if (words := holopath_words(line)) is not None]


@pytest.mark.parametrize(
    ("page", "words"), COMMANDS, ids=lambda value: " ".join(value) if isinstance(value, list) else value
)
def test_commands_are_those_of_the_program(page, words):
    assert cli.parse(words, pages.STORE).run


def test_there_are_commands_on_the_pages_that_should_have_them():
    assert {page for page, _ in COMMANDS} >= {
        f"docs/{each}.md"
        for each in ("start/install", "start/command-line", "how-to/phases", "slm", "farm", "files", "study")
    }


def test_make_has_its_targets():
    targets = re.search(r"(?m)^\.PHONY: (.*)", (ROOT / "Makefile").read_text("utf-8"))[1].split()
    asked = {words[1] for _, words in shell_commands() if words[0] == "make"}
    for path in PAGES:
        asked |= {
            t.content.split()[1] for t in tokens(path) if t.type == "code_inline" and t.content[:5] == "make "
        }
    assert asked >= {"docs", "env", "demo"} and asked - set(targets) == set()


def test_options_in_the_text_are_those_of_the_program():
    """`holopath COMMAND --option` of that command, and `--option` of any."""
    known = {command: set(parser._option_string_actions) for command, parser in pages.parsers().items()}
    every = set().union(*known.values(), OTHERS)
    wrong = []
    for path in PAGES:
        if path.name in ("chart.md", "CHANGELOG.md"):  # of their day
            continue
        for token in tokens(path):
            options = (
                re.findall(r"(?<![\w-])--[a-z][\w-]*", token.content) if token.type == "code_inline" else []
            )
            first, *rest = token.content.split() or [""]
            allowed = every
            if first == "holopath" and rest and rest[0] in known:
                allowed = known[rest[0]]
            elif first == "holopath" and rest and rest[0].islower():
                wrong.append((name(path), token.content))
            wrong += [(name(path), token.content) for option in options if option not in allowed]
    assert wrong == []


def test_python_on_the_pages_names_what_there_is():
    missing = []
    for path in PAGES:
        for block in fences(path, "python"):
            for node in ast.walk(ast.parse(block)):
                if (
                    isinstance(node, ast.Attribute)
                    and isinstance(node.value, ast.Name)
                    and node.value.id in MODULES
                ):
                    if not hasattr(MODULES[node.value.id], node.attr):
                        missing.append((name(path), ast.unparse(node)))
    assert missing == []


@pytest.mark.parametrize("module", MODULES)
def test_the_reference_has_all_public_names(module):
    text = (DOCS / "api" / f"{module}.md").read_text("utf-8")
    told = re.findall(r"(?m)^\.\. (?:autoclass|autofunction|autoexception|data):: (\w+)", text)
    assert sorted(told) == sorted(MODULES[module].__all__)


def test_what_the_code_declares_is_as_it_declares_it():
    """Commands, settings, decisions, and the chart's figures wherever they stand."""
    assert [name(path) for path in PAGES if pages.write(path) != path.read_text("utf-8")] == [], (
        "run `make guide`"
    )
    marked = "".join(path.read_text("utf-8") for path in PAGES)
    assert [part for part in pages.PARTS if f"<!-- {part}: make guide -->" not in marked] == []


def strange_figures(text, chart):
    """Decimals in decibels that a paragraph takes from the chart, and the chart does not have."""
    of_chart = [part for part in re.split(r"\n(?=- |\n)", text) if "chart.md" in part]
    return [
        number for part in of_chart for number in re.findall(r"\d+\.\d+(?= dB)", part) if number not in chart
    ]


def test_figures_of_the_chart_agree():
    chart = (DOCS / "chart.md").read_text("utf-8")
    own = re.search(r"\| auto \| .*?(\d+\.\d) \|", chart)[1]
    assert strange_figures(f"[chart](chart.md): {own} dB, 99.87 dB\n- elsewhere 77.77 dB", chart) == ["99.87"]
    for path in (*TOP, DOCS / "index.md", DOCS / "version-1.md", *(DOCS / "how-to").glob("*.md")):
        assert strange_figures(path.read_text("utf-8"), chart) == [], name(path)


def test_links_lead_somewhere():
    dead = []
    for path in PAGES:
        for token in tokens(path):
            target = (
                token.attrGet("href") or token.attrGet("src")
                if token.type in ("link_open", "image")
                else None
            )
            if not target or re.match(r"[a-z]+:", str(target)):
                continue
            file, _, anchor = str(target).partition("#")
            there = (path.parent / file).resolve() if file else path
            if not there.exists() or (anchor and anchor not in slugs(there)):
                dead.append((name(path), target))
    assert dead == []


def test_every_picture_has_what_makes_it():
    """Pages show the declared pictures, each declared one is there, and docs/images holds no others."""
    sources = {str(t.attrGet("src")): path for path in PAGES for t in tokens(path) if t.type == "image"}
    shown = {(path.parent / source).resolve() for source, path in sources.items()}
    declared = {pictures.IMAGES / file for file in pictures.PICTURES}
    there = {path for path in pictures.IMAGES.rglob("*") if path.is_file()} - {
        pictures.IMAGES / "labels.json"
    }
    assert shown == declared == there


def test_make_pictures_refuses_what_it_does_not_know():
    with pytest.raises(SystemExit, match="There is no picture panel.png"):
        pictures.make(["panel.png"])


def test_a_film_is_as_long_as_what_it_shows_and_a_minute_at_most(tmp_path):
    from documentation import window

    images = [Image.new("RGB", (32, 24), color) for color in ("black", "white", "red")]
    path = tmp_path / "film.webp"
    for end, expected in ((4.0, [0.5, 1.5, 2.0]), (240.0, [0.5, 59.5])):
        window.save_film(images, [0.0, 0.5, 2.0, end], path)
        with Image.open(path) as film:
            seconds, colors = [], []
            for number in range(film.n_frames):
                film.seek(number)
                film.load()
                seconds.append(film.info["duration"] / 1e3)
                colors.append(film.convert("RGB").getpixel((16, 12)))
        assert seconds == pytest.approx(expected, abs=2e-3)
        assert (
            colors[-1][0] > 200 > colors[-1][1]
        )  # what is there at the end is shown, however short it was there


def test_every_page_is_in_the_contents():
    text = (DOCS / "index.md").read_text("utf-8")
    listed = [
        line
        for block in re.findall(r"(?s)```\{toctree\}\n(.*?)```", text)
        for line in block.split()
        if line[0] != ":"
    ]
    told = {(DOCS / f"{entry}.md").resolve() for entry in listed if (DOCS / f"{entry}.md").exists()}
    assert told == {*DOCS.rglob("*.md"), *TOP[1:]} - {DOCS / "index.md"}


@pytest.mark.parametrize("page", [str(path) for path in prose.written()])
def test_sentences_are_short(page):
    lengths = [prose.words(sentence) for sentence in prose.sentences((ROOT / page).read_text("utf-8"))]
    assert not lengths or statistics.median(lengths) <= 20
    assert sum(length > prose.LONG for length in lengths) <= max(1, len(lengths) // 50), (
        "one in fifty over 35 words"
    )


def test_how_sentences_are_counted():
    text = "# Not this\n\nOne two `a b c` three. Four, e.g. $x^2$!\n\n- Five six\n\n"
    text += "| not | this |\n|---|---|\n| a | b |\n"
    assert [prose.words(sentence) for sentence in prose.sentences(text)] == [4, 3, 2]


def test_habits_of_words(tmp_path):
    path = tmp_path / "habits.py"
    path.write_text('"""Of a device."""\nMOST_BYTES = 1\ndef stream(told):\n    """Show pictures."""\n')
    complaints = [text.partition(":")[0] for _, text in sorted(vocabulary.habits(path))]
    assert complaints == ["a docstring starts with 'Of'", "the name MOST_BYTES", "the name told"]


@pytest.mark.slow
def test_the_site_is_made_without_a_warning_and_needs_no_network(tmp_path):
    from documentation import site

    assert site.build(tmp_path / "site") == 0
    made = list((tmp_path / "site").rglob("*.html"))
    assert len(made) > len(PAGES)
    loaded = re.compile(
        r"<(?:script|img|iframe|source)[^>]*src=\"(?:https?:)?//|<link[^>]*rel=\"(?:stylesheet|preload)\"[^>]*href=\"(?:https?:)?//"
    )
    assert [page for page in made if loaded.search(page.read_text("utf-8"))] == []
    styles = [path for path in (tmp_path / "site" / "_static").rglob("*.css")]
    assert [
        path for path in styles if re.search(r"url\(\"?(?:https?:)?//|@import", path.read_text("utf-8"))
    ] == []
    theory = (tmp_path / "site" / "docs" / "theory.html").read_text("utf-8")
    assert theory.count("<math") > 100 and "$$" not in theory


@pytest.mark.slow
def test_the_first_hologram_in_python(backend, tmp_path, monkeypatch, capsys):
    """All code of the page, one after the other, with a .blend and an .xml of the names that it opens."""
    bpy = pytest.importorskip("bpy")
    from holopath_addon.blender import demo

    monkeypatch.chdir(tmp_path)
    demo.build("planes")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    shutil.copy(ROOT / "tests" / "scene.xml", tmp_path)
    blocks = fences(DOCS / "start" / "python.md", "python")
    if not importlib.util.find_spec("torch"):
        blocks = [block for block in blocks if "import torch" not in block]
    code = "\n".join(blocks)
    exec(compile(code.replace("256", "64"), "start/python.md", "exec"), {})
    assert float(re.search(r"([\d.]+) dB", capsys.readouterr().out)[1]) > 15
    assert (tmp_path / "out/wavefield/field.npy").exists() and (tmp_path / "out/hologram/phase.npy").exists()
    assert (tmp_path / "focus.png").stat().st_size > 1000


@pytest.mark.slow
def test_a_method_of_ones_own(backend, tmp_path, monkeypatch):
    """The function of the page, called as the page calls it."""
    pytest.importorskip("bpy")
    monkeypatch.chdir(tmp_path)
    page = DOCS / "how-to" / "own-method.md"
    (tmp_path / "flat.py").write_text(fences(page, "python")[0])
    (line,) = (line for line in "\n".join(fences(page, "sh")).splitlines() if "HOLOPATH_NETWORK" in line)
    variable, *words = shlex.split(line.replace("256x256", "64x64"))
    monkeypatch.setenv(*variable.split("="))
    assert cli.main([*words[1:], "--wavelengths", "516.5", "--spp", "8", "--quiet"]) == 0


# What a test has not: devices, a cluster, a display, and for `network` the function of the test above.
# What needs a device, or minutes and has tests of its own.
ELSEWHERE = {"calibrate", "--monitor", "--port", "--cluster", "--identify", "holoeye", "network"}
try:
    video.ffmpeg()
except engine.BackendUnavailable:
    ELSEWHERE |= {"video", "video-per-color"}
SMALL = ["--resolution", "48x48", "--quality", "preview", "--wavelengths", "516.5"]
IN_PLACE_OF = {
    "512x512": "48x48",
    "480x270": "48x27",
    "256x256": "48x48",
    "1-50,60,70-100:2": "1-2",
    "/shared/film": "film",
}


ROOM = """
<scene version="3.0.0">
    <default name="lamp" value="4"/>
    <sensor type="perspective"><film type="hdrfilm"/><transform name="to_world">
        <lookat origin="0,0,2" target="0,0,0" up="0,1,0"/></transform></sensor>
    <shape type="rectangle"/>
    <emitter type="point"><point name="position" x="0" y="1" z="1"/><rgb name="intensity" value="$lamp"/></emitter>
</scene>
"""


def brought(folder):
    """What users bring: pictures of amplitude, phase, levels and depth, a photo, a quilt of views, a lens, a scan."""
    import mitsuba as mi

    rows, columns = np.mgrid[:24, :32]
    turn = np.arange(24 * 32).reshape(24, 32)
    np.save(folder / "lens.npy", 0.01 * ((rows - 12) ** 2 + (columns - 16) ** 2))
    for name, values in {
        "a.png": (7 * columns).astype(np.uint8),
        "p.png": (turn % 256).astype(np.uint8),
        "levels.png": (64 * (turn % 1024)).astype(np.uint16),
        "photo.png": np.stack([8 * rows, 7 * columns, 5 * rows], -1).astype(np.uint8),
        "quilt_qs8x6a0.75.png": np.full((6 * 16, 8 * 12, 3), turn.max() % 256, np.uint8),
        "disparity.png": (10 * rows).astype(np.uint8),
        "depth.exr": (1 + 0.1 * rows).astype(np.float32),
    }.items():
        mi.Bitmap(values).write(str(folder / name))
    header = ["ply", "format ascii 1.0", "element vertex 40"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {color}" for color in ("red", "green", "blue")]
    points = [f"{math.sin(n)} {math.cos(n)} {0.02 * n} {5 * n} 200 90" for n in range(40)]
    (folder / "scan.ply").write_text("\n".join([*header, "end_header", *points, ""]))


@pytest.fixture(scope="module")
def desk(backend, tmp_path_factory):
    """A folder with the files that the pages begin with: a scene, what was rendered of it, and a device's levels."""
    bpy = pytest.importorskip("bpy")
    from safetensors.numpy import save_file

    from holopath_addon.blender import demo

    folder = tmp_path_factory.mktemp("desk")
    demo.build("planes")
    bpy.context.scene.frame_end = 2
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    for made in ("out/scene", "out/demo"):
        words = [
            "render",
            "demo:planes",
            "--out",
            str(folder / made),
            "--frames",
            "1",
            "--encode",
            "dpac",
            "--quiet",
        ]
        assert cli.main([*words, *SMALL]) == 0
    field = np.load(folder / "out/scene/wavefield/field.npy")
    save_file({"u": np.ascontiguousarray(field[0, 0])}, folder / "u.safetensors")
    for scene in ("room.xml", "scene.xml"):
        (folder / scene).write_text(ROOM)
    brought(folder)
    response = '{"wavelength_nm": 516.5, "range": 0.94}'
    (folder / "my-slm.json").write_text(
        f'{{"format": "HoloPath SLM calibration", "responses": [{response}]}}'
    )
    fitted = re.search(r'(?s)```json\n("displays".*?)```', (DOCS / "display-model.md").read_text("utf-8"))[1]
    (folder / "my-fitted-slm.json").write_text(
        f'{{"format": "HoloPath SLM calibration", "responses": [{response.replace("516.5", "520")}], {fitted}}}'
    )
    models = tuple(engine.DisplayModel(nm * 1e-9) for nm in (640, 516.5, 455.4))
    camera = slm.Sensor((24, 24), homographies={1e-3: (1, 0, 0, 0, 1, 0, 0, 0)})
    slm.Calibration(models=models, sensors=3 * (camera,)).save(folder / "my-colors.json")
    plm = re.search(r"(?s)```json\n(\{[^`]*\"PLM\".*?)```", (DOCS / "slm.md").read_text("utf-8"))[1]
    (folder / "my-plm.json").write_text(plm)
    study = re.search(r"(?s)```toml\n(scenes.*?)```", (DOCS / "study.md").read_text("utf-8"))[1]
    (folder / "speckle.toml").write_text(study.replace("128x128", "32x32").replace("[0, 1]", "[0]"))
    return folder


def small(words):
    """The same command with little to compute."""
    words = [IN_PLACE_OF.get(word, word) for word in words]
    for option, value in {"--frames": "1", "--encode-seconds": "1"}.items():
        if option in words:
            words[words.index(option) + 1] = value
    if "--display" in words:
        del words[words.index("--display") : words.index("--display") + 2]
    if words[0] in ("render", "plan"):
        colors = "--color-scale" in words or "--wavelengths" in words  # has them already, or is of three
        words += SMALL[2 if "--resolution" in words else 0 : -2 if colors else None]
        words += ["--frames", "1"] if "--frames" not in words else []
    return words


@pytest.mark.slow
@pytest.mark.parametrize("page", dict.fromkeys(page for page, _ in COMMANDS))
def test_commands_run(page, desk, tmp_path, monkeypatch):
    """Those of a page one after the other, small; each page begins anew."""
    monkeypatch.chdir(shutil.copytree(desk, tmp_path / "desk"))
    asked = [words for other, words in COMMANDS if other == page and not ELSEWHERE & set(words)]
    if page == "docs/display-model.md":
        asked = [[word.replace("my-slm", "my-fitted-slm") for word in words] for words in asked]
    for words in asked:
        assert cli.main([*small(words), "--quiet"]) == 0, words
