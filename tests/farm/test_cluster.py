"""Units made by Dask's workers: real clusters of real processes, which are killed, too."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from holopath_addon import cli
from holopath_addon.engine import BackendUnavailable, InvalidInput
from holopath_addon.farm import cluster, errors, executor
from holopath_addon.farm import worker as worker_module
from tests.farm import toy
from tests.patience import NEVER, SOON

psutil = pytest.importorskip("psutil")
distributed = pytest.importorskip("distributed")

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def children_find_the_toy(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))


@pytest.fixture(autouse=True)
def nothing_runs_on():
    yield
    end = time.monotonic() + SOON
    while left := [
        p for p in psutil.Process().children(recursive=True) if "tracker" not in " ".join(p.cmdline())
    ]:
        assert time.monotonic() < end, left
        time.sleep(0.05)


class Request:
    """Toy units of a folder, and what was said of them."""

    def __init__(self, folder, seconds, *names):
        self.folder, self.words, self.described, self.shown, self.done = (
            folder,
            [str(folder), str(seconds), *names],
            [],
            [],
            [],
        )
        self.units = toy.units(self.words)[1]
        self.look = lambda: None  # called again and again

    def by(self, client, private=False):
        def progress(done, message):
            self.done.append((done, message))
            self.look()

        hands = executor.ClusterExecutor(
            client, private, self.words, progress, self.described.append, self.shown.append, "tests.farm.toy"
        )
        return len(hands.work_off(self.folder, self.units, toy.TAG))

    def on(self, text):
        with cluster.Cluster.parse(text).client(self.folder) as client:
            return self.by(client, text.startswith("local"))

    def pids(self):
        return {
            path.name: int((path / "pid").read_text())
            for path in self.folder.glob("*/")
            if path.name[0] != "."
        }


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def listening(process):
    return [each.laddr for each in process.net_connections(kind="inet") if each.status == "LISTEN"]


def dask_workers():
    """Processes of Dask's workers below this one, and their children."""
    found = [p for p in psutil.Process().children() if "spawn_main" in " ".join(p.cmdline())]
    return {process: process.children() for process in found}


