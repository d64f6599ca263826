"""Run one benchmark by its name, or those of `make bench`: tables on standard output, charts in out/bench."""

import argparse
import sys
from importlib import import_module

from holopath_addon.engine import BackendUnavailable, InvalidInput
from holopath_addon.engine.scene import variants

OUT = "out/bench"
# Name and function of each, and whether it writes charts; those that take long only run where they are named.
ALL = {
    "kernel": ("kernel.run", False),
    "accuracy": ("accuracy.run", True),
    "convergence": ("convergence.run", True),
    "planes": ("convergence.planes_table", False),
    "scaling": ("scaling.run", False),
    "optics": ("optics.run", False),
    "phase_fields": ("phase_fields.run", True),
    "radiance_cache": ("radiance_cache.run", False),
    "planning": ("planning.run", False),
    "encoding": ("encoding.run", True),
    "export_speed": ("export_speed.run", False),
    "exporter": ("exporter.main", False),
}
NAMED = {
    "display_model": ("display_model.run", False),
    "farm": ("farm.run", False),
    "foretold": ("foretold.run", False),
    "full_hd": ("full_hd.run", False),
    "hsplat": ("hsplat.run", False),
    "refinement": ("refinement.run", False),
    "slm": ("slm.run", False),
    "stability": ("stability.report.run", True),
    "chart": ("chart.run.run", False),
}


def main():
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("name", nargs="?", choices=ALL | NAMED, help="default: all but " + ", ".join(NAMED))
    parser.add_argument("parts", nargs=argparse.REMAINDER, help="of it, such as scenes; default: all")
    options = parser.parse_args()
    try:
        variants.activate()
    except (BackendUnavailable, InvalidInput) as error:
        print(error, file=sys.stderr)
        return 2
    if options.name:
        run(*(ALL | NAMED)[options.name], options.parts)
    else:
        for function, charts in ALL.values():
            run(function, charts, ["--pictures", f"{OUT}/exporter"] if function == "exporter.main" else [])


def run(function, charts, parts):
    """Print the table of a benchmark, of all its parts or of those named."""
    module, name = function.rsplit(".", 1)
    table = getattr(import_module(f"benchmarks.{module}"), name)
    print(table(*([OUT] if charts else []), *parts), flush=True)


if __name__ == "__main__":
    sys.exit(main())
