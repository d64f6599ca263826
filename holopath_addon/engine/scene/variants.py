"""Selection of the Mitsuba variant, and of a libLLVM that is new enough for it.

Dr.Jit comes without LLVM. It loads any libLLVM that it finds, once, when it is first imported; with LLVM 15 or 16 the
first minimum or maximum then aborts the process. So the library is chosen and its version checked here, before Dr.Jit
is imported, and passed in `DRJIT_LIBLLVM_PATH`: HoloPath's own, which comes as the package holopath_llvm with the
extension and with `make env`, else the system's newest. CUDA needs no LLVM.

Dr.Jit also opens every NVIDIA card when it is imported, whatever variant is set later, and aborts the process if one of
them cannot be opened. So they are tried before, and hidden from it by `DRJIT_LIBCUDA_PATH` if one fails. That does not
help where Mitsuba is imported without `activate`, or where another program has loaded CUDA for all of the process.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import os
import re
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import BackendUnavailable, InvalidInput

if TYPE_CHECKING:
    import mitsuba as mi

CUDA = "cuda_ad_rgb"
LLVM = "llvm_ad_rgb"
MIN_LLVM = 19  # major version

_LIBRARY_NAME = re.compile(r"libLLVM(-[\d.]+)?\.(so(\.[\w.-]+)?|dylib)|LLVM-C\.dll")
_VERSION_IN_NAME = re.compile(r"libLLVM(?:-|\.so\.)(\d+)(?:\.(\d+))?")
_VERSION_IN_FOLDER = re.compile(r"llvm[-@]?(\d+)")
_OWN = "holopath_llvm"
_NO_CUDA = "no-cuda-as-a-card-cannot-be-opened"  # Dr.Jit warns that it cannot load a library of this name
_OUT_OF_MEMORY = 2  # CUDA_ERROR_OUT_OF_MEMORY
_CAPABILITY = 75, 76  # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR and _MINOR
# Bytes of a card for the programs that Dr.Jit loads at its import, into cards of this compute capability or more.
_MIN_FREE, _MIN_CAPABILITY = 64 << 20, (7, 5)

_lock = threading.RLock()
# Variants with our plugins. Mitsuba outlives this module when Blender installs a new version of HoloPath.
_extended = set()
# Why Dr.Jit was imported without CUDA, though there is a driver; maybe by an earlier version of this module.
_hidden = "drjit" in sys.modules and os.environ.get("DRJIT_LIBCUDA_PATH") == _NO_CUDA
_card_fault = "a card could not be opened: start again" if _hidden else ""


def activate(prefer: str | None = None) -> str:
    """Set the Mitsuba variant; cheap to repeat, callable from any thread.

    Parameters
    ----------
    prefer : {'cuda_ad_rgb', 'llvm_ad_rgb'}, optional
        Variant to use. Default: the one already set if it is one of these, else that of `HOLOPATH_BACKEND`, else CUDA
        if there is a device with OptiX, else LLVM.

    Returns
    -------
    str
        Name of the variant that is set.

    Raises
    ------
    InvalidInput
        If `prefer` is another variant.
    BackendUnavailable
        If Mitsuba is not installed, or neither a CUDA device nor a libLLVM of version 19 or newer can be used.
    """
    with _lock:
        current = _current_variant()
        prefer = prefer or (None if current else os.environ.get("HOLOPATH_BACKEND") or None)
        if prefer not in (None, CUDA, LLVM):
            raise InvalidInput(f"Expected the backend {CUDA} or {LLVM}, got '{prefer}'.")
        variant = prefer or current or (CUDA if _cuda_device()[0] else LLVM)
        if variant == CUDA and current != CUDA:
            usable, detail = _cuda_device()
            if not usable:
                raise BackendUnavailable(f"{CUDA} cannot be used: {detail}; choose {LLVM} instead.")
        for kind in (np.float32, np.float64):
            # warns if its first call comes after Dr.Jit made the processor flush subnormal numbers
            np.finfo(kind)
        if "drjit" not in sys.modules:
            _choose_libraries(llvm_required=variant == LLVM)
        mitsuba = _import_mitsuba()
        if variant == CUDA and not _initialized("CUDA"):
            if prefer:
                raise BackendUnavailable(
                    f"{CUDA} cannot be used: {_card_fault}; or choose {LLVM}."
                    if _card_fault
                    else f"Dr.Jit cannot use CUDA with this driver: update it, or choose {LLVM}."
                )
            variant = LLVM
        if variant == LLVM:
            _check_loaded_llvm()
            _limit_threads()
        if variant != current:
            try:
                mitsuba.set_variant(variant)
            except ImportError as error:
                raise BackendUnavailable(f"Mitsuba cannot start {variant}: {_one_line(error)}.") from error
        if variant not in _extended:
            _extend()
            _extended.add(variant)
        return variant


def on_card() -> bool:
    """Whether the current variant, or else the one that `activate` would set, computes on a graphics card."""
    with _lock:
        variant = _current_variant() or os.environ.get("HOLOPATH_BACKEND")
        return variant == CUDA or (not variant and _cuda_device()[0])


def activate_for(scene: mi.Scene) -> str:
    """Set the Mitsuba variant that a scene was loaded with; see `activate`.

    Raises
    ------
    InvalidInput
        If that variant cannot compute holograms; a variant cannot use objects of another one.
    BackendUnavailable
        See `activate`.
    """
    loaded = scene.variant_name()
    if loaded not in (CUDA, LLVM):
        raise InvalidInput(
            f"The scene was loaded in Mitsuba's variant {loaded}, which computes no holograms: call "
            f"mitsuba.set_variant('{LLVM}') or ('{CUDA}') first, and load it again."
        )
    return activate(loaded)


def name_own_llvm() -> None:
    """Set `DRJIT_LIBLLVM_PATH` to HoloPath's own LLVM, unless it is set or Dr.Jit is already imported.

    Dr.Jit loads an LLVM once, when anybody imports Mitsuba, which may be one that crashes it. Nothing is loaded here.
    """
    if "drjit" in sys.modules or "DRJIT_LIBLLVM_PATH" in os.environ:
        return
    for folder in _own_folders():
        for path in _files_in(folder):
            if _LIBRARY_NAME.fullmatch(path.name) and path.exists():
                os.environ["DRJIT_LIBLLVM_PATH"] = str(path)
                return


def take_over() -> None:
    """Let this thread use variables that another thread has made since this one started; a variant must be set.

    Dr.Jit numbers the scopes of its threads, and rejects variables of later scopes than the thread's own.
    """
    import drjit

    backend = drjit.JitBackend.CUDA if _current_variant() == CUDA else drjit.JitBackend.LLVM
    drjit.detail.new_scope(backend)


def bitmaps() -> Any:
    """Import Mitsuba to read and write images, without a variant.

    This imports Dr.Jit, which loads an LLVM once: the right one is chosen before.

    Returns
    -------
    module

    Raises
    ------
    BackendUnavailable
        If Mitsuba is not installed.
    """
    with _lock:
        if "drjit" not in sys.modules:
            _choose_libraries(llvm_required=False)
        return _import_mitsuba()


def read_bitmap(path: Path | str) -> Any:
    """Read a picture file as a `mitsuba.Bitmap`.

    Mitsuba itself takes a path's letters for those of the system's code page on Windows, and a server for a folder.

    Raises
    ------
    OSError
        If there is no such file.
    RuntimeError
        If it is no picture.
    """
    mi = bitmaps()
    stream = mi.MemoryStream()
    stream.write(Path(path).read_bytes())
    stream.seek(0)
    return mi.Bitmap(stream)


def encoded_bitmap(pixels: np.ndarray, file_format: Any) -> bytes:
    """Content of a file of pixels.

    Parameters
    ----------
    pixels : numpy.ndarray, shape (y, x) or (y, x, channel)
    file_format : mitsuba.Bitmap.FileFormat
    """
    mi = bitmaps()
    stream = mi.MemoryStream()
    mi.Bitmap(pixels).write(stream, file_format)
    return stream.raw_buffer()


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Write pixels as a PNG file; see `read_bitmap` for its path."""
    path.write_bytes(encoded_bitmap(pixels, bitmaps().Bitmap.FileFormat.PNG))


