"""Run all benchmarks, or one that is named: tables on standard output, charts in out/bench."""

import sys

from holopath_addon.engine import backend


def main():
    backend.activate()
    if sys.argv[1:2] == ["exporter"]:
        from . import exporter

        exporter.main(sys.argv[2:])
        return
    if sys.argv[1:] == ["export_speed"]:
        from . import export_speed

        print(export_speed.run())
        return
    if sys.argv[1:2] == ["radiance_cache"]:
        from . import radiance_cache

        print(radiance_cache.run(*sys.argv[2:]))
        return
    if sys.argv[1:2] == ["encoding"]:
        from . import encoding

        print(encoding.run("out/bench", *sys.argv[2:]))
        return
    if sys.argv[1:2] == ["planning"]:
        from . import planning

        print(planning.run(*sys.argv[2:]))
        return
    if sys.argv[1:2] == ["foretold"]:
        from . import foretold

        print(foretold.run(*sys.argv[2:]))
        return
    if sys.argv[1:2] == ["slm"]:
        from . import slm

        print(slm.run(*sys.argv[2:]))
        return
    if sys.argv[1:2] == ["stability"]:
        from .stability import report

        print(report.run("out/bench", *sys.argv[2:]))
        return
    if sys.argv[1:2] == ["chart"]:
        from .chart import run

        print(run.run(*sys.argv[2:]))
        return
    from . import (
        accuracy,
        convergence,
        encoding,
        export_speed,
        exporter,
        kernel,
        optics,
        phase_fields,
        planning,
        radiance_cache,
        scaling,
    )

    print(kernel.run(), flush=True)
    print(accuracy.run("out/bench"), flush=True)
    print(convergence.run("out/bench"), flush=True)
    print(convergence.planes_table(), flush=True)
    print(scaling.run(), flush=True)
    print(optics.run(), flush=True)
    print(phase_fields.run("out/bench"), flush=True)
    print(radiance_cache.run(), flush=True)
    print(planning.run(), flush=True)
    print(encoding.run("out/bench"), flush=True)
    print(export_speed.run(), flush=True)
    print(exporter.run(pictures="out/bench/exporter"), flush=True)


if __name__ == "__main__":
    main()
