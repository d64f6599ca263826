"""What is wrong with the binaries of a zip is found, and named; what is right is proven."""

import importlib.util
import struct
import sys
import zipfile
from pathlib import Path

import lief
import pytest

from distribution.proof import CPP_LIBRARY, OPTIONAL, Unproven, prove, table

lief.logging.disable()

CORE, THREADS, LLVM = "drjit/libdrjit-core.so", "drjit/libnanothread.so", "holopath_llvm/libLLVM.so.21.1"


def proof_of(folder, files, platform, python="3.13", with_llvm=True):
    """Of files by their paths, each in a wheel of its package."""
    folder.mkdir(exist_ok=True)
    wheels = {}
    for name, data in files.items():
        package = name.split("/")[0]
        wheels[package] = folder / f"{package}-1.0-py3-none-any.whl"
        with zipfile.ZipFile(wheels[package], "a") as archive:
            archive.writestr(name, data)
    return prove(list(wheels.values()), platform, python, with_llvm)


def complaints(folder, files, platform, python="3.13"):
    """Sentences on these; those on Dr.Jit and LLVM only where Dr.Jit is there."""
    with pytest.raises(Unproven) as caught:
        proof_of(folder, files, platform, python)
    sentences = str(caught.value).splitlines()
    return sentences if CORE in files else [sentence for sentence in sentences if "LLVM" not in sentence]


@pytest.fixture(scope="module")
def linux():
    """Dr.Jit's libraries as they are installed, and one with LLVM's functions by their names."""
    if sys.platform != "linux":
        pytest.skip("Dr.Jit is installed for another platform")
    folder = Path(importlib.util.find_spec("drjit").origin).parent
    files = {path: (folder / Path(path).name).read_bytes() for path in (CORE, THREADS)}
    words = {
        word.decode() for word in files[CORE].split(b"\0") if word.startswith(b"LLVM") and word.isalnum()
    }
    library = lief.ELF.parse(files[THREADS])
    for name in words - OPTIONAL:
        library.add_exported_function(0x1000, name)
    return files | {LLVM: library.write_to_bytes()}


def test_complete_libraries_of_linux_are_proven(tmp_path, linux):
    proof = proof_of(tmp_path, linux, "linux-x64")
    assert proof.binaries == 3
    assert proof.looked_up >= 60 and proof.exported == proof.looked_up - 1
    assert proof.blender == () and {"libc.so.6", "libstdc++.so.6"} <= set(proof.system)
    assert (2, 17) <= proof.needs["GLIBC"][0] <= (2, 28) and "drjit" in proof.needs["GLIBC"][1]
    row = table([proof]).splitlines()[2]
    assert row.startswith("| linux-x64 | 3.13 | 3 | CXXABI ")
    assert f"| {proof.exported} of {proof.looked_up} | - | libatomic.so.1, libc.so.6, " in row


def test_a_missing_library_of_linux_is_named(tmp_path, linux):
    files = {path: data for path, data in linux.items() if path != THREADS}
    (sentence,) = complaints(tmp_path, files, "linux-x64")
    assert sentence.startswith(f"libnanothread.so is missing where {CORE} (drjit) would find it")


def test_a_library_of_linux_elsewhere_is_missing(tmp_path, linux):
    files = {("other/" + Path(path).name if path == THREADS else path): data for path, data in linux.items()}
    (sentence,) = complaints(tmp_path, files, "linux-x64")
    assert sentence.startswith("libnanothread.so is missing")


@pytest.mark.parametrize("kind", ["Rpath", "RunPath"])
def test_folders_of_the_older_kind_are_handed_down(tmp_path, linux, kind):
    def library(needs, *folders):
        changed = lief.ELF.parse(linux[THREADS])
        changed.remove(lief.ELF.DynamicEntry.TAG.RUNPATH)
        for name in needs:
            changed.add_library(name)
        for folder in folders:
            changed.add(getattr(lief.ELF, f"DynamicEntry{kind}")(folder))
        return changed.write_to_bytes()

    files = {"one/a.so": library(["b.so"], "$ORIGIN"), "one/b.so": library(["c.so"]), "one/c.so": library([])}
    if kind == "Rpath":
        assert proof_of(tmp_path, linux | files, "linux-x64").binaries == 6
    else:
        (sentence,) = complaints(tmp_path, linux | files, "linux-x64")
        assert sentence.startswith("c.so is missing where one/b.so (one) would find it")


