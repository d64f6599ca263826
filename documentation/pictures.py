"""Every picture of README.md and docs/, and what makes it."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
LABELS = IMAGES / "labels.json"  # by picture and panel, see `labels`
# Width and height of Blender's window for each picture of it, pixels.
SIZES = {
    "panel": (1060, 860),
    "rendering": (1500, 1060),
    "result": (1500, 1060),
    "phase": (1500, 1060),
    "hologram": (1500, 1060),
    "overlay": (1060, 860),
    "optics": (1500, 1060),
    "viewport": (1060, 860),
    "baked-light": (1500, 860),
    "device": (1500, 1060),
}
FILM = (1060, 720)  # of the window in the film
OWN = "python -m documentation pictures"
QUALITY = 75  # of JPEG and WebP
MAX_WIDTH = 1100  # pixels of a JPEG: a page shows no more
GAP = 4  # pixels between pictures that are set side by side


@dataclass(frozen=True)
class Picture:
    """A picture of the documentation.

    Attributes
    ----------
    commands : tuple of str
        What makes it, one after the other in the checkout's folder; one that begins with `OWN` is done by `make`.
    made : tuple of str
        Files that the commands leave, of which the picture is made; none where they write the picture itself.
    down : bool
        Whether several files are set one below the other, and not side by side.
    crop : int
        Pixels a side of the middle of each file that are shown, twice as large; 0: all of it.
    """

    commands: tuple[str, ...]
    made: tuple[str, ...] = ()
    down: bool = False
    crop: int = 0


def _benchmark(benchmark: str, name: str) -> Picture:
    return Picture((f"python -m benchmarks {benchmark}",), (f"out/bench/{name}.png",))


def _example(name: str, suffix: str) -> Picture:
    return Picture((f"python examples/{name}.py",), (f"out/examples/{name}/{name}.{suffix}",))


def _demo(*focus: str) -> Picture:
    return Picture(
        ("make demo",), tuple(f"out/demo/reconstruction/hologram_focus_{each}.png" for each in focus)
    )


CUBE = "out/pictures/cube.blend"
SCENES = re.findall(r"\(images/chart-closeups-(\w+)\.jpg\)", (ROOT / "docs" / "chart.md").read_text("utf-8"))
DISPLAYS = ("look", "one", "soon", "three", "eyebox", "stack", "eight", "middle", "levels", "many", "binary")
FEATURES = (
    '"textured Transmission" Bump "Normal Map" Noise Voronoi Checker Brick "Wave Texture, Generated" random'
)

# Of the window of Blender, by `window`.
WINDOW = {f"{name}.jpg": Picture((f"{OWN} {name}.jpg",)) for name in SIZES}
FILMED = {"window.webp": Picture((f"{OWN} window.webp",))}
RENDERED = {
    "demo.jpg": Picture(("make demo",), ("out/demo/demo.png",)),
    "refocused.jpg": _demo("0.5m", "4m"),
    "one-frame.jpg": Picture(
        (
            "python -m holopath_addon render demo:suzanne --resolution 512x512 --pitch 8 --frames 1 --focus 0.5m,1m,4m "
            "--encode auto --contact-sheet one-frame.png --out out/pictures/one-frame",
        ),
        ("out/pictures/one-frame/one-frame.png",),
    ),
    "recording-planes.jpg": Picture(
        (
            "mkdir -p out/pictures",
            f"python -c \"import bpy; bpy.ops.wm.save_as_mainfile(filepath='{CUBE}')\"",
            f"python -m holopath_addon render {CUBE} --focus 10m --planes 1 --out out/pictures/one-plane",
            f"python -m holopath_addon render {CUBE} --focus 10m --out out/pictures/planes",
        ),
        tuple(f"out/pictures/{each}/reconstruction/focus_10m.png" for each in ("one-plane", "planes")),
        crop=260,
    ),
}
# Charts: the pages tell the figures of the same runs.
MEASURED = {
    **{f"{name}.png": _benchmark(name, name) for name in ("accuracy", "convergence", "encoding")},
    **{f"{name}.png": _benchmark("phase_fields", name) for name in ("phase_fields", "despeckle")},
    "exporter.png": Picture(
        (f"python -m benchmarks exporter {FEATURES} --pictures out/bench/exporter",),
        ("out/bench/exporter/textures.png", "out/bench/exporter/random.png"),
        down=True,
    ),
    **{
        f"chart-{name}.png": Picture(("make chart",))
        for name in ("seconds", "frames", "table-1", "convergence", "triangles")
    },
    **{f"chart-closeups-{scene}.jpg": Picture(("make chart",)) for scene in SCENES},
    **{
        f"which-{name}.webp": Picture(
            ("python -m benchmarks which_method",), (f"out/bench/which_method/{name}.png",)
        )
        for name in ("truth", *DISPLAYS)
    },
    **{
        f"stability-{name}.png": Picture(("python -m benchmarks stability",))
        for name in ("scenes", "roughness", "displays")
    },
}
FILMS = {"animation", "baked_light", "parallax", "refocus_film"}
STILLS = {
    *("calibrated_bench", "convex_mirror", "encodings", "few_bits", "glass_ball", "methods", "other_program"),
    *("speckle", "two_million_triangles"),
}
GALLERY = {
    f"gallery/{name}.webp": _example(name, "webp" if name in FILMS else "png")
    for name in sorted(FILMS | STILLS)
}
SKETCHES = {
    f"bench-{name}.svg": Picture(("python -m documentation sketches",))
    for name in ("point", "gaussian", "carrier", "half", "eyepiece", "lens")
}
PICTURES: dict[str, Picture] = WINDOW | FILMED | RENDERED | MEASURED | GALLERY | SKETCHES


def table() -> str:
    """A line for each picture: its file, and what makes it."""
    width = max(map(len, PICTURES))
    return "\n".join(f"{name:{width}}  {' && '.join(picture.commands)}" for name, picture in PICTURES.items())


def make(names: Iterable[str]) -> None:
    """Make pictures anew, and print what is done and how long it takes.

    Parameters
    ----------
    names : iterable of str
        Of `PICTURES`.

    Raises
    ------
    SystemExit
        Where a name is unknown, or a command fails.
    """
    names = list(names)
    unknown = [name for name in names if name not in PICTURES]
    if unknown:
        raise SystemExit(f"There is no picture {', '.join(unknown)}: `{OWN} --list` has them all.")
    in_window = [name for name in names if name in WINDOW | FILMED]
    if in_window:
        from . import window  # which needs an X server

        with window.opened() as take:
            for name in in_window:
                with _timed(name):
                    take(name)
    others = [name for name in names if name not in in_window]
    for command in dict.fromkeys(command for name in others for command in PICTURES[name].commands):
        with _timed(command):
            _run(command)
    for name in others:
        if PICTURES[name].made:
            _assemble(PICTURES[name], IMAGES / name)


@contextmanager
def _timed(what):
    begin = time.monotonic()
    print(what, file=sys.stderr, flush=True)
    yield
    print(f"    {time.monotonic() - begin:.0f} s", file=sys.stderr, flush=True)


def _run(command):
    """A command in the checkout's folder, by this Python."""
    words = shlex.split(command)
    words[0] = sys.executable if words[0] == "python" else words[0]
    status = subprocess.run(
        words, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, check=False
    ).returncode
    if status:
        raise SystemExit(f"`{command}` ended with status {status}.")