def threads() -> int:
    """Number of threads to compute with: `HOLOPATH_THREADS`, or the number of processors that this process may use.

    Batch systems such as SLURM restrict a process to some processors of the machine.

    Returns
    -------
    int

    Raises
    ------
    InvalidInput
        If `HOLOPATH_THREADS` is not a whole number of at least 1.
    """
    text = os.environ.get("HOLOPATH_THREADS", "")
    if not text:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not (text.isdecimal() and int(text) > 0):
        raise InvalidInput(
            f"HOLOPATH_THREADS must be a whole number of at least 1, got '{text}'. Change or unset it."
        )
    return int(text)


def made(parts: dict) -> Any:
    """Make a Mitsuba object from its parts, a dictionary of `mitsuba.load_dict`; scenes by `meshes.building.scene_of`.

    One thread makes them, so that each process numbers objects in the same order: the numbers are part of the programs
    that Dr.Jit compiles and caches on disk.
    """
    import mitsuba as mi

    from .meshes import building

    try:
        if parts["type"] == "scene":
            return building.scene_of(parts)
        return mi.load_dict(parts, parallel=False)
    except RuntimeError as error:
        # an interrupt in the constructor of a plugin of ours arrives as text
        if KeyboardInterrupt.__name__ in str(error):
            raise KeyboardInterrupt from error
        raise