@contextmanager
def started(*words, path=""):
    """A process of Dask's command line."""
    process = subprocess.Popen(
        [sys.executable, "-m", *map(str, words)],
        env={**os.environ, "PYTHONPATH": f"{path}{os.pathsep}{ROOT}"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(NEVER)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@contextmanager
def scheduler(tmp_path):
    """A scheduler in a process of its own, and its address."""
    file = tmp_path / "scheduler.json"
    words = ("--host", "127.0.0.1", "--port", 0, "--no-dashboard", "--dashboard-address", "127.0.0.1:0")
    with started("distributed.cli.dask_scheduler", *words, "--scheduler-file", file) as process:
        end = time.monotonic() + SOON
        while not (file.exists() and file.read_text()):
            assert time.monotonic() < end
            time.sleep(0.05)
        yield json.loads(file.read_text())["address"], process


def worker(address, path=""):
    words = (
        "--nthreads",
        3,
        "--no-dashboard",
        "--dashboard-address",
        "127.0.0.1:0",
        "--death-timeout",
        int(NEVER),
    )
    return started("distributed.cli.dask_worker", address, *words, path=path)


def test_units_are_made_in_order_by_children_that_stay(tmp_path, monkeypatch):
    monkeypatch.setenv("HOLOPATH_THREADS", "4")
    request = Request(tmp_path, 0.2, "a", "b", "c<b", "d<c", "e")
    (tmp_path / "e").mkdir()
    ports = []
    request.look = lambda: ports.extend(
        address for process in [psutil.Process(), *dask_workers()] for address in listening(process)
    )
    assert request.on("local:2") == 4
    assert names(tmp_path) == ["a", "b", "c", "d", "e"]
    assert {address.ip for address in ports} == {"127.0.0.1"}
    (tmp_path / "e").rmdir()
    assert len(set(request.pids().values())) == 2
    assert {(tmp_path / name / "threads").read_text() for name in "abcd"} == {"2"}
    assert any("Sleeping" in line for lines in request.shown for line in lines)
    assert request.done[-1][0] > 0.9 and any("left" in message for _, message in request.done)


def test_all_open_the_job_while_one_makes_what_they_need(tmp_path):
    out, opened, early = tmp_path / "out", tmp_path / "out.opened", []
    out.mkdir()
    opened.mkdir()
    request = Request(out, 1.5, "a", "b<a")
    request.look = lambda: early.append(len(list(opened.iterdir())) == 2 and not (out / "a").exists())
    assert request.on("local:2") == 2
    assert any(early)


@pytest.mark.slow  # what one unit lacks of five is made above
def test_what_is_done_is_not_made_again(tmp_path):
    request = Request(tmp_path, 0, "a", "b")
    for name in "ab":
        (tmp_path / name).mkdir()
    assert request.on("local:1") == 0


def test_a_child_that_crashes_is_replaced(tmp_path):
    request = Request(tmp_path, 0, "crash", "b")
    assert request.on("local:1") == 2
    assert names(tmp_path) == ["b", "crash", "crash.crashed"]


def test_the_first_refusal_ends_it_all(tmp_path):
    request = Request(tmp_path, NEVER, "a", "bad1")
    begun = time.monotonic()
    with pytest.raises(InvalidInput, match=r"^bad1 cannot be made\.$"):
        request.on("local:2")
    assert time.monotonic() - begun < SOON
    assert names(tmp_path) == []


def test_cancelled_nothing_half_done_stays(tmp_path):
    request = Request(tmp_path, 1, "a", "b", "c", "d")

    def interrupt():
        if (tmp_path / "a").exists() and any(tmp_path.glob(".[cd].part-*")):
            raise KeyboardInterrupt

    request.look = interrupt
    with pytest.raises(KeyboardInterrupt):
        request.on("local:2")
    assert "a" in names(tmp_path) and not [name for name in names(tmp_path) if name.startswith(".")]


@pytest.mark.slow
def test_a_worker_killed_three_times(tmp_path):
    request, killed = Request(tmp_path, 1, "a", "b", "c"), []

    def kill():
        for process, children in dask_workers().items():
            if len(killed) < 3 and children and any(tmp_path.glob(".*.part-*")):
                process.send_signal(signal.SIGKILL)
                killed.append(children[0])
                end = time.monotonic() + SOON
                while children[0].is_running() and children[0].status() != psutil.STATUS_ZOMBIE:
                    assert time.monotonic() < end
                    time.sleep(0.02)
                return

    request.look = kill
    assert request.on("local:2") == 3
    assert len(killed) == 3
    assert names(tmp_path) == ["a", "b", "c"]


@pytest.mark.slow
def test_a_unit_that_another_process_makes_is_waited_for(tmp_path):
    request = Request(tmp_path, 5, "a")
    plain = threading.Thread(target=toy.open_job(request.words, print), args=("a", lambda *_: None))
    plain.start()
    assert request.on("local:1") == 1
    plain.join()
    assert request.pids() == {"a": os.getpid()}
    assert any("Waiting for a" in row for rows in request.shown for row in rows)


@pytest.mark.slow
def test_workers_may_come_late(tmp_path):
    results = tmp_path / "results"
    results.mkdir()
    request = Request(results, 1, *"abcdefgh")
    with scheduler(tmp_path) as (address, _):
        made = []
        thread = threading.Thread(target=lambda: made.append(request.on(address)))
        thread.start()
        while not request.done:
            time.sleep(0.05)
        assert "waiting for workers" in request.done[-1][1]
        with worker(address):
            while not names(results)[1:]:
                time.sleep(0.05)
            with worker(address):
                thread.join()
    assert made == [8]
    assert names(results) == list("abcdefgh")
    assert len(set(request.pids().values())) == 2
    assert (results / "a" / "threads").read_text() == "3"


@pytest.mark.slow
def test_the_scheduler_dies_and_the_same_goes_on(tmp_path):
    results = tmp_path / "results"
    results.mkdir()
    request = Request(results, 1, *"abcd")
    with scheduler(tmp_path) as (address, process), worker(address):

        def kill():
            if (results / "a").exists():
                process.kill()

        request.look = kill
        with pytest.raises(errors.FarmFailed, match="^The Dask scheduler is gone. Finished units are in"):
            request.on(address)
    (tmp_path / "scheduler.json").unlink()
    request.look, before = (lambda: None), set(names(results)) - {".claims"}
    assert "a" in before
    with scheduler(tmp_path) as (address, _), worker(address):
        assert request.on(address) == len([name for name in "abcd" if name not in before])
    assert names(results) == list("abcd")


@pytest.mark.slow
def test_a_worker_of_another_version_is_not_used(tmp_path):
    results, other = tmp_path / "results", tmp_path / "site"
    results.mkdir()
    (other / "scipy-0.0.1.dist-info").mkdir(parents=True)
    (other / "scipy-0.0.1.dist-info" / "METADATA").write_text("Name: scipy\nVersion: 0.0.1\n")
    request = Request(results, 0.1, "a", "b", "c")
    with scheduler(tmp_path) as (address, _), worker(address, other):
        with pytest.raises(InvalidInput, match=r"No worker .* scipy 0\.0\.1 there, .* here"):
            request.on(address)
        assert names(results) == []
        with worker(address):
            end = time.monotonic() + SOON
            with distributed.Client(address, set_as_default=False) as client:
                client.wait_for_workers(2, timeout=NEVER)
            request.described.clear()
            assert request.on(address) == 3
            assert time.monotonic() < end
    assert len(request.described) == 1 and "is not used, for scipy 0.0.1 there" in request.described[0]
    assert len(set(request.pids().values())) == 1


def test_no_scheduler_no_dask_no_cluster(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.5)
    with pytest.raises(
        errors.FarmFailed, match=r"No Dask scheduler answers at tcp://127.0.0.1:1 .*dask scheduler"
    ):
        Request(tmp_path, 0, "a").on("tcp://127.0.0.1:1")
    with pytest.raises(InvalidInput, match="tls://127.0.0.1:1 needs certificates"):
        Request(tmp_path, 0, "a").on("tls://127.0.0.1:1")
    for text in ("", "local", "local:0", "local:two", "slurm:", "127.0.0.1:8786", "http://a:1"):
        with pytest.raises(InvalidInput, match="Expected a cluster tcp://HOST:PORT"):
            cluster.Cluster.parse(text)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BackendUnavailable, match="pip install distributed"):
        Request(tmp_path, 0, "a").on("local:1")
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("color = 1", "Expected keys among cores, memory, walltime, jobs, queue, account, interface, logs"),
        ("cores = true", "to be a whole number from 1 on, got True"),
        ("jobs = 0", "to be a whole number from 1 on, got 0"),
        ("queue = 3", "to be text, got 3"),
        ("lines = 'a'", "to be a list of texts, got"),
        ("walltime = 'soon'", "must be at least 5 minutes, such as 01:00:00, got soon"),
        ("walltime = '00:04:00'", "must be at least 5 minutes, such as 01:00:00, got 00:04:00"),
        ("cores = ", "cannot be read"),
    ],
)
def test_slurm_options_are_checked(text, says, tmp_path):
    (tmp_path / "slurm.toml").write_text(text)
    with pytest.raises(InvalidInput, match=says):
        cluster.Cluster.parse(f"slurm:{tmp_path / 'slurm.toml'}")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("30", 1800),
        ("10:30", 630),
        ("01:00:00", 3600),
        ("1-0", 86400),
        ("1-02:30", 95400),
        ("0-01:02:03", 3723),
    ],
)
def test_walltimes(text, seconds):
    assert cluster.Slurm(walltime=text).seconds == seconds


