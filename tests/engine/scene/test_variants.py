"""The choice of a Mitsuba variant and of an LLVM that does not crash it.

What is loaded stays in a process, so every choice is tried in one of its own.
"""

import os
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.scene import variants as module
from tests.patience import NEVER

ROOT = Path(__file__).parents[3]

ACTIVATE = """
from holopath_addon.engine import BackendUnavailable
from holopath_addon.engine.scene import variants
try:
    print("variant", variants.activate())
except BackendUnavailable as error:
    print("refused", error)
"""
ACTIVATE_LLVM = ACTIVATE.replace("activate()", "activate('llvm_ad_rgb')")
COMPUTE = """
import drjit, mitsuba
print("sum", drjit.sum(drjit.minimum(mitsuba.Float([1, 2, 3]), 2))[0])
"""


def run(code, **environment):
    variables = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"} | environment
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=variables,
        capture_output=True,
        text=True,
        timeout=NEVER,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def library(tmp_path, version, name="libLLVM.so.{0}.1"):
    """A shared library that reports itself as LLVM of this version (None: an LLVM from before it could)."""
    compiler = shutil.which("cc")
    if compiler is None or os.name != "posix":
        pytest.skip("needs a C compiler")
    source = tmp_path / "llvm.c"
    body = f"{{ *a = {version}; *b = 1; *c = 7; }}"
    function = f"void LLVMGetVersion(unsigned *a, unsigned *b, unsigned *c) {body}"
    source.write_text("int old;" if version is None else function)
    path = tmp_path / name.format(version)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", path, source], check=True)
    return path


def test_activates_and_computes():
    """The best variant that there is; the one that the caller has chosen since is kept."""
    first, *others, computed = run(ACTIVATE + ACTIVATE_LLVM + ACTIVATE + COMPUTE).splitlines()
    assert first in ("variant llvm_ad_rgb", "variant cuda_ad_rgb")
    assert others == ["variant llvm_ad_rgb"] * 2
    assert computed == "sum 5.0"


def test_as_many_threads_as_wished(monkeypatch):
    tell = "import drjit\nprint(variants.threads(), drjit.thread_count())"
    assert run(ACTIVATE_LLVM + tell, HOLOPATH_THREADS="3").splitlines()[1] == "3 3"
    monkeypatch.setenv("HOLOPATH_THREADS", "1")
    assert module.threads() == 1  # of Dr.Jit's one at least is another than the caller's: below


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system binds no process to processors")
def test_as_many_threads_as_the_process_has_processors():
    """A batch system's share of the machine."""
    bind = "import os\nos.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
    tell = "import drjit\nprint(variants.threads(), drjit.thread_count())"
    assert run(bind + ACTIVATE_LLVM + tell, HOLOPATH_THREADS="").splitlines()[1] == "1 2"


@pytest.mark.parametrize("wish", ["0", "-2", "many", "1.5"])
def test_no_such_number_of_threads(monkeypatch, wish):
    monkeypatch.setenv("HOLOPATH_THREADS", wish)
    with pytest.raises(engine.InvalidInput, match="HOLOPATH_THREADS"):
        module.threads()


def test_activate_is_idempotent_and_works_in_a_thread(backend):
    seen = []
    thread = threading.Thread(target=lambda: seen.append(module.activate()))
    thread.start()
    thread.join()
    assert seen == [backend] == [module.activate()]


DRIVER = {
    "cuDeviceGetCount": "*(int *)a = 1;",
    "cuDriverGetVersion": "*(int *)a = 12080;",
    "cuDeviceGetAttribute": "*(int *)a = (long)b == 75 ? 8 : 6;",
    "cuDeviceGetName": 'strcpy(a, "Card");',
    "cuGetErrorName": 'if ((long)a == 46) *(char **)b = "CUDA_ERROR_DEVICE_UNAVAILABLE";',
}
CANNOT_OPEN = {
    "full": ({"cuDevicePrimaryCtxRetain": "return 2;"}, "Card cannot be opened (its memory is full)"),
    "nearly full": (
        {"cuMemGetInfo_v2": "*(size_t *)a = 1 << 20;"},
        "Card cannot be opened (its memory is full)",
    ),
    "in use": (
        {"cuDevicePrimaryCtxRetain": "return 46;"},
        "Card cannot be opened (CUDA_ERROR_DEVICE_UNAVAILABLE)",
    ),
}


