"""`--cluster`: units that the workers of Dask make, what is seen of it, and the command that they run."""

import shutil
import sys
import threading
import time
from contextlib import contextmanager

from .. import engine
from ..farm import worker
from ..farm.cluster import FORMS, Cluster
from ..farm.executor import ClusterExecutor
from ..farm.work import work_off
from ..workflow import failures
from .options import argument

TOLD = 10.0  # seconds between two lines of progress in a file
SELDOM = 60.0  # and between two tables
DRAWN = 0.5  # seconds between two of them in a terminal


def add_option(parser, what):
    parser.add_argument(
        "--cluster",
        type=argument(Cluster.parse),
        metavar=FORMS,
        help=f"{what} by the workers of a Dask scheduler, by N processes here, or by jobs of SLURM, whose options are "
        "in FILE; needs `pip install distributed`, and dask-jobqueue for slurm",
    )


def add(commands, parse):
    """Add what a worker's child runs; it is not listed.

    Parameters
    ----------
    commands : argparse's sub-parsers
    parse : callable
        ``parse(words)`` of a command, whose ``work(args, say)`` is `farm.work.Work`.
    """
    parser = commands.add_parser("worker", allow_abbrev=False)
    parser.set_defaults(
        run=lambda args: worker.serve(lambda words, say: _opened(parse(words), say)), debug=False
    )


def _opened(args, say):
    work = args.work(args, say)

    def make(name, progress):
        work_off(work.folder, [work.units[name]], work.job.tag, progress, say)

    return make


@contextmanager
def animating(folder):
    """Who cancels it hears what stays."""
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        if not failures.cancelled(error):
            raise
        raise engine.Cancelled(
            f"Cancelled: the frames that are done are in {folder}, and the same command goes on after them."
        ) from error


def work_by(args, work, progress):
    """Have the units of some work made: by the cluster that the words name, else by this process."""
    units, tag = work.units.values(), work.job.tag
    if args.cluster is None or all(unit.done() for unit in units):
        work_off(work.folder, units, tag, progress, progress.say)
        return
    progress(0.0, "Starting the cluster")
    with args.cluster.client(work.folder) as client:
        watch = _Watch(progress, args.quiet)
        executor = ClusterExecutor(
            client, args.cluster.workers > 0, args.words, watch.progress, watch.say, watch.show
        )
        made = executor.work_off(work.folder, list(units), tag)
        work.made.extend(name for name in made if not work.units[name].prepares)


class _Watch:
    """A table below the line of progress, drawn over and over in a terminal, and now and then elsewhere."""

    def __init__(self, progress, quiet):
        self._progress, self._quiet, self._terminal = progress, quiet, sys.stderr.isatty()
        self._lock = threading.Lock()  # remarks come in a thread of Dask's
        self._last, self._told = time.monotonic(), -TOLD

    def progress(self, done, message):
        if not self._terminal and time.monotonic() - self._told < TOLD:
            return
        self._told = time.monotonic()
        with self._lock:
            self._progress(done, message)

    def say(self, text):
        with self._lock:
            self._clear()
            self._progress.say(text)

    def show(self, rows):
        """Show the rows; no rows end it."""
        if self._quiet:
            return
        with self._lock:
            if not rows:
                self._clear()
            elif time.monotonic() - self._last > (DRAWN if self._terminal else SELDOM):
                self._last = time.monotonic()
                self._draw(rows)

    def _draw(self, rows):
        if not self._terminal:
            print(*rows, sep="\n", file=sys.stderr, flush=True)
            return
        columns, lines = shutil.get_terminal_size()
        shown = [row[: columns - 1] for row in rows[: lines - 2]]
        below = "".join(f"\n\x1b[K{row}" for row in shown)
        print(f"{below}\x1b[{len(shown)}A\r", end="", file=sys.stderr, flush=True)

    def _clear(self):
        if self._terminal:
            print("\r\x1b[J", end="", file=sys.stderr, flush=True)
