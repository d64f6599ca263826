"""Every command that is documented runs to its end: benchmarks on as little as they take, and the targets of make."""

import filecmp
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import __main__ as command
from benchmarks.__main__ import ALL, NAMED, Benchmark, words_of
from benchmarks.parts import Incomplete, drawn, joined
from distribution.wheels import this_platform
from holopath_addon.engine.scene import variants
from tests.slm.conftest import x_server  # noqa: F401 (a fixture)
from tests.turns import DAILY, in_turn

ROOT = Path(__file__).parents[1]
HERE, CI, LITTLE = "run by these tests", "run by .ci/run", "run by these tests in little"
# Where each target of the Makefile is run.
TARGETS = {
    "env": CI,
    "demo": HERE,
    "test": CI,
    "test-slow": CI,
    "test-all": CI,  # what it consists of
    "test-cuda": HERE,  # without a card: that it says so
    "bench-cuda": HERE,
    "lint": CI,
    "bench": LITTLE,
    "chart": LITTLE,
    "chart-quick": LITTLE,
    "extension": HERE,
    "repository": HERE,
    "docs": CI,
    "guide": HERE,
    "clean": HERE,
}
RECIPES = {"bench": "benchmarks", "chart": "benchmarks chart --docs", "chart-quick": "benchmarks chart quick"}
NOT_COPIED = (".*", "build", "out", "dist", "__pycache__", "*.egg-info")


def make(folder, *words, **options):
    """Run make in a folder, which never installs: the environment is the one that runs this."""
    done = [f"--old-file=.venv/{name}" for name in (".holopath-run", ".holopath-dev", ".holopath-oracles")]
    # not as a part of the make that runs these tests
    own = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    return subprocess.run(
        ["make", "--no-print-directory", "--old-file=.venv/bin/python", *done, *words],
        cwd=folder,
        env=own,
        capture_output=True,
        text=True,
        **options,
    )


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the checkout, which commands may write to."""
    folder = tmp_path_factory.mktemp("copy") / "holopath"
    shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*NOT_COPIED))
    (folder / ".venv").symlink_to(Path(sys.prefix))
    (ROOT / "build" / "wheels").mkdir(parents=True, exist_ok=True)
    (folder / "build").mkdir()
    (folder / "build" / "wheels").symlink_to(ROOT / "build" / "wheels")  # fetched once
    return folder


def test_every_target_is_run():
    """A new target is run by CI or by these tests."""
    makefile = (ROOT / "Makefile").read_text("utf-8")
    assert re.search(r"(?m)^\.PHONY: (.*)", makefile)[1].split() == [*TARGETS]
    ci = (ROOT / ".ci" / "run").read_text("utf-8")
    called = set(re.findall(r"\bmake ([\w-]+)", ci)) | {"env", "test-all"}
    assert {name for name, where in TARGETS.items() if where == CI} == called
    assert {name for name, where in TARGETS.items() if where == LITTLE} == RECIPES.keys()


@pytest.mark.parametrize("target", RECIPES)
def test_what_targets_of_benchmarks_run(target):
    """Those are run in little below, by the same words."""
    assert make(ROOT, "-n", target).stdout.splitlines() == [f".venv/bin/python -m {RECIPES[target]}"]


def test_every_benchmark_has_a_smallest_run(tmp_path):
    known = ALL | NAMED
    for name, benchmark in known.items():
        assert benchmark.smallest, name
        module, function = benchmark.function.rsplit(".", 1)
        source = (ROOT / "benchmarks" / f"{module.replace('.', '/')}.py").read_text("utf-8")
        assert f"\ndef {function}(" in source
        for line in benchmark.smallest:
            assert words_of(line, tmp_path), name
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    documented = {
        name
        for page in pages
        for name in re.findall(r"python -m benchmarks ([a-z]\w*)", page.read_text("utf-8"))
    }
    assert documented <= known.keys()


def test_what_fails_leaves_the_others(capsys):
    def fail():
        raise ZeroDivisionError("no light")

    with pytest.raises(Incomplete) as caught:
        joined({"a": lambda: "first", "b": fail, "c": lambda: drawn("third", fail), "d": lambda: "fourth"})
    assert caught.value.table == "first\nthird\nfourth"
    assert caught.value.faults == [
        "b: ZeroDivisionError: no light",
        "c: chart: ZeroDivisionError: no light",
    ]
    assert joined({"a": lambda: "first", "b": lambda: "second"}) == "first\nsecond"

    def interrupt():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        joined({"a": lambda: "first", "b": interrupt, "c": fail})
    assert capsys.readouterr().out == "first\n"


def test_of_several_benchmarks_one_may_fail(monkeypatch, capsys, tmp_path):
    """The others' tables are printed; the last lines name it, and the status is 1."""

    def fail(pixels):
        raise ZeroDivisionError(f"no light on {pixels + 1} pixels")

    toys = SimpleNamespace(fail=fail, run=lambda folder, name: f"table of {name} in {folder}")
    monkeypatch.setitem(sys.modules, "benchmarks.toys", toys)
    known = {
        "broken": Benchmark("toys.fail", ("pixels=32",)),
        "sound": Benchmark("toys.run", ("{out}/a",), takes_folder=True),
    }
    monkeypatch.setattr(command, "ALL", known)
    monkeypatch.setattr(command.variants, "activate", lambda: None)
    monkeypatch.setattr(sys, "argv", ["benchmarks", "--smallest", "--out", str(tmp_path)])
    assert command.main() == 1
    said = capsys.readouterr()
    assert said.out == f"table of {tmp_path}/a in {tmp_path}\n"
    assert said.err.splitlines()[-2:] == [
        "Not all was measured:",
        "  broken pixels=32: ZeroDivisionError: no light on 33 pixels",
    ]


