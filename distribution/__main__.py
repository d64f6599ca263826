"""Build what users install: `extension` writes the zips, `card` those for NVIDIA cards, `repository` a folder of zips
that Blender updates from."""

import argparse
import sys
from pathlib import Path

from . import extension, llvm, proof, repository, wheels, xatlas


def main(argv=None):
    parser = argparse.ArgumentParser(prog="python -m distribution", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, tell, out in (
        ("extension", "write a zip for each platform and Python", extension.OUT),
        ("card", "write a zip for each platform and Python with what an NVIDIA card needs", extension.OUT),
        ("repository", "write the zips and Blender's index of them", extension.OUT / "repository"),
    ):
        command = commands.add_parser(name, help=tell)
        choices = {"nargs": "+", "metavar": "NAME"}
        command.add_argument(
            "--platform", **choices, choices=wheels.PIP_PLATFORMS, default=[*wheels.PIP_PLATFORMS]
        )
        command.add_argument("--python", **choices, choices=wheels.PYTHONS, default=[*wheels.PYTHONS])
        command.add_argument("--out", type=Path, default=out, help="folder of the zips")
        command.add_argument(
            "--stored", action="store_true", help="for trials: our own wheels packed in no time"
        )
    commands.add_parser("llvm", help="install this computer's LLVM beside the Python that runs this")
    commands.add_parser("xatlas", help="build xatlas for the Python that runs this, on Linux, and install it")
    commands.add_parser("lock", help="after a change of WHEELS: fetch them all, and write wheels.lock")
    options = parser.parse_args(argv)
    if options.command == "lock":
        wheels.renew_lock()
    elif options.command == "llvm":
        llvm.install(wheels.this_platform())
    elif options.command == "xatlas":
        xatlas.install()
    else:
        proofs = []
        build = extension.build_for_cards if options.command == "card" else extension.build_all
        for target, found in build(options.platform, options.python, options.out, packed=not options.stored):
            proofs.append(found)
            print(target, flush=True)
        print(proof.table(proofs), file=sys.stderr)
        if options.command == "repository":
            repository.publish(options.out, extension.version())
            print(options.out / "index.json")


if __name__ == "__main__":
    sys.exit(main())
