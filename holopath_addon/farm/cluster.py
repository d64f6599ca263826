"""Clusters of Dask: workers on this machine, of a scheduler that runs somewhere, or jobs of SLURM."""

from __future__ import annotations

import logging
import re
import shutil
import subprocess
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ..engine import BackendUnavailable, InvalidInput
from ..engine.scene import variants
from ..workflow import failures
from .errors import FarmFailed

FORMS = "ADDRESS|local:N|slurm[:FILE]"
# Of schedulers that run in this process; others have their own.
CONFIGURATION = {
    # How many workers may die with a unit before it is given up. Nodes that are taken away are no fault of the unit,
    # and `retries` are not for them. A unit that needs more memory than there is must end at some time, though.
    "distributed.scheduler.allowed-failures": 10,
    # A machine that vanishes without a word, for a worker's event loop is never busy: kernels run in its child. As
    # long as it takes for the claims of such a machine to be taken over.
    "distributed.scheduler.worker-ttl": "60s",
    # Units wait for workers as long as it takes: jobs may be queued for hours, and processes here are started again.
    "distributed.scheduler.no-workers-timeout": None,
    # Until one has been timed. Dask's guess of half a second would have eight units wait for a single worker.
    "distributed.scheduler.unknown-task-duration": "5 minutes",
    # Of a thread that waits for its child a hundred samples a second tell nothing.
    "distributed.worker.profile.enabled": False,
    # Schedulers and workers serve pages. Ours have none: their port is on this machine, and says nothing.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
CONNECT = 10.0  # seconds that a scheduler has to answer in
PAGES = {"dashboard_address": "127.0.0.1:0"}  # any free port
_KINDS = {  # of the options of `Slurm`: what they are, and whether a value is such
    "int": ("a whole number from 1 on", lambda value: type(value) is int and value > 0),
    "str": ("text", lambda value: isinstance(value, str)),
    "list[str]": (
        "a list of texts",
        lambda v: isinstance(v, list) and all(isinstance(each, str) for each in v),
    ),
}


@dataclass(frozen=True)
class Slurm:
    """What is asked of SLURM for each worker, see `read`."""

    cores: int = 8
    memory: str = "16GB"
    walltime: str = "01:00:00"
    jobs: int = 16
    queue: str | None = None
    account: str | None = None
    interface: str | None = None
    logs: str | None = None
    lines: list[str] = field(default_factory=list)
    prologue: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path | str) -> Slurm:
        """Of a TOML file.

        Raises
        ------
        engine.InvalidInput
        """
        try:
            entries = tomllib.loads(Path(path).read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise InvalidInput(
                f"The SLURM options {path} cannot be read ({error}): give a TOML file."
            ) from error
        kinds = {each.name: _KINDS[each.type.partition(" ")[0]] for each in fields(cls)}
        for name, value in entries.items():
            if name not in kinds:
                raise InvalidInput(f"{path} has an unknown key '{name}': choose among {', '.join(kinds)}.")
            what, fits = kinds[name]
            if not fits(value):
                raise InvalidInput(f"{name} in {path} is {value!r}: give {what}.")
        slurm = cls(**entries)
        if slurm.seconds < 300:
            raise InvalidInput(
                f"walltime in {path} is {slurm.walltime}: give 5 minutes or more, as 01:00:00."
            )
        return slurm

    @property
    def seconds(self) -> int:
        """Walltime; 0 where it is none of SLURM's forms: MM, MM:SS, HH:MM:SS, D-HH, D-HH:MM, D-HH:MM:SS."""
        found = re.fullmatch(r"(?:(\d+)-)?(\d+)(?::(\d+))?(?::(\d+))?", self.walltime)
        if not found:
            return 0
        days, *rest = found.groups()
        numbers = [int(each) for each in rest if each is not None]
        if days is None and len(numbers) < 3:
            numbers = [0, *numbers]
        hours, minutes, seconds = (*numbers, 0, 0)[:3]
        return ((int(days or 0) * 24 + hours) * 60 + minutes) * 60 + seconds

    @property
    def arguments(self) -> dict[str, Any]:
        """Of `dask_jobqueue.SLURMCluster`."""
        # Workers end by themselves before SLURM ends them, and not all at once: their units then go to others at once.
        margin = max(60, self.seconds // 10)
        return {
            "cores": self.cores,
            "memory": self.memory,
            "processes": 1,
            "walltime": self.walltime,
            "queue": self.queue,
            "account": self.account,
            "interface": self.interface,
            "log_directory": self.logs,
            "job_name": "holopath",
            "job_extra_directives": self.lines,
            "job_script_prologue": self.prologue,
            "worker_extra_args": [
                *("--lifetime", f"{self.seconds - margin}s"),
                *("--lifetime-stagger", f"{margin // 3}s"),
                *("--no-dashboard", "--dashboard-address", PAGES["dashboard_address"]),
            ],
            "scheduler_options": {"dashboard": False, **PAGES},
        }


@dataclass(frozen=True)
class Cluster:
    """What is meant by `FORMS`.

    Attributes
    ----------
    address : str
        Of a scheduler that runs, or none.
    workers : int
        Processes on this machine, or 0.
    slurm : Slurm or None
    """

    address: str = ""
    workers: int = 0
    slurm: Slurm | None = None

    @classmethod
    def parse(cls, text: str) -> Cluster:
        """Raises `engine.InvalidInput`."""
        kind, _, rest = text.partition(":")
        if kind == "local" and rest.isdecimal() and int(rest) > 0:
            return cls(workers=int(rest))
        if text == "slurm":
            return cls(slurm=Slurm())
        if kind == "slurm" and rest:
            return cls(slurm=Slurm.read(rest))
        if re.fullmatch(r"(tcp|tls)://.+:\d+", text):
            return cls(address=text)
        raise InvalidInput(
            f"'{text}' is no cluster: give tcp://HOST:PORT or tls://HOST:PORT of a Dask scheduler, local:N for N "
            "processes on this machine, or slurm:FILE."
        )

    @contextmanager
    def client(self, folder: Path | str) -> Iterator[Any]:
        """A `distributed.Client` of it; what was started for it ends with the block.

        Parameters
        ----------
        folder : path
            That all machines share.

        Raises
        ------
        engine.InvalidInput, engine.BackendUnavailable, FarmFailed
        """
        try:
            import dask
            import distributed
        except ImportError as error:
            raise BackendUnavailable(
                f"--cluster needs Dask ({error}): install it with `pip install distributed`."
            ) from error
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is told as one sentence
        with ExitStack() as stack:
            stack.enter_context(dask.config.set(CONFIGURATION))
            if self.address:
                client = _connected(self.address)
                stack.callback(client.close, timeout=2)
                _check_scheduler(client)
            else:
                started = self._local(stack) if self.workers else self._slurm(stack, folder)
                client = stack.enter_context(distributed.Client(started, set_as_default=False))
            yield client

    def _local(self, stack):
        from distributed import LocalCluster

        cluster = LocalCluster(
            n_workers=self.workers,
            threads_per_worker=max(1, variants.threads() // self.workers),  # the child's; the worker uses one
            host="127.0.0.1",
            dashboard_address=None,
            scheduler_kwargs=PAGES,
            # A worker holds a few numbers. Its child, which needs the memory, is none of Dask's.
            memory_limit=None,
            security=_security(stack, tempfile.gettempdir()),
            silence_logs=logging.CRITICAL,
        )
        return stack.enter_context(cluster)

    def _slurm(self, stack, folder):
        try:
            from dask_jobqueue import SLURMCluster
        except ImportError as error:
            raise BackendUnavailable(
                f"--cluster slurm needs dask-jobqueue ({error}): install it with `pip install dask-jobqueue`."
            ) from error
        if shutil.which("sbatch") is None:
            raise BackendUnavailable(
                "--cluster slurm needs the command sbatch: start it on a machine that submits jobs."
            )
        assert self.slurm is not None
        security = _security(stack, folder)
        if security is None:
            raise BackendUnavailable(
                "Workers of other machines are spoken with by TLS: install openssl, or name certificates in Dask's "
                "configuration (distributed.comm.tls)."
            )
        cluster = stack.enter_context(SLURMCluster(**self.slurm.arguments, security=security))
        cluster.adapt(minimum_jobs=0, maximum_jobs=self.slurm.jobs)
        return cluster


def _connected(address):
    import distributed

    if address.startswith("tls") and not distributed.Security().get_connection_args("client")["ssl_context"]:
        raise InvalidInput(
            f"{address} needs certificates: name them in Dask's configuration (distributed.comm.tls)."
        )
    try:
        return distributed.Client(address, set_as_default=False, timeout=CONNECT)
    except (OSError, TimeoutError, ValueError, RuntimeError) as error:
        raise FarmFailed(
            f"No Dask scheduler answers at {address} ({failures.one_line(error)}): start one with `dask scheduler`, or "
            "see its address, and its certificates if it is tls."
        ) from error


def _security(stack, folder) -> Any:
    """Certificates of Dask's configuration, else new ones for this run only; None where there is no openssl.

    Whoever can speak with a scheduler or a worker can have it run anything, other users of this machine included.
    """
    from distributed.security import Security

    named: Any = Security(require_encryption=True)
    if named.tls_ca_file:
        return named
    if shutil.which("openssl") is None:
        return None
    own = Path(
        stack.enter_context(tempfile.TemporaryDirectory(prefix=".cluster-", dir=Path(folder).absolute()))
    )
    key, certificate = str(own / "key.pem"), str(own / "certificate.pem")
    words = "req -x509 -newkey rsa:2048 -nodes -batch -days 365 -subj /CN=dask-internal -keyout".split()
    subprocess.run(
        ["openssl", *words, key, "-out", certificate],
        check=True,
        stdin=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    names = ("client", "scheduler", "worker")
    keys = {f"tls_{name}_key": key for name in names} | {f"tls_{name}_cert": certificate for name in names}
    return Security(require_encryption=True, tls_ca_file=certificate, **keys)


def _check_scheduler(client):
    """That the scheduler speaks as we do."""
    import distributed

    its = client.get_versions()["scheduler"]["packages"]["distributed"]
    if its != distributed.__version__:
        raise InvalidInput(
            f"The Dask scheduler has distributed {its}, this Python {distributed.__version__}: "
            "install the same everywhere."
        )
