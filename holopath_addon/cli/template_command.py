"""Command `holopath template`: job files for Flamenco and SLURM."""

import sys
from pathlib import Path

from .. import engine
from ..workflow import output

FILES = {"flamenco": "holopath.js", "slurm": "slurm.sh"}
_FOLDER = Path(__file__).parents[1] / "farm" / "templates"


def add(command):
    """Add the command.

    Parameters
    ----------
    command : callable
        See `render_command.add`.
    """
    template = command("template", _template, "Print a render farm's job file, see docs/farm.md.")
    template.add_argument(
        "farm",
        choices=tuple(FILES),
        help="flamenco: a job type for the manager's folder scripts; slurm: a job array for sbatch",
    )
    template.add_argument("--out", metavar="FILE", help="file to write (default: standard output)")


def _template(args):
    data = (_FOLDER / FILES[args.farm]).read_bytes()
    if args.out is None:
        sys.stdout.flush()
        sys.stdout.buffer.write(data)  # without Windows' ends of lines, which sbatch refuses
        return
    target = Path(args.out).absolute()
    if target.exists():
        raise engine.InvalidInput(f"{args.out} exists already. Choose another name.")
    output.write_pictures(target.parent, {target.name: data})
