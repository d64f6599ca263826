"""Run all benchmarks: tables on standard output, charts in out/bench."""

from holopath_addon.engine import backend


def main():
    backend.activate()
    from . import accuracy, kernel

    print(kernel.run(), flush=True)
    print(accuracy.run("out/bench"), flush=True)


if __name__ == "__main__":
    main()
