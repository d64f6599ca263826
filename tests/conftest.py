"""Fixtures for all tests.

Blender's user folders are set before anything imports bpy: an installed copy of the extension would otherwise
shadow the working tree. Baked light stays in a folder of the tests, and so do Dr.Jit's programs, from run to run.
What Python compiles stays, too, also where the environment forbids it: else each worker would compile all modules in
6 s, and each process that a test starts its own in 0.4 s. Workers that run side by side share the processors.
"""

import atexit
import ctypes
import datetime
import gc
import itertools
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import hypothesis
import pytest

from tests.turns import in_turn

_user = tempfile.mkdtemp(prefix="holopath-tests-")
atexit.register(shutil.rmtree, _user, ignore_errors=True)
atexit.register(gc.unfreeze)  # else lief would tell at the end what it takes for leaks
os.environ["BLENDER_USER_RESOURCES"] = _user
os.environ["BLENDER_USER_EXTENSIONS"] = os.path.join(_user, "extensions")
os.environ["HOLOPATH_CACHE"] = os.path.join(_user, "cache")
os.environ["DRJIT_CACHE_DIR"] = str(Path(__file__).parents[1] / ".pytest_cache" / "programs")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

_workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 1))
for _name in ("HOLOPATH_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS") if _workers > 1 else ():
    os.environ.setdefault(_name, str(max(1, (os.cpu_count() or 1) // _workers)))

hypothesis.settings.register_profile("any machine", deadline=None)  # none is too slow for an example
hypothesis.settings.load_profile("any machine")

_started = time.monotonic()


def pytest_xdist_auto_num_workers(config):
    """One more than processors: some tests wait for devices, windows and processes."""
    return (os.cpu_count() or 1) + 1


def pytest_addoption(parser):
    parser.addoption(
        "--minutes", type=float, help="begin no test after this time; another day begins elsewhere"
    )


def pytest_collection_modifyitems(config, items):
    """Where not all can be run, begin with other tests every day."""
    if config.getoption("--minutes"):
        items[:] = in_turn(items, datetime.date.today().toordinal())


def pytest_configure(config):
    """Where a graphics card is asked for and there is none, nothing is tried: tests would fail one by one."""
    if os.environ.get("HOLOPATH_BACKEND") != "cuda_ad_rgb" or config.option.collectonly:
        return
    from holopath_addon.engine.scene import variants

    card = next(row for row in variants.describe() if row["name"] == variants.CUDA)
    if not card["available"]:
        reason = f"{variants.CUDA} cannot be used: {card['detail']}; unset HOLOPATH_BACKEND, or use another machine."
        pytest.exit(reason, returncode=2)


def pytest_collection_finish(session):
    """Dr.Jit loads an LLVM once for all, where it is first imported: the first test that computes chooses it."""
    if "drjit" in sys.modules:
        raise pytest.UsageError(
            "A module of tests imports Dr.Jit at its top, before an LLVM is chosen: import within functions what does."
        )


def pytest_runtest_setup(item):
    minutes = item.config.getoption("--minutes")
    if minutes and time.monotonic() - _started > 60 * minutes:
        pytest.skip("no time was left")


@pytest.fixture(scope="session")
def compiled_in_half_the_time():
    """LLVM leaves out its optimizer in this process: programs that run for milliseconds do not repay it.

    Of 18 s of tests with mirrors and glass, 8 s were its compiling; without it they take 12 s. Their numbers differ by
    roundings. Programs that tests start as processes are compiled as users have them. A libLLVM that does not know the
    words ignores them.
    """
    from holopath_addon.engine import BackendUnavailable
    from holopath_addon.engine.scene import variants

    try:
        llvm = ctypes.CDLL(variants.find_llvm()[0])
    except BackendUnavailable:
        return
    words = (ctypes.c_char_p * 3)(b"pytest", b"-force-attribute=optnone", b"-force-attribute=noinline")
    llvm.LLVMParseCommandLineOptions(len(words), words, None)


_modules = itertools.count()


@pytest.fixture(scope="module", autouse=True)
def no_scenes_of_earlier_modules(compiled_in_half_the_time):
    """What modules and their fixtures held is searched for what is not used any more, now and then: it takes 0.2 s."""
    if next(_modules) % 8 == 0:
        gc.unfreeze()
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def no_scenes_of_earlier_tests(no_scenes_of_earlier_modules):
    """Dr.Jit's programs hold the numbers of a scene's objects: beside other scenes each would be compiled anew.

    What was there before stays, and is not searched again and again: that took an eighth of all tests' time.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def backend():
    """Name of the Mitsuba variant, activated for the whole session."""
    from holopath_addon.engine.scene import variants

    return variants.activate()


@pytest.fixture(scope="module")
def one_thread():
    """Dr.Jit computes with the caller's thread alone.

    Its other one waits busily for 5 ms after each launch: of the exporter's tests, with short programs, a sixth.
    Mitsuba would wait for it in vain where it reads or writes OpenEXR files: not for tests that do.
    """
    from holopath_addon.engine.scene import variants
    from holopath_addon.workflow import output

    limit = variants._limit_threads

    def alone():
        import drjit

        if drjit.thread_count() != 1:
            drjit.set_thread_count(1)

    def refused(*_):
        pytest.fail("Mitsuba writes OpenEXR files with a second thread: move this test out of this folder.")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(variants, "_limit_threads", alone)
        patch.setattr(output, "encode_exr", refused)
        if "drjit" in sys.modules:
            alone()
        yield
    if "drjit" in sys.modules:
        limit()


@pytest.fixture
def empty_scene():
    """The scene of a new Blender file with nothing in it."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    return bpy.context.scene