@pytest.mark.parametrize(("commands", "others"), [(26, 370), (27, 111), (2, 5), (0, 3), (4, 0)])
def test_all_have_their_turn(commands, others):
    """Where a day runs a tenth of the other tests, 17 days have run each; and each day some commands."""

    def item(number, command):
        return SimpleNamespace(number=number, get_closest_marker=lambda name: command and name == "command")

    items = [item(n, n < commands) for n in range(commands + others)]
    run, daily = set(), min(DAILY, commands)
    for day in range(739000, 739017):
        order = [each.number for each in in_turn(items, day)]
        assert sorted(order) == [*range(commands + others)]
        assert all(number < commands for number in order[:daily])
        run |= set(order[: daily + -(-others // 10)])
    assert run == {*range(commands + others)}


def test_clean_leaves_what_is_not_made(tmp_path):
    shutil.copy(ROOT / "Makefile", tmp_path)
    for name in ("out", "build", "dist", "docs"):
        (tmp_path / name / "within").mkdir(parents=True)
    assert make(tmp_path, "clean").returncode == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["Makefile", "docs"]


STUB = '''"""As much of hsplat as is called: a plane wave for each set of Gaussians."""

import torch


class Gaussians:
    def __init__(self, means, opacities, turns, scales, colors):
        self.colors = colors


def alpha_wave_blending(primitives, cfg):
    return primitives.colors.mean() * torch.ones(1, 1, *cfg.resolution_hologram, dtype=torch.complex64)
'''


@pytest.fixture
def hsplat(tmp_path, monkeypatch):
    """A stand-in for the program that may not be part of this one."""
    pytest.importorskip("torch")
    for name in ("algorithms", "primitives"):
        (tmp_path / f"{name}.py").write_text(STUB)
    monkeypatch.setenv("HOLOPATH_HSPLAT", str(tmp_path))


@pytest.mark.slow
@pytest.mark.command
@pytest.mark.parametrize("name", ALL | NAMED)
def test_a_benchmark_runs_to_its_end(name, copy, tmp_path, request, monkeypatch):
    pytest.importorskip("bpy")
    if name == "hsplat":
        request.getfixturevalue("hsplat")
    if name == "slm":
        monkeypatch.setenv("DISPLAY", request.getfixturevalue("x_server"))
    words = [sys.executable, "-m", "benchmarks", "--smallest", "--out", str(tmp_path), name]
    done = subprocess.run(words, cwd=copy, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.strip()
    for page in tmp_path.rglob("*.md"):
        for link in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text("utf-8")):
            assert (page.parent / link).stat().st_size > 1000, link


@pytest.mark.slow
@pytest.mark.command
@pytest.mark.parametrize("target", [n for n, where in TARGETS.items() if where == HERE and n != "clean"])
def test_a_target_runs_to_its_end(target, copy):
    pytest.importorskip("bpy")
    card = target.endswith("-cuda")
    if card and variants._cuda_device()[0]:
        pytest.skip("this machine has an NVIDIA card")
    python = "{}.{}".format(*sys.version_info)
    zips = f"ZIPS=--platform {this_platform()} --python {python} --stored"  # those for all fetch a gigabyte
    done = make(copy, target, zips, timeout=1200)
    if card:
        assert done.returncode == 2
        assert re.search(r"(?m)^(Exit: )?cuda_ad_rgb cannot be used: .*\.$", done.stderr)
        return
    assert done.returncode == 0, done.stderr[-3000:]
    if target == "demo":
        assert len([*(copy / "out" / "demo").rglob("*.png")]) >= 3
    elif target == "guide":
        pages = [path.relative_to(ROOT) for path in (ROOT / "docs").rglob("*.md")]
        assert filecmp.cmpfiles(ROOT, copy, pages, shallow=False)[1:] == ([], [])
    elif target == "extension":
        assert [*(copy / "dist").glob("*.zip")]
    elif target == "repository":
        assert (copy / "dist" / "repository" / "index.json").exists()
