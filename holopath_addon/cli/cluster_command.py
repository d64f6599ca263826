"""Option `--cluster`: units that workers of Dask make, a table of their progress, and the command that they run."""

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
from .console import takes_escapes
from .options import argument

LINE_INTERVAL = 10.0  # seconds between two lines of progress in a file
TABLE_INTERVAL = 60.0  # seconds between two tables in a file
REDRAW_INTERVAL = 0.5  # seconds between two tables in a terminal


def add_option(parser, what):
    """Add the option `--cluster`.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    what : str
        The units, for the help text.
    """
    parser.add_argument(
        "--cluster",
        type=argument(Cluster.parse),
        metavar=FORMS,
        help=f"make {what} by workers of a Dask scheduler, by N processes on this machine, or by SLURM jobs with the "
        "options in FILE; needs `pip install distributed`, and dask-jobqueue for slurm",
    )


def add(commands, parse):
    """Add the command that a worker's child process runs; it is not listed.

    Parameters
    ----------
    commands : argparse's action of sub-parsers
    parse : callable
        ``parse(words)`` gives a command's arguments, whose ``work(args, say)`` gives its `farm.work.Work`.
    """
    parser = commands.add_parser("worker", allow_abbrev=False)
    parser.set_defaults(
        run=lambda args: worker.serve(lambda words, say: _maker(parse(words), say)), debug=False
    )


def _maker(args, say):
    """Function ``make(name, progress)`` of a command's units."""
    work = args.work(args, say)

    def make(name, progress):
        work_off(work.folder, [work.units[name]], work.job.tag, progress, say)

    return make


@contextmanager
def animating(folder):
    """Raise a cancellation in the block with a message on the frames that are kept.

    Parameters
    ----------
    folder : path
        Output folder of the animation.

    Raises
    ------
    engine.Cancelled
    """
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        if not failures.cancelled(error):
            raise
        raise engine.Cancelled(
            f"Canceled: finished frames are in {folder}. The same command continues after them."
        ) from error


def work_by(args, work, progress):
    """Make the units of some work, by the requested cluster or by this process.

    Parameters
    ----------
    args : argparse.Namespace
        With `cluster`, `words` and `quiet`.
    work : farm.work.Work
        Names of the units made by a cluster are appended to its `made`.
    progress : console.Progress

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable, engine.Cancelled, farm.errors.FarmFailed, OSError
    """
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
    """A table below the line of progress, redrawn in place in a terminal, and printed now and then elsewhere."""

    def __init__(self, progress, quiet):
        self._progress, self._quiet, self._terminal = progress, quiet, takes_escapes(sys.stderr)
        self._lock = threading.Lock()  # a thread of Dask's makes remarks
        self._table_time, self._line_time = time.monotonic(), -LINE_INTERVAL

    def progress(self, done, message):
        if not self._terminal and time.monotonic() - self._line_time < LINE_INTERVAL:
            return
        self._line_time = time.monotonic()
        with self._lock:
            self._progress(done, message)

    def say(self, text):
        with self._lock:
            self._clear()
            self._progress.say(text)

    def show(self, rows):
        """Show the rows of the table; no rows delete it."""
        if self._quiet:
            return
        with self._lock:
            if not rows:
                self._clear()
            elif time.monotonic() - self._table_time > (
                REDRAW_INTERVAL if self._terminal else TABLE_INTERVAL
            ):
                self._table_time = time.monotonic()
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