@pytest.fixture(scope="module")
def fake_driver(tmp_path_factory):
    """Make an NVIDIA driver, as a folder of libraries with the functions that Dr.Jit and HoloPath call."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        pytest.skip("needs a C compiler, and Linux")
    import drjit

    core = (Path(drjit.__file__).parent / "libdrjit-core.so").read_bytes()
    names = {name.decode() for name in re.findall(rb"\0(cu[A-Z]\w+)(?=\0)", core)} | {"cuMemGetInfo_v2"}

    def make(bodies):
        folder = tmp_path_factory.mktemp("driver")
        bodies = DRIVER | bodies
        source = folder / "driver.c"
        source.write_text(
            "#include <string.h>\n"
            + "".join(
                f"int {n}(void *a, void *b, void *c) {{ {bodies.get(n, '')} return 0; }}\n"
                for n in sorted(names)
            )
        )
        for name in ("libcuda.so", "libcuda.so.1", "libnvoptix.so.1"):
            subprocess.run([compiler, "-w", "-shared", "-fPIC", "-o", folder / name, source], check=True)
        return folder

    return make


@pytest.mark.parametrize("case", CANNOT_OPEN)
def test_a_card_that_cannot_be_opened_does_not_end_the_process(fake_driver, case):
    """Dr.Jit opens every card at its import, and aborts if it cannot, with the processor chosen as well."""
    bodies, reason = CANNOT_OPEN[case]
    folder = str(fake_driver(bodies))
    if case != "nearly full":  # else Dr.Jit goes on, with an empty driver
        with pytest.raises(AssertionError, match="unrecoverable error"):
            run("import drjit", LD_LIBRARY_PATH=folder)
    out = run(ACTIVATE_LLVM + COMPUTE, LD_LIBRARY_PATH=folder)
    assert out.splitlines() == ["variant llvm_ad_rgb", "sum 5.0"]
    code = (
        ACTIVATE.replace("activate()", "activate('cuda_ad_rgb')") + "print(variants.describe()[0]['detail'])"
    )
    refused, detail = run(code, LD_LIBRARY_PATH=folder).splitlines()
    assert refused == f"refused cuda_ad_rgb cannot be used: {detail}; or choose llvm_ad_rgb."
    assert detail.startswith(reason)
    described = "from holopath_addon.engine.scene import variants\nprint(variants.describe()[0]['detail'])"
    assert run(described, LD_LIBRARY_PATH=folder) == detail
    assert run(ACTIVATE, LD_LIBRARY_PATH=folder) == "variant llvm_ad_rgb"


def test_replaces_a_variant_that_cannot_be_differentiated():
    """Where Dr.Jit, imported by others, has found an LLVM that is new enough."""
    found = {"DRJIT_LIBLLVM_PATH": module.find_llvm()[0]}
    assert "_ad_rgb" in run("import mitsuba\nmitsuba.set_variant('scalar_rgb')\n" + ACTIVATE, **found)


def test_plugins_are_of_the_variant_that_is_set():
    """As where another backend is chosen in the preferences: Mitsuba refuses classes of another variant's."""
    code = (
        "from holopath_addon.engine.scene import variants\n"
        "mitsuba = variants.bitmaps()\n"
        "for variants.LLVM in ('llvm_ad_rgb', 'llvm_ad_mono', 'llvm_ad_rgb'):\n"
        "    variants.activate(variants.LLVM)\n"
        "    coat = {'type': 'mixture', 'mode': 'over', 'a': {'type': 'matt'}, 'b': {'type': 'gloss'}}\n"
        "    scene = {'type': 'scene', 'ball': {'type': 'sphere', 'bsdf': coat}, 'sun': LAMP}\n"
        "    scene = mitsuba.load_dict(scene)\n"
        "    print(isinstance(scene.shapes()[0].bsdf(), mitsuba.BSDF), len(scene.emitters()))\n"
    )
    lamp = "{'type': 'sun_lamp', 'to_world': mitsuba.ScalarTransform4f(), 'irradiance': [1, 1, 1]}"
    assert run(code.replace("LAMP", lamp)).split() == 3 * ["True", "1"]


