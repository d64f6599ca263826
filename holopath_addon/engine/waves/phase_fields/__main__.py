"""Command line ``python -m holopath_addon.engine.waves.phase_fields design --frames 24 --out maps.npy``."""

from __future__ import annotations

import argparse
import math
import signal
import sys
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InvalidInput
from . import random_phasors
from .design import Design, Recipe, run

if TYPE_CHECKING:
    from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Return the exit status: 0 done, 1 a file cannot be written, 2 bad input, 130 interrupted."""
    parser = argparse.ArgumentParser(prog="python -m holopath_addon.engine.waves.phase_fields")
    commands = parser.add_subparsers(required=True)
    design = commands.add_parser(
        "design", help="optimize a set of phase maps; continue after an interruption"
    )
    design.add_argument("--frames", type=int, required=True, metavar="M", help="number of maps")
    design.add_argument("--size", type=int, default=Recipe.size, help="period in pixels, a power of two")
    design.add_argument("--steps", type=int, default=Recipe.steps)
    design.add_argument(
        "--reach", type=float, default=Recipe.reach, help="largest defocus, wavelength z / pitch^2"
    )
    design.add_argument(
        "--plane", type=float, default=Recipe.plane, help="fraction of steps on an even plane"
    )
    design.add_argument(
        "--prefixes",
        type=float,
        default=Recipe.prefixes,
        help="weight of the first few frames besides all",
    )
    design.add_argument(
        "--narrow",
        type=float,
        default=Recipe.narrow,
        help="weight of images through narrow parts of the pupil",
    )
    design.add_argument("--rate", type=float, default=Recipe.rate, help="longest step in radians")
    design.add_argument("--start", type=Path, metavar="FILE.npy", help="maps to start with (default: random)")
    design.add_argument("--seed", type=int, default=Recipe.seed)
    design.add_argument("--out", type=Path, required=True, metavar="FILE.npy")
    design.add_argument("--state", type=Path, metavar="FILE.npz", help="default: beside the result")
    args = parser.parse_args(argv)
    try:
        recipe = Recipe(**{field.name: getattr(args, field.name) for field in fields(Recipe)})
        state = args.state or args.out.with_suffix(".state.npz")
        if not args.out.parent.is_dir():
            raise InvalidInput(f"There is no folder {args.out.parent}. Create it first.")
        if state.exists():
            work = Design.load(state, recipe)
            print(f"continuing at step {work.done} of {state}", file=sys.stderr)
        else:
            work = Design(recipe, _start(recipe, args.start))
        with _interrupts() as interrupted:
            finished = run(work, state, _report, interrupted)
        if not finished:
            print("interrupted: the same command continues from here", file=sys.stderr)
            return 130
        work.save_maps(args.out)
    except InvalidInput as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"Cannot write {error.filename}: {error.strerror}.", file=sys.stderr)
        return 1
    return 0


@contextmanager
def _interrupts():
    """Handle Ctrl-C and SIGTERM within the block: they only make the returned function return True."""
    signals = []
    before = {
        number: signal.signal(number, lambda *_: signals.append(1))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield lambda: bool(signals)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _start(recipe, path):
    if path is None:
        return np.angle(random_phasors(recipe.frames, recipe.size, recipe.size, recipe.seed))
    try:
        maps = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InvalidInput(f"{path} has no readable maps. Use a file that this program wrote.") from error
    shape = recipe.frames, recipe.size, recipe.size
    if maps.shape != shape or maps.dtype != np.uint8:
        raise InvalidInput(
            f"Expected uint8 {shape} in {path}, got {maps.dtype} {maps.shape}. Change --frames or --size."
        )
    return (maps * (2 * math.pi / 256)).astype(np.float32)


def _report(step, losses):
    means = "  ".join(f"{m}: {loss:.3f}" for m, loss in losses.items())
    print(f"step {step}: squared error over that of independent frames, by frames: {means}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
