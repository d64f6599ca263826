"""`holopath template`: the files with which Flamenco and SLURM render."""

from pathlib import Path

from .. import engine
from ..workflow import output

FILES = {"flamenco": "holopath.js", "slurm": "slurm.sh"}
_FOLDER = Path(__file__).parents[1] / "farm" / "templates"


def add(command):
    """Add the command; `command(name, run, text)` makes its parser."""
    template = command("template", _template, "Print a render farm's job file: docs/farm.md tells its use.")
    template.add_argument(
        "farm",
        choices=tuple(FILES),
        help="flamenco: a job type for the manager's folder scripts; slurm: a job array for sbatch",
    )
    template.add_argument("--out", metavar="FILE", help="write it there (default: standard output)")


def _template(args):
    data = (_FOLDER / FILES[args.farm]).read_bytes()
    if args.out is None:
        print(data.decode(), end="")
        return
    target = Path(args.out).absolute()
    if target.exists():
        raise engine.InvalidInput(f"{args.out} exists already: choose another name.")
    output.write_pictures(target.parent, {target.name: data})