def _assemble(picture, path):
    """Make a picture of the files that its commands left."""
    files = [ROOT / name for name in picture.made]
    if len(files) == 1 and files[0].suffix == path.suffix:
        shutil.copyfile(files[0], path)
        return
    made = joined([_middle(Image.open(file).convert("RGB"), picture.crop) for file in files], picture.down)
    if path.suffix == ".jpg":
        made.thumbnail((MAX_WIDTH, made.height), Image.Resampling.LANCZOS)
    made.save(path, quality=QUALITY)


def _middle(image, side):
    """The middle of a picture, twice as large; all of it where `side` is 0."""
    if not side:
        return image
    left, top = (image.width - side) // 2, (image.height - side) // 2
    return image.crop((left, top, left + side, top + side)).resize(
        (2 * side, 2 * side), Image.Resampling.NEAREST
    )


def joined(parts: Sequence[Image.Image], down: bool = False) -> Image.Image:
    """Pictures side by side, or one below the other; smaller ones in the middle."""
    sizes = [(part.height, part.width) if down else part.size for part in parts]  # along, across
    length, breadth = (
        sum(along for along, _ in sizes) + GAP * (len(sizes) - 1),
        max(size[1] for size in sizes),
    )
    both = Image.new("RGB", (breadth, length) if down else (length, breadth), "white")
    place = 0
    for part, (along, across) in zip(parts, sizes, strict=True):
        beside = (breadth - across) // 2
        both.paste(part, (beside, place) if down else (place, beside))
        place += along + GAP
    return both
