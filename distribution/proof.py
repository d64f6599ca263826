"""Proves that the binaries in a zip's wheels load on its platform, without running them.

Reads ELF, Mach-O and PE files as the loaders of Linux, macOS and Windows do. Each library that a binary imports must
be in the zip, in Blender, or in every system that Blender runs on; each binary must be for the processor, the Python
and a system that is old enough; and LLVM must have the functions that Dr.Jit looks up in it by name.

On Windows each function that is imported must be in the library that it is imported from. Binaries that pass objects
of C++ to each other must take the same C++ library, which is none that an older Blender would answer with its own.
"""

import hashlib
import posixpath
import re
import zipfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

# What a platform's loader takes from the system, by patterns, in lower case on Windows.
SYSTEM = {
    "linux-x64": (
        # The C library.
        *("libc.so.6", "libm.so.6", "libdl.so.2", "libpthread.so.0", "librt.so.1", "ld-linux-x86-64.so.2"),
        # The compiler's, which Blender needs too.
        *("libstdc++.so.6", "libgcc_s.so.1"),
        # Blender does not need these, but desktops do: Mesa the compiler's for atomics, FreeType zlib.
        *("libatomic.so.1", "libz.so.1"),
    ),
    "macos-arm64": (
        "/System/Library/Frameworks/*",
        # The C library, the compilers', and three more that every macOS has.
        *("/usr/lib/libSystem.B.dylib", "/usr/lib/libc++.1.dylib", "/usr/lib/libobjc.A.dylib"),
        *("/usr/lib/libz.1.dylib", "/usr/lib/libxml2.2.dylib", "/usr/lib/libiconv.2.dylib"),
    ),
    "windows-x64": (
        # The C library, which Windows 8.1 has by updates, the kernel's newer part, and an older C library.
        *("api-ms-win-crt-*.dll", "api-ms-win-core-synch-*.dll", "msvcrt.dll"),
        # The kernel, the registry, the network and objects; windows, sound and devices.
        *("kernel32.dll", "ntdll.dll", "advapi32.dll", "ws2_32.dll", "ole32.dll", "oleaut32.dll"),
        *("user32.dll", "gdi32.dll", "imm32.dll", "shell32.dll", "version.dll", "winmm.dll"),
        *("setupapi.dll", "cfgmgr32.dll"),
    ),
}

# Blender for Windows has the compiler's runtime and Python beside it. The others have Python in themselves, and
# modules find it there without importing a library. Blender's MSVCP140.dll is not here: until 5.0 it is of 2021, too
# old for what is built since 2024.
BLENDER = {"windows-x64": ("vcruntime140.dll", "vcruntime140_1.dll", "python{python}.dll")}

# Functions of the compiler's runtime that may be imported: all are in version 14.29, which Blender 4.2 to 5.0 have.
RUNTIME = {
    "vcruntime140_1.dll": {"__CxxFrameHandler4"},
    "vcruntime140.dll": {
        *(
            "memchr",
            "memcmp",
            "memcpy",
            "memmove",
            "memset",
            "strchr",
            "strrchr",
            "strstr",
            "wcschr",
            "wcsrchr",
            "wcsstr",
        ),
        *(
            "_CxxThrowException",
            "__AdjustPointer",
            "__C_specific_handler",
            "__CxxFrameHandler3",
            "__RTDynamicCast",
        ),
        *("__RTtypeid", "__current_exception", "__current_exception_context", "__intrinsic_setjmp"),
        *("__intrinsic_setjmpex", "__processing_throw", "__std_exception_copy", "__std_exception_destroy"),
        *(
            "__std_terminate",
            "__std_type_info_compare",
            "__std_type_info_destroy_list",
            "__std_type_info_hash",
        ),
        *("__std_type_info_name", "__uncaught_exception", "__uncaught_exceptions", "_purecall", "longjmp"),
    },
}

# By this function a library is known as a build of Microsoft's C++ library, whatever its name.
CPP_LIBRARY = "?_Xlength_error@std@@YAXPEBD@Z"

PROCESSOR = {"linux-x64": "X86_64", "macos-arm64": "ARM64", "windows-x64": "AMD64"}