def test_unknown_preference():
    with pytest.raises(engine.InvalidInput, match="scalar_rgb"):
        module.activate("scalar_rgb")


def test_describe_names_both_backends():
    rows = module.describe()
    assert [row["name"] for row in rows] == ["cuda_ad_rgb", "llvm_ad_rgb"]
    assert any(row["available"] for row in rows)
    assert all(isinstance(row["available"], bool) and row["detail"] for row in rows)


@pytest.fixture
def sentence_of(monkeypatch):
    """Why an LLVM is refused."""

    def sentence_of(path):
        monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(path))
        with pytest.raises(engine.BackendUnavailable) as refused:
            module.find_llvm()
        return str(refused.value)

    return sentence_of


@pytest.mark.parametrize("version", [14, 16, 18])
def test_refuses_an_old_llvm_by_its_name(tmp_path, sentence_of, version):
    path = tmp_path / f"libLLVM-{version}.so.1"
    path.write_bytes(b"never loaded")
    told = sentence_of(path)
    assert f"is LLVM {version}" in told and "install LLVM 19" in told and "\n" not in told


def test_refuses_an_old_llvm_that_hides_its_version(tmp_path, sentence_of):
    assert "is LLVM 18.1.7" in sentence_of(library(tmp_path, 18, name="libLLVM.so"))
    assert "is older than LLVM 16" in sentence_of(library(tmp_path, None, name="libLLVM-C.so"))


def test_refuses_a_missing_llvm(tmp_path, sentence_of):
    """Nor is it activated."""
    path = tmp_path / "libLLVM.so.99"
    told = sentence_of(path)
    assert told.startswith("DRJIT_LIBLLVM_PATH names") and "cannot be loaded" in told and "\n" not in told
    assert run(ACTIVATE_LLVM, DRJIT_LIBLLVM_PATH=str(path)) == f"refused {told}"


