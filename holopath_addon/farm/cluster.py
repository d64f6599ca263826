"""Dask clusters: workers on this machine, of a running scheduler, or as jobs of SLURM."""

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
# Dask's configuration for schedulers in this process; others have their own.
CONFIGURATION = {
    # Number of workers that may die with a unit before it fails. Preempted nodes are not the unit's fault, and do not
    # count as `retries`; but a unit that needs too much memory must fail in the end.
    "distributed.scheduler.allowed-failures": 10,
    # Silence after which a machine counts as lost, the same as for its claims. A worker's event loop is never busy:
    # kernels run in its child.
    "distributed.scheduler.worker-ttl": "60s",
    # Units wait for workers without a limit: jobs may be queued for hours, and local processes are restarted.
    "distributed.scheduler.no-workers-timeout": None,
    # Before the first unit is timed. Dask's default of half a second would queue eight units on a single worker.
    "distributed.scheduler.unknown-task-duration": "5 minutes",
    # A hundred samples a second of a thread that waits for its child are useless.
    "distributed.worker.profile.enabled": False,
    # No web pages: the port of schedulers and workers is local and serves nothing.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
CONNECT_TIMEOUT = 10.0  # seconds
DASHBOARD = {"dashboard_address": "127.0.0.1:0"}  # any free port
_KINDS = {  # of options of `Slurm`: description and check of a value
    "int": ("a whole number from 1 on", lambda value: type(value) is int and value > 0),
    "str": ("text", lambda value: isinstance(value, str)),
    "list[str]": (
        "a list of texts",
        lambda v: isinstance(v, list) and all(isinstance(each, str) for each in v),
    ),
}


@dataclass(frozen=True)
class Slurm:
    """Options of SLURM for each worker, see `read`."""

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
        """Read options from a TOML file.

        Raises
        ------
        engine.InvalidInput
        """
        try:
            entries = tomllib.loads(Path(path).read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise InvalidInput(
                f"The SLURM options {path} cannot be read ({error}). Give a TOML file."
            ) from error
        kinds = {each.name: _KINDS[each.type.partition(" ")[0]] for each in fields(cls)}
        for name, value in entries.items():
            if name not in kinds:
                raise InvalidInput(f"Expected keys among {', '.join(kinds)} in {path}, got '{name}'.")
            description, fits = kinds[name]
            if not fits(value):
                raise InvalidInput(f"Expected {name} in {path} to be {description}, got {value!r}.")
        slurm = cls(**entries)
        if slurm.seconds < 300:
            raise InvalidInput(
                f"walltime in {path} must be at least 5 minutes, such as 01:00:00, got {slurm.walltime}."
            )
        return slurm

    @property
    def seconds(self) -> int:
        """Walltime in seconds; 0 unless it has a form of SLURM: MM, MM:SS, HH:MM:SS, D-HH, D-HH:MM, D-HH:MM:SS."""
        match = re.fullmatch(r"(?:(\d+)-)?(\d+)(?::(\d+))?(?::(\d+))?", self.walltime)
        if not match:
            return 0
        days, *rest = match.groups()
        numbers = [int(each) for each in rest if each is not None]
        if days is None and len(numbers) < 3:
            numbers = [0, *numbers]
        hours, minutes, seconds = (*numbers, 0, 0)[:3]
        return ((int(days or 0) * 24 + hours) * 60 + minutes) * 60 + seconds

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of `dask_jobqueue.SLURMCluster`."""
        # Workers end before SLURM ends them, at different times, so that their units go to others without a delay.
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
                *("--no-dashboard", "--dashboard-address", DASHBOARD["dashboard_address"]),
            ],
            "scheduler_options": {"dashboard": False, **DASHBOARD},
        }


@dataclass(frozen=True)
class Cluster:
    """A cluster of one of `FORMS`.

    Attributes
    ----------
    address : str
        Address of a running scheduler, or empty.
    workers : int
        Number of processes on this machine, or 0.
    slurm : Slurm or None
    """

    address: str = ""
    workers: int = 0
    slurm: Slurm | None = None

    @classmethod
    def parse(cls, text: str) -> Cluster:
        """Parse one of `FORMS`; raises `engine.InvalidInput`."""
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
            "Expected a cluster tcp://HOST:PORT or tls://HOST:PORT of a Dask scheduler, local:N for N processes on "
            f"this machine, or slurm:FILE, got '{text}'."
        )

    @contextmanager
    def client(self, folder: Path | str) -> Iterator[Any]:
        """A `distributed.Client` of the cluster; schedulers and workers started for it end with the block.

        Parameters
        ----------
        folder : path
            A folder that all machines share.

        Raises
        ------
        engine.InvalidInput, engine.BackendUnavailable, FarmFailed
        """
        try:
            import dask
            import distributed
        except ImportError as error:
            raise BackendUnavailable(
                f"--cluster needs Dask ({error}). Run `pip install distributed`."
            ) from error
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # errors are raised as one message
        with ExitStack() as stack:
            stack.enter_context(dask.config.set(CONFIGURATION))
            if self.address:
                client = _connect(self.address)
                stack.callback(client.close, timeout=2)
                _check_scheduler(client)
            else:
                cluster = self._local(stack) if self.workers else self._slurm(stack, folder)
                client = stack.enter_context(distributed.Client(cluster, set_as_default=False))
            yield client

    def _local(self, stack):
        from distributed import LocalCluster

        cluster = LocalCluster(
            n_workers=self.workers,
            threads_per_worker=max(1, variants.threads() // self.workers),  # the child's; the worker uses one
            host="127.0.0.1",
            dashboard_address=None,
            scheduler_kwargs=DASHBOARD,
            # A worker holds a few numbers. Dask does not see its child, which needs the memory.
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
                f"--cluster slurm needs dask-jobqueue ({error}). Run `pip install dask-jobqueue`."
            ) from error
        if shutil.which("sbatch") is None:
            raise BackendUnavailable(
                "--cluster slurm needs the command sbatch. Start it on a machine that submits jobs."
            )
        assert self.slurm is not None
        security = _security(stack, folder)
        if security is None:
            raise BackendUnavailable(
                "Workers of other machines need TLS. Install openssl, or name certificates in Dask's configuration "
                "(distributed.comm.tls)."
            )
        cluster = stack.enter_context(SLURMCluster(**self.slurm.arguments, security=security))
        cluster.adapt(minimum_jobs=0, maximum_jobs=self.slurm.jobs)
        return cluster


def _connect(address):
    import distributed

    if address.startswith("tls") and not distributed.Security().get_connection_args("client")["ssl_context"]:
        raise InvalidInput(
            f"{address} needs certificates. Name them in Dask's configuration (distributed.comm.tls)."
        )
    try:
        return distributed.Client(address, set_as_default=False, timeout=CONNECT_TIMEOUT)
    except (OSError, TimeoutError, ValueError, RuntimeError) as error:
        raise FarmFailed(
            f"No Dask scheduler answers at {address} ({failures.one_line(error)}). Start one by `dask scheduler`, or "
            "check its address, and its certificates if it is tls."
        ) from error


def _security(stack, folder) -> Any:
    """Certificates of Dask's configuration, or new ones for this run; None without openssl.

    Anyone who can connect to a scheduler or a worker can run any code there, other users of this machine included.
    """
    from distributed.security import Security

    security: Any = Security(require_encryption=True)
    if security.tls_ca_file:
        return security
    if shutil.which("openssl") is None:
        return None
    temporary = Path(
        stack.enter_context(tempfile.TemporaryDirectory(prefix=".cluster-", dir=Path(folder).absolute()))
    )
    key, certificate = str(temporary / "key.pem"), str(temporary / "certificate.pem")
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
    """Check that the scheduler has this Python's version of distributed."""
    import distributed

    its = client.get_versions()["scheduler"]["packages"]["distributed"]
    if its != distributed.__version__:
        raise InvalidInput(
            f"The Dask scheduler has distributed {its}, this Python {distributed.__version__}. "
            "Install the same everywhere."
        )