# The newest versions that may be needed: of Rocky Linux 8 and Windows 8.1, the oldest for Blender 4.2; and the macOS
# that LLVM is built for.
NEWEST = {
    "GLIBC": (2, 28),
    "GLIBCXX": (3, 4, 25),
    "CXXABI": (1, 3, 11),
    "GCC": (7, 0, 0),
    "LIBATOMIC": (1, 2),
    "ZLIB": (1, 2, 9),
    "macOS": (13, 0, 0),
    "Windows": (6, 3),
}

BINARY = (b"\x7fELF", b"MZ", b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe")
LIBRARY = re.compile(r"\.(so[\d.]*|dylib|dll|pyd)$")
MODULE = re.compile(r"\.(cpython-[^/]*|cp\d[^/]*|abi3)\.(so|pyd)$|\.pyd$")
MODULE_ENDS = {
    "linux-x64": (".cpython-{python}-x86_64-linux-gnu.so", ".abi3.so"),
    "macos-arm64": (".cpython-{python}-darwin.so", ".abi3.so"),
    "windows-x64": (".cp{python}-win_amd64.pyd",),
}

# Loaders take a library that is in memory for any that goes by its name: mitsuba/__init__.py imports drjit first, and
# Mitsuba's library loads its plugins. The extension with CuPy loads NVIDIA's libraries, and Microsoft's, when it is
# registered.
LOADED_BEFORE = {
    "mitsuba/*": "drjit/_drjit_ext.*",
    "mitsuba/plugins/*": "mitsuba/*mitsuba.[ds]*",
    "cupy*/*": "nvidia/*",
    "cupy*/*.pyd": "cupy_backends/cpp*.dll",
}

# PySDL2 loads these only for modules that HoloPath does not import, and after SDL: they may rely on that. CuPy imports
# these for matrices, random numbers, tensors and several cards, and the last one is for programs of FFTW.
UNUSED = re.compile(
    r"sdl2dll/dll/(?!(lib)?sdl2[-.])"
    r"|cupy\w*/(.*/)?_?(cublas|curand|cusolver|cusparse|cutensor|nccl|cudnn)\."
    r"|nvidia/cufft/\w+/(lib)?cufftw|nvidia/cuda_runtime/",
    re.IGNORECASE,
)

# How packages for Windows tell where else their libraries are.
DLL_FOLDER = re.compile(r"'(\w+\.libs)'.*\badd_dll_directory\(", re.DOTALL)

DRJIT = re.compile(r"drjit/(lib)?drjit-core\.(so|dylib|dll)$")
LLVM = re.compile(r"holopath_llvm/(libLLVM[^/]*|llvm-c\.dll)$")
LOOKED_UP = re.compile(rb"(?<=\0)LLVM[A-Z][A-Za-z0-9]+(?=\0)")
LEAST_LOOKED_UP = 60  # Dr.Jit 1.5 has 65 such names
# Of LLVM's old pass manager: Dr.Jit takes that only where the new one is missing.
OPTIONAL = {"LLVMAddLICMPass"}


class Unproven(ValueError):
    """Binaries would not load: a line for each reason."""


@dataclass(frozen=True)
class Proof:
    """What the binaries of a zip need.

    Attributes
    ----------
    platform, python : str
        What the zip is for, as in ``"linux-x64"`` and ``"3.13"``.
    binaries : int
        How many there are.
    needs : dict
        The newest version that is needed, and the wheels that need it, by what has versions.
    looked_up, exported : int
        How many of LLVM's functions Dr.Jit looks up, and how many of these LLVM has.
    blender, system : tuple of str
        Libraries that come from Blender, and from the system.
    """

    platform: str
    python: str
    binaries: int
    needs: dict[str, tuple[tuple[int, ...], tuple[str, ...]]]
    looked_up: int
    exported: int
    blender: tuple[str, ...]
    system: tuple[str, ...]


@dataclass(frozen=True)
class Binary:
    """What a loader reads in a file."""

    wheel: str
    looked_up: Set[str]
    name: str  # what it goes by in memory
    processor: str
    imports: Mapping[str, Sequence[str]]  # with the paths where each is looked for
    needs: Sequence[tuple[str, tuple[int, ...]]]
    exports: Set[str]
    handed_down: Sequence[str] = ()  # folders where the imports of its imports are looked for too
    functions: Mapping[str, Set[str]] = field(
        default_factory=dict
    )  # of Windows, by the library they come from
    digest: str = ""


def prove(wheels: Sequence[Path], platform: str, python: str, with_llvm: bool = True) -> Proof:
    """Prove that the binaries in wheels load once Blender has unpacked these into one folder.

    Parameters
    ----------
    wheels : sequence of Path
        All wheels of a zip for one Python.
    platform, python : str
        What the zip is for, as in ``"linux-x64"`` and ``"3.13"``.
    with_llvm : bool, optional
        Whether Dr.Jit and an LLVM for it are to be in the zip.

    Returns
    -------
    Proof
        What they need.

    Raises
    ------
    Unproven
        If any would not load.
    """
    binaries, dll_folders, findings = _read(wheels, platform)
    findings += _misfits(binaries, platform, python)
    looked_up = {name for path, binary in binaries.items() if DRJIT.match(path) for name in binary.looked_up}
    exports = {name for path, binary in binaries.items() if LLVM.match(path) for name in binary.exports}
    if with_llvm and len(looked_up) < LEAST_LOOKED_UP:
        findings.append(
            f"Dr.Jit's library has {len(looked_up)} names of LLVM's functions: too few to be all."
        )
    if with_llvm and not exports:
        findings.append("There is no library of LLVM's in a wheel holopath_llvm.")
    elif lacking := looked_up - exports - OPTIONAL:
        findings.append(f"LLVM's library lacks what Dr.Jit looks up: {', '.join(sorted(lacking))}.")
    blender, system, missing, loads = _origins(binaries, dll_folders, platform, python)
    findings += _without_functions(binaries, loads)
    findings += _strangers(binaries, loads)
    for name, paths in missing.items():
        more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
        findings.append(
            f"{name} is missing where {paths[0]} ({binaries[paths[0]].wheel}){more} would find it: in the zip, Blender "
            "or the system."
        )
    if findings:
        raise Unproven("\n".join(findings))
    by_need = defaultdict(set)
    for binary in binaries.values():
        for need in binary.needs:
            by_need[need].add(binary.wheel)
    # Of each kind, the newest comes last and stays.
    needs = {kind: (version, tuple(sorted(names))) for (kind, version), names in sorted(by_need.items())}
    exported = len(looked_up & exports)
    return Proof(platform, python, len(binaries), needs, len(looked_up), exported, blender, system)


def table(proofs: Sequence[Proof]) -> str:
    """Proofs as a table in Markdown, a row for each.

    Parameters
    ----------
    proofs : sequence of Proof
        What `prove` returned.

    Returns
    -------
    str
        The table, with a line break at its end.
    """
    lines = [
        "| Platform | Python | Binaries | At least | LLVM's functions | From Blender | From the system |"
    ]
    lines += ["| --- " * 7 + "|"]
    for proof in proofs:
        needs = (
            f"{kind} {_dotted(version)} ({', '.join(names)})"
            for kind, (version, names) in proof.needs.items()
        )
        least, blender, system = (", ".join(texts) or "-" for texts in (needs, proof.blender, proof.system))
        lines += [
            f"| {proof.platform} | {proof.python} | {proof.binaries} | {least} | {proof.exported} of "
            f"{proof.looked_up} | {blender} | {system} |"
        ]
    return "\n".join(lines) + "\n"


def _read(wheels, platform):
    """Binaries by their paths, folders that packages add for libraries, and a sentence for each unreadable file."""
    import lief  # those who build have it

    lief.logging.disable()
    parse, facts = {
        "linux-x64": (lief.ELF.parse, _elf),
        "macos-arm64": (lief.MachO.parse, _macho),
        "windows-x64": (lief.PE.parse, _pe),
    }[platform]
    binaries, dll_folders, findings = {}, [], []
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as archive:
            for name in archive.namelist():
                with archive.open(name) as file:
                    marked = file.read(4).startswith(BINARY)
                if marked or LIBRARY.search(name):
                    path = name.lower() if platform == "windows-x64" else name  # Windows ignores case
                    data = archive.read(name)
                    if (binary := parse(data)) is None:
                        findings.append(f"{path} ({wheel.name}) is not a binary of {platform}.")
                        continue
                    looked_up = LOOKED_UP.findall(data) if DRJIT.match(path) else []
                    looked_up = {name.decode() for name in looked_up}
                    package, digest = wheel.name.split("-")[0], hashlib.sha256(data).hexdigest()
                    found = facts(binary, path)
                    binaries[path] = Binary(package, looked_up, digest=digest, **found)
                elif name.endswith("/__init__.py"):
                    dll_folders += DLL_FOLDER.findall(archive.read(name).decode())
    return binaries, dll_folders, findings


def _elf(binary, path) -> dict[str, Any]:
    """What a loader reads in a binary of Linux."""
    tags = {entry.tag.name: entry for entry in binary.dynamic_entries}
    searched = tags.get("RUNPATH") or tags.get("RPATH")
    folders = _within(path, "$ORIGIN", searched.paths if searched else [])
    imports = {name: [f"{folder}/{name}" for folder in folders] for name in binary.libraries}
    needs = []
    for library in binary.symbols_version_requirement:
        if _pattern_of(library.name, SYSTEM["linux-x64"]):
            for symbol in library.get_auxiliary_symbols():
                kind, _, version = symbol.name.rpartition("_")
                # Those without a number, as GLIBC_PRIVATE, are for a system's own libraries.
                numbers = re.findall(r"\d+", version)
                needs.append((kind, tuple(map(int, numbers))) if numbers else (symbol.name, ()))
    name = tags["SONAME"].name if "SONAME" in tags else posixpath.basename(path)
    exports = {symbol.name for symbol in binary.exported_symbols}
    handed_down = [] if "RUNPATH" in tags else folders  # the newer kind is for a library's own imports alone
    return {
        "name": name,
        "processor": binary.header.machine_type.name,
        "imports": imports,
        "needs": needs,
        "exports": exports,
        "handed_down": handed_down,
    }


def _macho(universal, path) -> dict[str, Any]:
    """The same of a binary of macOS, which can be several in one."""
    binary = next((part for part in universal if part.header.cpu_type.name == "ARM64"), universal.at(0))
    name, imports = path, {}
    for library in binary.libraries:
        if library.command.name == "ID_DYLIB":
            name = library.name
        elif library.command.name != "LOAD_WEAK_DYLIB":  # which it can do without
            of_rpath = [rpath.path + library.name.removeprefix("@rpath") for rpath in binary.rpaths]
            places = of_rpath if library.name.startswith("@rpath/") else [library.name]
            imports[library.name] = _within(path, "@loader_path", places)
    needs = [("macOS", tuple(binary.build_version.minos))] if binary.build_version else []
    exports = {symbol.name.removeprefix("_") for symbol in binary.exported_symbols}
    processor = binary.header.cpu_type.name
    return {"name": name, "processor": processor, "imports": imports, "needs": needs, "exports": exports}


def _pe(binary, path) -> dict[str, Any]:
    """The same of a binary of Windows."""
    tables = (*binary.imports, *binary.delay_imports)
    functions = {table.name.lower(): {entry.name for entry in table.entries} for table in tables}
    imports = {name: _within(path, "$ORIGIN", [f"$ORIGIN/{name}"]) for name in functions}
    header = binary.optional_header
    needs = [("Windows", (header.major_subsystem_version, header.minor_subsystem_version))]
    exported = binary.get_export()
    exports = {entry.name for entry in exported.entries} if exported else set()
    return {
        "name": posixpath.basename(path),
        "processor": binary.header.machine.name,
        "imports": imports,
        "needs": needs,
        "exports": exports,
        "functions": functions,
    }


def _within(path, token, names):
    """Paths of `names` in the zip, with the folder of the binary at `path` for `token`."""
    return [posixpath.normpath(name.replace(token, posixpath.dirname(path) or ".")) for name in names]


def _misfits(binaries, platform, python) -> Iterator[str]:
    """A sentence for each binary of another processor or Python, or of a newer system."""
    ends = tuple(end.format(python=python.replace(".", "")) for end in MODULE_ENDS[platform])
    for path, binary in binaries.items():
        where = f"{path} ({binary.wheel})"
        if binary.processor != PROCESSOR[platform]:
            yield f"{where} is for {binary.processor}, not {PROCESSOR[platform]}."
        if MODULE.search(path) and not path.endswith(ends):
            yield f"{where} is not a module for Python {python} on {platform}."
        if platform == "macos-arm64" and not binary.needs:
            yield f"{where} does not tell which macOS it needs."
        for kind, version in binary.needs:
            if kind not in NEWEST:
                yield f"{where} needs {kind}, which systems do not promise."
            elif version > NEWEST[kind]:
                yield f"{where} needs {kind} {_dotted(version)}, newer than {_dotted(NEWEST[kind])}."


def _origins(binaries, dll_folders, platform, python):
    """Imports from Blender and from the system; what is missing, with the paths of those that import it; and where each
    binary's other imports are."""
    of_blender = [name.format(python=python.replace(".", "")) for name in BLENDER.get(platform, ())]
    loads, loaded_by, blender, system, outside = defaultdict(dict), defaultdict(set), set(), set(), []
    for path, binary in binaries.items():
        for name, places in binary.imports.items():
            places = [*places, *(f"{folder}/{name}" for folder in dll_folders)]
            if place := next(filter(binaries.get, places), None):
                loads[path][name] = place
                loaded_by[place].add(path)
            elif name in of_blender:
                blender.add(name)
            elif pattern := _pattern_of(name, SYSTEM[platform]):
                system.add(pattern)
            elif not UNUSED.match(path):
                outside.append((name, path))
    missing = defaultdict(list)
    for name, path in outside:
        handed_down = [
            any(f"{folder}/{name}" in binaries for folder in binaries[loader].handed_down)
            for loader in loaded_by[path]
        ]
        if handed_down and all(handed_down):
            continue
        if place := _in_memory(path, binaries, loads).get(name):
            loads[path][name] = place
        else:
            missing[name].append(path)
    return tuple(sorted(blender)), tuple(sorted(system)), missing, loads


def _in_memory(path, binaries, loads):
    """Paths of the libraries that are loaded before the one at `path` is, by what they go by."""
    patterns = [before for those, before in LOADED_BEFORE.items() if fnmatchcase(path, those)]
    todo = {other for other in binaries if any(fnmatchcase(other, pattern) for pattern in patterns)}
    loaded = set()
    while todo:
        loaded |= todo
        todo = {new for other in todo for new in loads[other].values()} - loaded
    return {binaries[other].name: other for other in sorted(loaded)}


def _without_functions(binaries, loads) -> Iterator[str]:
    """A sentence for each library of Windows that lacks functions which a binary imports from it."""
    for path, binary in binaries.items():
        for name, functions in binary.functions.items():
            if place := loads[path].get(name):
                there = binaries[place].exports
            elif name in RUNTIME:
                there = RUNTIME[name]
            else:
                continue
            if lacking := sorted(functions - there - {""}):  # those without a name go by numbers
                yield f"{name} lacks what {path} ({binary.wheel}) imports from it: {', '.join(lacking)}."


def _strangers(binaries, loads) -> Iterator[str]:
    """A sentence for binaries that import from each other, and take objects for those of another C++ library."""
    builds = {path: binary for path, binary in binaries.items() if CPP_LIBRARY in binary.exports}
    digests = defaultdict(set)
    for binary in builds.values():
        digests[binary.name].add(binary.digest)
    for name in [name for name, found in digests.items() if len(found) > 1]:
        yield f"{name} is two different files: Windows takes for one what is in memory of the other."
    taken = {
        path: {name for name, place in places.items() if place in builds} for path, places in loads.items()
    }
    for path, places in sorted(loads.items()):
        for place in sorted(set(places.values()) - builds.keys()):
            ours, theirs = taken[path], taken.get(place)
            if ours and theirs and ours != theirs:
                yield (
                    f"{path} ({binaries[path].wheel}) takes {', '.join(sorted(ours))}, and {place}, which it imports, "
                    f"{', '.join(sorted(theirs))}: objects of one C++ library are unknown to another."
                )


def _pattern_of(name, patterns):
    return next((pattern for pattern in patterns if fnmatchcase(name, pattern)), None)


def _dotted(version):
    return ".".join(map(str, version))