def stop_profiling() -> None:
    """Stop the timing of work in Dr.Jit's threads, which its history of kernels starts for good.

    Timing keeps the threads' cores busy for longer: NumPy's work right after it took 1.5 times as long.
    """
    import drjit

    folder = Path(drjit.__file__).parent
    for name in ("libnanothread.so", "libnanothread.dylib", "nanothread.dll"):
        with suppress(OSError, AttributeError):
            ctypes.CDLL(str(folder / name)).pool_set_profile(0)
            return


def units_at_once() -> int:
    """Maximum units of work of a launch: about 4 s of two slow cores, or half a second of a fast card.

    Returns
    -------
    int
    """
    return 64 if activate() == CUDA else 4


def units_at_first() -> int:
    """Units of work of the first launch of rays, whose speed is unknown: a tenth of a second of a card for most scenes.

    Returns
    -------
    int
    """
    return 16 if activate() == CUDA else 1


def chunks_at_once() -> int:
    """Maximum chunks of sums (`Plan.chunk`) of a launch: half a gigabyte of a card, in chunks of 128 MB.

    Returns
    -------
    int
    """
    return 4 if activate() == CUDA else 1


def describe() -> list[dict]:
    """List the backends of this machine, without activating any.

    Returns
    -------
    list of dict
        For each variant its `name`, whether it is `available`, and in `detail` the device or library that it uses, or
        the reason why it is not available.
    """
    with _lock:
        usable, detail = _cuda_device()
        fault = _fault_of_cards() if usable and "drjit" not in sys.modules else ""
        if fault:
            usable, detail = False, fault
        rows = [{"name": CUDA, "available": usable, "detail": detail}]
        try:
            path, version = find_llvm()
            where = "HoloPath's own" if Path(path).parent in _own_folders() else path
            row = {"available": True, "detail": f"LLVM {_dotted(version)}, {where}"}
        except BackendUnavailable as error:
            row = {"available": False, "detail": str(error)}
        return rows + [{"name": LLVM, **row}]


def find_llvm() -> tuple[str, tuple[int, ...]]:
    """Find a usable libLLVM: HoloPath's own, else the newest; if `DRJIT_LIBLLVM_PATH` is set, it is the only candidate.

    Returns
    -------
    path : str
    version : tuple of int
        (major, minor, patch) that the library reports.

    Raises
    ------
    BackendUnavailable
        If none of version 19 or newer can be loaded.
    """
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    if chosen and Path(chosen).parent not in _own_folders():  # not by `name_own_llvm`
        version, problem = _probe(Path(chosen))
        if version is None:
            raise BackendUnavailable(
                f"DRJIT_LIBLLVM_PATH names {chosen}, which {problem}: {_how_to_install()} "
                "and point it there, or unset it."
            )
        return chosen, version
    problems = []
    for path in _candidates():
        version, problem = _probe(path)
        if version is not None:
            return str(path), version
        problems.append(f"{path} {problem}")
    example = f" ({problems[0]})" if problems else ""
    raise BackendUnavailable(
        f"Mitsuba computes on the CPU with LLVM, and none that is new enough was found{example}: "
        f"{_how_to_install()}, or set DRJIT_LIBLLVM_PATH to its path."
    )


def _current_variant():
    """Name of the variant that is set, or None if it is not one of ours."""
    mitsuba = sys.modules.get("mitsuba")
    variant = mitsuba.variant() if mitsuba is not None and hasattr(mitsuba, "variant") else None
    return variant if variant in (CUDA, LLVM) else None


