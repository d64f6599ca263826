"""Run all benchmarks: tables on standard output, charts in out/bench."""

from holopath_addon.engine import backend


def main():
    backend.activate()
    from . import accuracy, convergence, kernel, optics, phase_fields, scaling

    print(kernel.run(), flush=True)
    print(accuracy.run("out/bench"), flush=True)
    print(convergence.run("out/bench"), flush=True)
    print(convergence.planes_table(), flush=True)
    print(scaling.run(), flush=True)
    print(optics.run(), flush=True)
    print(phase_fields.run("out/bench"), flush=True)


if __name__ == "__main__":
    main()