WORDS = ["--resolution", "32x32", "--frames", "1", "--wavelengths", "516.5", "--quality", "preview"]


def render(out, *words, **options):
    """An animation of the demo on the command line, in a process group of its own."""
    words = ["render", "demo:planes", *WORDS, "--out", out, *words]
    return subprocess.Popen(
        [sys.executable, "-m", "holopath_addon", *map(str, words)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )


def fields(folder):
    return {path.parts[-3]: path.read_bytes() for path in sorted(folder.glob("frame_*/wavefield/field.npy"))}


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """Frames 1 to 6 of one process."""
    pytest.importorskip("bpy")
    out = tmp_path_factory.mktemp("alone") / "out"
    process = render(out, "--frame-range", "1-6")
    assert process.wait() == 0, process.stderr.read()
    return fields(out)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_an_animation_is_the_same_by_however_many(count, alone, tmp_path):
    out = tmp_path / "out"
    process = render(out, "--frame-range", "1-6", "--cluster", f"local:{count}")
    output, error = process.communicate()
    assert process.returncode == 0, error
    assert output == "" and "Done: 6 frames" in error
    assert fields(out) == alone and len(alone) == 6
    assert names(out) == [*alone, "job.json", "light"] and names(tmp_path) == ["out"]
    process = render(out, "--frame-range", "1-6", "--cluster", f"local:{count}")
    assert "Done: 0 frames" in process.communicate()[1]


@pytest.mark.slow
def test_an_animation_whose_workers_are_killed_is_the_same(alone, tmp_path):
    out, killed = tmp_path / "out", 0
    process = render(out, "--frame-range", "1-6", "--cluster", "local:2")
    while process.poll() is None:
        time.sleep(0.05)
        if killed < 3 and len(list(out.glob("frame_*"))) >= killed and any(out.glob(".frame_*.part-*")):
            workers = [p for p in psutil.Process(process.pid).children() if p.children()]
            if workers:
                workers[0].kill()
                killed += 1
    assert process.returncode == 0, process.stderr.read()
    assert killed == 3
    assert fields(out) == alone and names(out) == [*alone, "job.json", "light"]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_who_interrupts_it_keeps_what_is_done(number, alone, tmp_path):
    out = tmp_path / "out"
    process = render(out, "--frame-range", "1-6", "--resolution", "128x128", "--cluster", "local:2")
    while not any(out.glob("frame_*")):
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)
    os.killpg(process.pid, number)  # as a terminal does
    _, error = process.communicate(timeout=NEVER)
    assert process.returncode == 1
    lines = [line for line in error.splitlines() if line.startswith("holopath: ")]
    assert lines == [
        f"holopath: Canceled: finished frames are in {out}. The same command continues after them."
    ]
    assert "Traceback" not in error
    assert all(name.startswith("frame_") or name in ("job.json", "light") for name in names(out)), names(out)
    assert not [p for p in psutil.process_iter(["cmdline"]) if str(out) in " ".join(p.info["cmdline"] or ())]