def _choose_libraries(llvm_required):
    """Set the path of the LLVM for Dr.Jit, before its import, and hide cards that would end the process then.

    `llvm_required` raises if there is no LLVM. A card that a person named by `DRJIT_LIBCUDA_PATH` is theirs.
    """
    global _card_fault
    try:
        os.environ["DRJIT_LIBLLVM_PATH"] = find_llvm()[0]
    except BackendUnavailable:
        if llvm_required:
            raise
    if os.environ.get("DRJIT_LIBCUDA_PATH") in (None, "", _NO_CUDA):
        os.environ.pop("DRJIT_LIBCUDA_PATH", None)
        _card_fault = _fault_of_cards()
        if _card_fault:
            os.environ["DRJIT_LIBCUDA_PATH"] = _NO_CUDA


def _import_mitsuba():
    try:
        import mitsuba
    except ImportError as error:
        raise BackendUnavailable(
            f"Mitsuba 3 cannot be imported ({_one_line(error)}): install it with `pip install mitsuba`, "
            "or in Blender install the HoloPath extension for your platform again."
        ) from error
    return mitsuba


def _initialized(backend):
    import drjit

    return bool(drjit.has_backend(getattr(drjit.JitBackend, backend)))


def _check_loaded_llvm():
    """Check that the LLVM that Dr.Jit has loaded is new enough; raise `BackendUnavailable` if it is not."""
    import drjit

    loaded = drjit.detail.llvm_version() if _initialized("LLVM") else None
    if loaded is None or loaded[0] < MIN_LLVM:
        took = f"took LLVM {_dotted(loaded)}, which crashes it" if loaded else "found no LLVM that it can use"
        try:
            path, _ = find_llvm()
        except BackendUnavailable:
            cure = f"{_how_to_install()}, set DRJIT_LIBLLVM_PATH to its path, and start Python again"
        else:
            cure = (
                "start Python again (in a notebook, restart the kernel), and import holopath_addon.engine before "
                f"mitsuba; or set DRJIT_LIBLLVM_PATH to {path} before"
            )
        raise BackendUnavailable(f"Mitsuba was imported before HoloPath, and its Dr.Jit {took}: {cure}.")


def _limit_threads():
    """Limit Dr.Jit to `threads` threads, instead of one for each processor, but to no fewer than two.

    One beside the caller's is needed to read and write OpenEXR files, which would never finish without it.
    """
    import drjit

    count = max(2, threads())
    if drjit.thread_count() != count:
        drjit.set_thread_count(count)


def _extend():
    """Import the modules that register plugins, whose classes derive from those of the current variant."""
    for name in ("closures", "dispersion", "images", "lamps", "mixture", "captured.view_texture"):
        sys.modules.pop(f"{__package__}.{name}", None)  # may belong to another variant
        importlib.import_module(f".{name}", __package__)


def _cuda_device():
    """Whether CUDA and OptiX can be used, and the first device's name or the reason why not."""
    if _card_fault:
        return False, _card_fault
    cuda, count, problem = _cuda_driver()
    if problem:
        return False, problem
    if os.name != "nt":
        try:
            ctypes.CDLL("libnvoptix.so.1")
        except OSError:
            return False, "the NVIDIA driver lacks OptiX (libnvoptix.so.1)"
    return True, _name_of_card(cuda, 0)


def _cuda_driver():
    """Return (library, number of devices, ""), or (None, 0, why there is none)."""
    if sys.platform == "darwin":
        return None, 0, "CUDA does not exist on macOS"
    try:
        cuda = ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    except OSError:
        return None, 0, "no NVIDIA driver is installed"
    count = ctypes.c_int(0)
    if cuda.cuInit(0) != 0 or cuda.cuDeviceGetCount(ctypes.byref(count)) != 0 or count.value < 1:
        return None, 0, "the NVIDIA driver reports no device"
    return cuda, count.value, ""


def _name_of_card(cuda, device):
    name = ctypes.create_string_buffer(256)
    cuda.cuDeviceGetName(name, len(name), device)
    return name.value.decode(errors="replace") or "NVIDIA device"


def _fault_of_cards():
    """Why a card cannot be opened, as the rest of a sentence, or "" if all can: by the calls that Dr.Jit makes."""
    cuda, count, _ = _cuda_driver()
    with suppress(AttributeError):  # drivers older than these calls: Dr.Jit does without CUDA
        for device in range(count):
            reason = _reason_not_to_open(cuda, device)
            if reason:
                return (
                    f"{_name_of_card(cuda, device)} cannot be opened ({reason}): close the programs that use it, or "
                    "hide it with CUDA_VISIBLE_DEVICES, and start again"
                )
    return ""


