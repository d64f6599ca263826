"""Run one benchmark by its name, or those of `make bench`: tables on standard output, charts in out/bench."""

import argparse
import os
import shlex
import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from holopath_addon.engine import BackendUnavailable, InvalidInput
from holopath_addon.engine.scene import variants

from .parts import Incomplete, joined

OUT = "out/bench"
SMALLEST = f"{OUT}/smallest"


@dataclass(frozen=True)
class Benchmark:
    """A benchmark by its name.

    Attributes
    ----------
    function : str
        Its module within `benchmarks`, and the function there that returns the table.
    smallest : tuple of str
        Command lines that run all of its code on as little as it takes, seconds each. `{out}` in them is the folder
        of results, `{hsplat}` what HOLOPATH_HSPLAT names.
    takes_folder : bool
        Whether the function's first argument is the folder of results.
    usual : str
        Command line of `make bench`.
    """

    function: str
    smallest: tuple[str, ...]
    takes_folder: bool = False
    usual: str = ""


# Those of `make bench`; the others take long, or need more than this program, and run where they are named.
ALL = {
    "kernel": Benchmark("kernel.run", ("pixels=32 repeats=1",)),
    "accuracy": Benchmark("accuracy.run", ("pixels=32 frames=2",), takes_folder=True),
    "convergence": Benchmark("convergence.run", ("pixels=32",), takes_folder=True),
    "planes": Benchmark("convergence.planes_table", ("pixels=32 max_planes=2",)),
    "scaling": Benchmark("scaling.run", ("pixels=32 max_triangles=1000 objects=80",)),
    "optics": Benchmark("optics.run", ("pixels=32 scenes=1",)),
    "phase_fields": Benchmark("phase_fields.run", ("pixels=32 scenes=1",), takes_folder=True),
    "radiance_cache": Benchmark("radiance_cache.run", ("'closed box' pixels=32",)),
    "planning": Benchmark("planning.run", ("'flat picture' pixels=32",)),
    "encoding": Benchmark("encoding.run", ("pixels=32 scenes=1",), takes_folder=True),
    "export_speed": Benchmark("export_speed.run", ("repeats=1 objects=8",)),
    "exporter": Benchmark(
        "exporter.main",
        ("NURBS --pictures {out}/exporter --markdown {out}/exporter.md",),
        usual="--pictures {out}/exporter",
    ),
}
NAMED = {
    "at_random": Benchmark("at_random.run", ("scenes=2",)),
    "card": Benchmark("card.run", ("32x18 2 dpac,sgd steps=1",)),
    "display_model": Benchmark(
        "display_model.run", ("1 pixels=16 captures=20 foci=2 stages=1", "tuned 1 pixels=16 rounds=1")
    ),
    "farm": Benchmark("farm.run", ("pixels=32 max_workers=4", "check pixels=32 frames=1"), takes_folder=True),
    "foretold": Benchmark("foretold.run", ("planes pixels=32",)),
    "full_hd": Benchmark("full_hd.run", ("32x18",)),
    "hsplat": Benchmark("hsplat.run", ("{hsplat} 32 1 planes",)),
    "refinement": Benchmark("refinement.run", ("pixels=32 scenes=1",)),
    "slm": Benchmark("slm.run", ("serial noise prepare pixels=32", "monitor pixels=32")),
    "stability": Benchmark("stability.report.run", ("quick pitch",), takes_folder=True),
    "which_method": Benchmark("which_method.run", ("pixels=48 paths=4 displays=2",), takes_folder=True),
    "chart": Benchmark(
        "chart.run.run",
        (
            "quick --methods rgbd auto --pixels 32 --out {out}/chart-quick",
            "planes --methods rgbd full --pixels 32 --out {out}/chart",
        ),
    ),
}


def main():
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "--smallest", action="store_true", help="see that it runs to its end, on as little as it takes"
    )
    parser.add_argument(
        "--out",
        metavar="FOLDER",
        help=f"of charts and what is kept; default: {OUT}, with --smallest {SMALLEST}",
    )
    parser.add_argument("name", nargs="?", choices=ALL | NAMED, help="default: all but " + ", ".join(NAMED))
    parser.add_argument(
        "words", nargs=argparse.REMAINDER, help="what it is to do, such as scenes, or pixels=64; default: all"
    )
    options = parser.parse_args()
    chosen = {options.name: (ALL | NAMED)[options.name]} if options.name else ALL
    out = options.out or (SMALLEST if options.smallest else OUT)
    runs = {}
    for name, benchmark in chosen.items():
        lines = benchmark.smallest if options.smallest else [benchmark.usual]
        for line in lines:
            words = options.words or words_of(line, out)
            runs[shlex.join([name, *words])] = lambda benchmark=benchmark, words=words: run(
                benchmark, words, out
            )
    try:
        variants.activate()
        if len(runs) == 1:
            next(iter(runs.values()))()
        else:
            joined(runs)
    except (BackendUnavailable, InvalidInput) as error:
        print(error, file=sys.stderr)
        return 2
    except Incomplete as error:
        print("Not all was measured:", *error.faults, sep="\n  ", file=sys.stderr)
        return 1


def words_of(line, out):
    """Words of a command line of `Benchmark`, with their folders."""
    folders = {"out": out, "hsplat": os.environ.get("HOLOPATH_HSPLAT", "hsplat")}
    return [word.format(**folders) for word in shlex.split(line)]


def run(benchmark, words, out=OUT):
    """Print the table of a benchmark.

    Parameters
    ----------
    benchmark : Benchmark
    words : sequence of str
        ``name=value`` is an argument by name.
    out : str
        Folder of results.
    """
    module, function = benchmark.function.rsplit(".", 1)
    Path(out).mkdir(parents=True, exist_ok=True)
    places, named = [out] if benchmark.takes_folder else [], {}
    for word in words:
        name, equals, value = word.partition("=")
        if equals and name.isidentifier():
            named[name] = int(value) if value.isdecimal() else value
        else:
            places.append(word)
    try:
        print(getattr(import_module(f"benchmarks.{module}"), function)(*places, **named), flush=True)
    except Incomplete as error:
        print(error.table, flush=True)
        raise


if __name__ == "__main__":
    sys.exit(main())