def test_takes_the_newest_and_says_what_is_too_old(tmp_path, monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(module, "_own_folders", lambda: [])
    monkeypatch.setattr(module, "_system_folders", lambda: [tmp_path])
    (tmp_path / "libLLVM-15.so.1").write_bytes(b"")
    (tmp_path / "libLLVM.so.9999").symlink_to(tmp_path / "gone")
    (tmp_path / "libLLVMSupport.a").write_bytes(b"")
    with pytest.raises(engine.BackendUnavailable, match=r"libLLVM-15\.so\.1 is LLVM 15.*install LLVM 19"):
        module.find_llvm()
    library(tmp_path, 19)
    newest = library(tmp_path, 21)
    assert module.find_llvm() == (str(newest), (21, 1, 7))


def test_its_own_llvm_comes_before_newer_ones_of_the_system(tmp_path, monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    own = tmp_path / module._OWN
    own.mkdir()
    (own / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(module, "_system_folders", lambda: [tmp_path])
    path = library(own, 21)
    other = library(tmp_path, 99)
    assert module.find_llvm() == (str(path), (21, 1, 7))
    assert module.describe()[1]["detail"] == "LLVM 21.1.7, HoloPath's own"
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(other))
    assert module.describe()[1]["detail"] == f"LLVM 99.1.7, {other}"
    # what is wrong with it is told, also where nothing else is found
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH")
    other.unlink()
    path.unlink()
    (own / "libLLVM.so.22.1").write_bytes(b"cut off")
    with pytest.raises(
        engine.BackendUnavailable, match=r"libLLVM\.so\.22\.1 cannot be loaded \(.*(short|header)"
    ):
        module.find_llvm()
    # `name_own_llvm` named it without loading it, which nobody chose
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(own / "libLLVM.so.22.1"))
    newer = library(tmp_path, 98)
    assert module.find_llvm() == (str(newer), (98, 1, 7))


def test_says_what_to_do_without_mitsuba():
    code = "import sys\nsys.modules['mitsuba'] = None\n" + ACTIVATE
    out = run(code)
    assert out.startswith("refused Mitsuba 3 cannot be imported") and "pip install mitsuba" in out


def test_old_llvm_loaded_before(monkeypatch, backend):
    import drjit

    monkeypatch.setattr(drjit.detail, "llvm_version", lambda: (16, 0, 6))
    monkeypatch.setattr(drjit, "has_backend", lambda _: True)
    with pytest.raises(engine.BackendUnavailable, match=r"took LLVM 16\.0\.6.*restart the kernel"):
        module._check_loaded_llvm()

    def none():
        raise engine.BackendUnavailable("none")

    monkeypatch.setattr(module, "find_llvm", none)
    with pytest.raises(engine.BackendUnavailable, match=r"took LLVM 16\.0\.6.*LLVM 19 or newer"):
        module._check_loaded_llvm()


def test_mitsuba_imported_after_the_engine_takes_its_llvm():
    """As in a notebook; whoever names another one, has that."""
    pytest.importorskip("holopath_llvm")
    code = (
        "from holopath_addon import engine\nimport os, mitsuba, drjit\nmitsuba.set_variant('llvm_ad_rgb')\n"
    )
    out = run(code + "print(os.environ['DRJIT_LIBLLVM_PATH'], drjit.detail.llvm_version()[0])")
    assert "holopath_llvm" in out and int(out.split()[-1]) >= module.MIN_LLVM
    code = "import os\nos.environ['DRJIT_LIBLLVM_PATH'] = 'mine'\nfrom holopath_addon import engine\n"
    assert run(code + "print(os.environ['DRJIT_LIBLLVM_PATH'])").strip() == "mine"


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_mono"])
def test_scenes_of_other_variants(variant, backend):
    """Refused in a sentence that names the variant, which is left as it is."""
    import mitsuba as mi

    before = mi.variant()
    try:
        mi.set_variant(variant)
        scene = mi.load_dict({"type": "scene", "shape": {"type": "sphere"}})
        hologram = engine.Hologram(8, 8, 8e-6, (516.5e-9,))
        with pytest.raises(engine.InvalidInput, match=f"variant {variant}, .*load it again"):
            engine.plan(scene, engine.Camera(np.eye(4), 0.4), hologram)
        assert mi.variant() == variant
    finally:
        mi.set_variant(before)


@pytest.mark.parametrize(
    "saved",
    [
        "output.encode_png(np.zeros((2, 2, 3)), 1.0)",
        "engine.PhaseHologram(np.zeros((1, 3, 2, 2), 'f4'), engine.Hologram(2, 2, 8e-6), "
        "engine.Camera(np.eye(4), 0.5), 1.0, 'sgd', (1.0,) * 3).save('{folder}')",
    ],
)
def test_pictures_that_are_written_first_do_not_choose_an_llvm(saved, tmp_path):
    """They bring Dr.Jit, which loads whichever it finds: an old one crashes what is computed later."""
    before = (
        "import numpy as np\nfrom holopath_addon import engine\nfrom holopath_addon.workflow import output\n"
    )
    told = run(
        f"{before}{saved.replace('{folder}', str(tmp_path / 'hologram'))}\nimport os, sys\n"
        "from holopath_addon.engine.scene import variants\n"
        "assert 'drjit' in sys.modules\n"
        "print(os.environ.get('DRJIT_LIBLLVM_PATH') == variants.find_llvm()[0])"
        + COMPUTE.replace("mitsuba.Float", "drjit.llvm.Float")
    )
    assert told.split() == ["True", "sum", "5.0"]


def test_an_interrupt_while_mitsuba_makes_an_object_of_ours(backend):
    """Mitsuba tells of it as of any error of a plugin's."""
    import mitsuba as mi

    class Interrupted(mi.Emitter):
        def __init__(self, props):
            super().__init__(props)
            raise KeyboardInterrupt

    mi.register_emitter("interrupted", Interrupted)
    with pytest.raises(KeyboardInterrupt):
        module.made({"type": "scene", "lamp": {"type": "interrupted"}})
    with pytest.raises(RuntimeError, match="no such plugin|unknown plugin"):
        module.made({"type": "scene", "lamp": {"type": "there_is_none"}})