def test_modules_for_cards_find_what_their_extension_loads(tmp_path, linux):
    """NVIDIA's libraries, which are in none of their folders; what HoloPath does not import needs none."""

    def library(name, *needs):
        changed = lief.ELF.parse(linux[THREADS])
        changed.get(lief.ELF.DynamicEntry.TAG.SONAME).name = name
        for need in needs:
            changed.add_library(need)
        return changed.write_to_bytes()

    end = "cpython-313-x86_64-linux-gnu.so"
    files = {f"cupy/cuda/cufft.{end}": library("cufft", "libcufft.so.11")}
    files |= {
        f"{place}.{end}": library("other", "libother.so.12")
        for place in ("cupy_backends/cuda/libs/cublas", "cupyx/_cusolver", "cupyx/cudnn")
    }
    own = {"nvidia/cufft/lib/libcufft.so.11": library("libcufft.so.11")}
    proof = proof_of(tmp_path / "all", files | own, "linux-x64", with_llvm=False)
    assert (proof.binaries, proof.looked_up) == (5, 0)
    (sentence,) = complaints(tmp_path / "none", files, "linux-x64")
    assert sentence.startswith("libcufft.so.11 is missing where cupy/cuda/cufft.")


def test_missing_functions_of_llvm_are_named(tmp_path, linux):
    library = lief.ELF.parse(linux[LLVM])
    library.remove_dynamic_symbol("LLVMGetVersion")
    (sentence,) = complaints(tmp_path, linux | {LLVM: library.write_to_bytes()}, "linux-x64")
    assert sentence == "LLVM's library lacks what Dr.Jit looks up: LLVMGetVersion."


def test_no_llvm_is_found_out(tmp_path, linux):
    files = {path: data for path, data in linux.items() if path != LLVM}
    (sentence,) = complaints(tmp_path, files, "linux-x64")
    assert sentence.startswith("There is no library of LLVM's")


def test_a_search_that_finds_no_names_is_found_out(tmp_path, linux):
    files = linux | {CORE: linux[CORE].replace(b"\0LLVM", b"\0XXXX")}
    (sentence,) = complaints(tmp_path, files, "linux-x64")
    assert sentence == "Dr.Jit's library has 0 names of LLVM's functions: too few to be all."


def test_another_processor_is_named(tmp_path, linux):
    ours = bytearray(linux[THREADS])
    ours[18:20] = struct.pack("<H", 183)  # the field for the processor, and AArch64
    (sentence,) = complaints(tmp_path, linux | {THREADS: bytes(ours)}, "linux-x64")
    assert sentence == f"{THREADS} (drjit) is for AARCH64, not X86_64."


@pytest.mark.parametrize(
    "version, said",
    [(b"2.99", "GLIBC 2.99, newer than 2.28"), (b"ODD!", "GLIBC_ODD!, which systems do not promise")],
)
def test_a_newer_c_library_is_named(tmp_path, linux, version, said):
    files = linux | {CORE: linux[CORE].replace(b"\0GLIBC_2.17\0", b"\0GLIBC_" + version + b"\0")}
    assert files[CORE] != linux[CORE]
    (sentence,) = complaints(tmp_path, files, "linux-x64")
    assert sentence == f"{CORE} (drjit) needs {said}."


def test_modules_for_another_python_are_named(tmp_path, linux):
    good = {
        f"scipy/{n}": linux[THREADS] for n in ("a.cpython-313-x86_64-linux-gnu.so", "b.abi3.so", "libc.so")
    }
    bad = {
        f"scipy/{n}": linux[THREADS] for n in ("d.cpython-311-x86_64-linux-gnu.so", "e.cpython-313-darwin.so")
    }
    assert complaints(tmp_path, linux | good | bad, "linux-x64") == [
        f"{name} (scipy) is not a module for Python 3.13 on linux-x64." for name in bad
    ]


def test_what_only_looks_like_a_library_is_named(tmp_path, linux):
    files = linux | {"scipy/library.so": b"a text", "scipy/library.dll": b"MZ"}
    assert complaints(tmp_path, files, "linux-x64") == [
        f"{name} (scipy-1.0-py3-none-any.whl) is not a binary of linux-x64."
        for name in ("scipy/library.so", "scipy/library.dll")
    ]


