"""Libraries with which HoloPath computes waves on an NVIDIA card: CuPy, and what it needs of CUDA.

Blender unpacks the packages, and shares them with HoloPath. CuPy looks for NVIDIA's libraries and headers in the
folders of Python and of the system, and these are in neither. So libraries are loaded by their paths, after which their
names are enough, and the finder of headers is shown where they are once, for it remembers.
"""

import ctypes
import os
import sys
from pathlib import Path

# In this order: the first ones are imported by those that follow.
LIBRARIES = (
    "cupy_backends/cpp*.dll",
    "nvidia/cuda_nvrtc/bin/nvrtc-builtins64_*[0-9].dll",
    "nvidia/cuda_nvrtc/bin/nvrtc64_*_0.dll",
    "nvidia/nvjitlink/bin/nvJitLink_*_0.dll",
    "nvidia/cufft/bin/cufft64_*.dll",
    "nvidia/cuda_nvrtc/lib/libnvrtc-builtins.so.*",
    "nvidia/cuda_nvrtc/lib/libnvrtc.so.*",
    "nvidia/nvjitlink/lib/libnvJitLink.so.*",
    "nvidia/cufft/lib/libcufft.so.*",
)
HEADERS = "nvidia/cuda_runtime/include"
FINDS = "CUDA_PATH", "CUDA_HOME"  # where the finder looks
_loaded: list = []


def found(name: str) -> list[Path]:
    """Files or folders that match a name, in the folders that Python imports from."""
    folders = [Path(folder) for folder in dict.fromkeys(sys.path) if os.path.isabs(folder)]
    return [path for folder in folders for path in sorted(folder.glob(name))]


def show_headers() -> None:
    """Have CuPy 14 find CUDA's headers, and none of another CUDA; CuPy 13 finds them by itself."""
    try:
        from cuda.pathfinder import find_nvidia_header_directory
    except ImportError:
        return
    before = {name: os.environ.pop(name, None) for name in FINDS}
    try:
        for folder in found(HEADERS)[:1]:
            os.environ[FINDS[0]] = str(folder.parent)
            find_nvidia_header_directory("cudart")
    finally:
        os.environ.pop(FINDS[0], None)
        os.environ.update({name: value for name, value in before.items() if value is not None})


def register() -> None:
    """Load the libraries, which takes no card, and show the headers."""
    _loaded[:] = [ctypes.CDLL(str(path)) for name in LIBRARIES for path in found(name)]
    show_headers()


def unregister() -> None:
    """Nothing to undo: a library that CuPy uses cannot be taken out of memory."""