@pytest.mark.slow
def test_plain_processes_help_a_cluster(alone, tmp_path):
    out = tmp_path / "out"
    both = [render(out, "--frame-range", "1-6", *more) for more in (("--cluster", "local:1"), ())]
    messages = [process.communicate()[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], messages
    assert fields(out) == alone and names(out) == [*alone, "job.json", "light"]


@pytest.mark.slow
def test_phases_of_an_animation(tmp_path):
    pytest.importorskip("bpy")
    phases = []
    for name, more in (("one", ()), ("two", ("--cluster", "local:2"))):
        process = render(tmp_path / name, "--frame-range", "1-3")
        assert process.wait() == 0, process.stderr.read()
        words = ["encode", tmp_path / name, "--method", "sgd", "--max-steps", "5", *more]
        for count in (3, 0):
            done = subprocess.run(
                [sys.executable, "-m", "holopath_addon", *map(str, words)],
                cwd=ROOT,
                capture_output=True,
                text=True,
            )
            assert done.returncode == 0 and f"Done: {count} frames" in done.stderr, done.stderr
        phases.append({p.parts[-3]: p.read_bytes() for p in (tmp_path / name).glob("*/hologram/phase.npy")})
    assert phases[0] == phases[1] and len(phases[0]) == 3


@pytest.mark.slow
@pytest.mark.parametrize("phase", ["Exporting", "Planning", "Wave tracing"])
def test_a_child_ends_with_its_parent_in_the_middle_of_a_kernel(phase, tmp_path):
    pytest.importorskip("bpy")
    mark = tmp_path / "a" / "mark"
    mark.parent.mkdir()
    mark.touch()
    words = ["render", "demo:suzanne", "--resolution", "1024x1024", "--frames", "8", "--frame-range", "1"]
    words += ["--method", "full"]  # without a light that has to be there before
    task = {"words": [*words, "--out", str(tmp_path / "out")], "folder": str(ROOT), "unit": "frame_0001"}
    process = subprocess.Popen(
        [sys.executable, "-m", "holopath_addon", "worker"],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    process.stdin.write(json.dumps({**task, "mark": str(mark)}) + "\n")
    process.stdin.flush()
    for line in process.stdout:
        assert "failure" not in line and "done" not in line
        if phase in line:
            break
    time.sleep(0.5)
    process.stdin.close()
    process.wait(NEVER)
    assert not list((tmp_path / "out").glob("*/wavefield"))  # it did not go on to its end


def test_a_folder_that_a_machine_does_not_see(tmp_path, monkeypatch):
    monkeypatch.setattr(worker_module, "VISIBLE_TIMEOUT", 0.2)
    with pytest.raises(InvalidInput, match="does not see the results in"):
        worker_module._check_shared(str(tmp_path / "results" / ".claims" / "mark"), lambda *_: None)


def test_a_still_is_made_by_one_process(tmp_path, capsys):
    assert cli.main(["render", "demo:planes", "--out", str(tmp_path / "a"), "--cluster", "local:2"]) == 2
    assert "One process renders a still. Add --animation" in capsys.readouterr().err
    assert cli.main(["render", "demo:planes", "--out", str(tmp_path / "a"), "--cluster", "local:"]) == 2
    assert "Expected a cluster" in capsys.readouterr().err
    assert cli.main(["encode", str(tmp_path), "--cluster", "local:2"]) == 2
    assert "Expected an animation in" in capsys.readouterr().err
    assert names(tmp_path) == []