def _reason_not_to_open(cuda, device):
    context, free, total, name = ctypes.c_void_p(), ctypes.c_size_t(), ctypes.c_size_t(), ctypes.c_char_p()
    major, minor = ctypes.c_int(), ctypes.c_int()
    error = cuda.cuDevicePrimaryCtxRetain(ctypes.byref(context), device)
    if error == 0:
        cuda.cuCtxPushCurrent_v2(context)
        error = cuda.cuMemGetInfo_v2(ctypes.byref(free), ctypes.byref(total))
        cuda.cuCtxPopCurrent_v2(ctypes.byref(context))
        for value, attribute in zip((major, minor), _CAPABILITY, strict=True):
            cuda.cuDeviceGetAttribute(ctypes.byref(value), attribute, device)
        cuda.cuDevicePrimaryCtxRelease_v2(device)
    is_used = (major.value, minor.value) >= _MIN_CAPABILITY
    if error == _OUT_OF_MEMORY or (error == 0 and is_used and free.value < _MIN_FREE):
        return "its memory is full"
    if error != 0:
        cuda.cuGetErrorName(error, ctypes.byref(name))
        return (name.value or b"").decode() or f"CUDA error {error}"
    return ""


def _candidates():
    """Files that may be a libLLVM: HoloPath's own first, then the system's, newest first."""
    files = {}
    for rank, folders in enumerate((_own_folders(), _system_folders())):
        for folder in folders:
            for path in _files_in(folder):
                if _LIBRARY_NAME.fullmatch(path.name) and path.exists():
                    files.setdefault(path.resolve(), (rank, path))
    order = sorted(files.items(), key=lambda item: (item[1][0], [-n for n in _named_version(item[0])]))
    return [path for path, _ in order]


def _own_folders():
    """Folders of HoloPath's own LLVM: a package without code, installed beside Mitsuba."""
    package = importlib.util.find_spec(_OWN)
    return [Path(folder) for folder in package.submodule_search_locations or ()] if package else []


def _system_folders():
    if os.name == "nt":
        programs = [os.environ.get(name) for name in ("ProgramFiles", "ProgramW6432")]
        folders = [Path(p) / "LLVM" / "bin" for p in programs if p]
        return folders + [Path(p) for p in os.environ.get("PATH", "").split(os.pathsep) if p]
    if sys.platform == "darwin":
        roots = [Path("/opt/homebrew/opt"), Path("/usr/local/opt"), Path("/opt/local/libexec")]
        return [folder for root in roots for folder in sorted(root.glob("llvm*/lib"))]
    folders = [Path(p) for p in os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep) if p]
    folders += [Path(sys.prefix) / "lib"]
    usr = Path("/usr")
    for pattern in ("lib", "lib64", "lib/*-linux-gnu", "lib/llvm*/lib*", "lib64/llvm*/lib*", "local/lib"):
        folders += sorted(usr.glob(pattern))
    return folders


def _files_in(folder):
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def _named_version(path):
    """(major, minor) in the name of the file or its folder, or (0, 0)."""
    in_name = _VERSION_IN_NAME.match(path.name)
    if in_name:
        return int(in_name[1]), int(in_name[2] or 0)
    in_folder = _VERSION_IN_FOLDER.findall(str(path.parent))
    return (int(in_folder[-1]), 0) if in_folder else (0, 0)


def _probe(path):
    """Return (version, None) of a usable library, or (None, problem), the problem as the rest of a sentence.

    A library with the name of an old version is not loaded: every LLVM loaded stays in the process.
    """
    major = _named_version(path.resolve() if path.exists() else path)[0]
    if 0 < major < MIN_LLVM:
        return None, f"is LLVM {major}"
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        return None, f"cannot be loaded ({_one_line(error)})"
    try:
        get_version = library.LLVMGetVersion
    except AttributeError:
        return None, "is older than LLVM 16"
    numbers = [ctypes.c_uint(0) for _ in range(3)]
    get_version(*map(ctypes.byref, numbers))
    version = tuple(n.value for n in numbers)
    if version[0] < MIN_LLVM:
        return None, f"is LLVM {_dotted(version)}"
    return version, None


def _how_to_install():
    if os.name == "nt":
        how = "https://github.com/llvm/llvm-project/releases"
    elif sys.platform == "darwin":
        how = "`brew install llvm`"
    else:
        how = "Debian, Ubuntu: `apt install libllvm19`; Fedora: `dnf install llvm-libs`"
    return f"install LLVM {MIN_LLVM} or newer ({how})"


def _dotted(version):
    return ".".join(map(str, version))


def _one_line(error):
    return " ".join(str(error).split()).rstrip(".")