def macho(imports=(), rpaths=(), weak=(), name="@rpath/other.dylib", macos=11, processor=0x0100000C):
    """A library for macOS, of its header alone."""
    kinds = {0x0D: [name], 0x0C: imports, 0x80000018: weak, 0x8000001C: rpaths}
    commands = [struct.pack("<6I", 0x32, 24, 1, macos << 16, macos << 16, 0)]  # needs a macOS
    for kind, texts in kinds.items():
        fields = b"" if kind == 0x8000001C else struct.pack("<3I", 0, 0, 0)
        for text in texts:
            start = 12 + len(fields)
            padded = text.encode().ljust((len(text) // 8 + 1) * 8 + -start % 8, b"\0")
            commands.append(struct.pack("<3I", kind, start + len(padded), start) + fields + padded)
    size = sum(map(len, commands))
    return struct.pack("<8I", 0xFEEDFACF, processor, 0, 6, len(commands), size, 0, 0) + b"".join(commands)


def test_libraries_of_macos_are_found_as_its_loader_does(tmp_path):
    good = ["@rpath/b.dylib", "@loader_path/../two/b.dylib", "/usr/lib/libSystem.B.dylib"]
    good += ["/System/Library/Frameworks/Metal.framework/Versions/A/Metal"]
    bad = ["@rpath/c.dylib", "@loader_path/b.dylib", "/opt/lib/libz.1.dylib"]
    files = {
        "one/a.dylib": macho(
            good + bad, ["@loader_path/none", "@loader_path/../two"], weak=["@rpath/d.dylib"]
        ),
        "two/b.dylib": macho(),
    }
    assert complaints(tmp_path, files, "macos-arm64") == [
        f"{name} is missing where one/a.dylib (one) would find it: in the zip, Blender or the system."
        for name in bad
    ]


def test_plugins_of_mitsuba_find_what_is_loaded_before_them(tmp_path):
    plugin = macho(
        ["@rpath/libmitsuba.dylib", "@rpath/libpng.dylib", "@rpath/libodd.dylib"], ["@loader_path"]
    )
    files = {
        "mitsuba/libmitsuba.dylib": macho(["@loader_path/libpng.dylib"], name="@rpath/libmitsuba.dylib"),
        "mitsuba/libpng.dylib": macho(name="@rpath/libpng.dylib"),
        "mitsuba/libodd.dylib": macho(name="@rpath/libodd.dylib"),
        **{f"mitsuba/plugins/{name}.dylib": plugin for name in "abc"},
    }
    (sentence,) = complaints(tmp_path, files, "macos-arm64")
    assert sentence.startswith(
        "@rpath/libodd.dylib is missing where mitsuba/plugins/a.dylib (mitsuba) and 2 more "
    )


def test_a_newer_macos_and_another_processor_are_named(tmp_path):
    files = {"one/a.dylib": macho(macos=14), "one/b.dylib": macho(processor=0x01000007)}
    assert complaints(tmp_path, files, "macos-arm64") == [
        "one/a.dylib (one) needs macOS 14.0.0, newer than 13.0.0.",
        "one/b.dylib (one) is for X86_64, not ARM64.",
    ]


def pe(imports=(), functions=("f",), processor="AMD64", windows=6, exports=("f",)):
    """A library for Windows, of its tables of imports and exports alone."""
    factory = lief.PE.Factory.create(lief.PE.PE_TYPE.PE32_PLUS)
    section = lief.PE.Section(".text")
    section.virtual_address = 0x1000
    factory.add_section(section)
    binary = factory.get()
    binary.header.machine = lief.PE.Header.MACHINE_TYPES.__dict__[processor]
    binary.optional_header.major_subsystem_version = windows
    for name in imports:
        library = binary.add_import(name)
        for function in functions:
            library.add_entry(function)
    exported = lief.PE.Export("any.dll", [])
    for function in exports:
        exported.add_entry(function, 0x1000)
    binary.set_export(exported)
    config = lief.PE.Builder.config_t()
    config.imports = config.exports = True
    return binary.write_to_bytes(config)


def test_libraries_of_windows_are_found_as_its_loader_does(tmp_path):
    imports = ["Near.dll", "far.dll", "KERNEL32.dll", "api-ms-win-crt-heap-l1-1-0.dll"]
    imports += ["python313.dll", "python311.dll", "VCOMP140.DLL", "MSVCP140.dll", "elsewhere.dll"]
    files = {
        "scipy/__init__.py": "libs_dir = os.path.join(os.pardir, 'scipy.libs')\nos.add_dll_directory(libs_dir)\n",
        "scipy/a.cp313-win_amd64.pyd": pe(imports),
        "scipy/near.DLL": pe(),
        "scipy.libs/far.dll": pe(),
        "other/elsewhere.dll": pe(),
    }
    assert complaints(tmp_path, files, "windows-x64") == [
        f"{name} is missing where scipy/a.cp313-win_amd64.pyd (scipy) would find it: in the zip, Blender or the system."
        for name in ("python311.dll", "vcomp140.dll", "msvcp140.dll", "elsewhere.dll")
    ]


def test_mitsuba_on_windows_finds_what_drjit_loads(tmp_path):
    files = {
        "drjit/_drjit_ext.cp313-win_amd64.pyd": pe(["drjit-core.dll"]),
        "drjit/drjit-core.dll": pe(),
        "drjit/odd.dll": pe(),
        "mitsuba/mitsuba.dll": pe(["drjit-core.dll", "odd.dll"]),
        "mitsuba/plugins/path.dll": pe(["mitsuba.dll", "drjit-core.dll"]),
    }
    (sentence,) = complaints(tmp_path, files, "windows-x64")
    assert sentence.startswith("odd.dll is missing where mitsuba/mitsuba.dll (mitsuba) would find it")


def test_another_processor_python_and_windows_are_named(tmp_path):
    files = {
        "one/a.cp311-win_amd64.pyd": pe(),
        "one/b.dll": pe(processor="ARM64"),
        "one/c.dll": pe(windows=10),
    }
    assert complaints(tmp_path, files, "windows-x64") == [
        "one/a.cp311-win_amd64.pyd (one) is not a module for Python 3.13 on windows-x64.",
        "one/b.dll (one) is for ARM64, not AMD64.",
        "one/c.dll (one) needs Windows 10.0, newer than 6.3.",
    ]


def test_functions_that_a_library_of_windows_lacks_are_named(tmp_path):
    """Of one in the zip, and of the compiler's runtime as it was in 2021."""
    files = {
        "one/a.dll": pe(["b.dll", "VCRUNTIME140.dll"], ["memcpy", "_CxxThrowException", "memccpy"]),
        "one/b.dll": pe(exports=["memcpy", "memccpy"]),
    }
    assert complaints(tmp_path, files, "windows-x64") == [
        "b.dll lacks what one/a.dll (one) imports from it: _CxxThrowException.",
        "vcruntime140.dll lacks what one/a.dll (one) imports from it: memccpy.",
    ]


def test_objects_stay_in_one_cpp_library(tmp_path):
    """What imports nothing of each other may have two: SciPy brings one of its own."""
    library = pe(exports=[CPP_LIBRARY, "f"])
    files = {
        "drjit/_drjit_ext.cp313-win_amd64.pyd": pe(["drjit-core.dll"]),
        "drjit/drjit-core.dll": pe(["cpp12345.dll"]),
        "drjit/cpp12345.dll": library,
        "mitsuba/mitsuba.dll": pe(["drjit-core.dll", "cpp12345.dll"]),  # Dr.Jit's, which is in memory
        "other/c.dll": pe(["cpp67890.dll"]),
        "other/cpp67890.dll": library,
    }
    assert complaints(tmp_path / "good", files, "windows-x64") == []
    bad = files | {
        "mitsuba/mitsuba.dll": pe(["drjit-core.dll", "cpp67890.dll"]),
        "mitsuba/cpp67890.dll": library,
    }
    assert complaints(tmp_path / "bad", bad, "windows-x64") == [
        "mitsuba/mitsuba.dll (mitsuba) takes cpp67890.dll, and drjit/drjit-core.dll, which it imports, cpp12345.dll: "
        "objects of one C++ library are unknown to another."
    ]


def test_one_name_is_one_cpp_library(tmp_path):
    files = {f"{n}/cpp12345.dll": pe(exports=[CPP_LIBRARY, "f", n]) for n in ("drjit", "holopath_llvm")}
    assert complaints(tmp_path, files, "windows-x64") == [
        "cpp12345.dll is two different files: Windows takes for one what is in memory of the other."
    ]
