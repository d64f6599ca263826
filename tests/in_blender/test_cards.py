"""HoloPath for NVIDIA Cards in a real Blender: its libraries are found and work as far as they do without a card."""

import os

import pytest

from distribution import extension
from distribution.wheels import CARD, ONLY_FOR, this_platform
from tests.in_blender.conftest import BLENDER
from tests.real_blender import Blender, python_of

pytestmark = [pytest.mark.blender, pytest.mark.slow]

# What CuPy does before it uses a card: a kernel of complex numbers is compiled, with its headers and CUDA's.
COMPILE = """
from importlib.metadata import distribution
from pathlib import Path
import cupy
from cupy.cuda import cufft
from cupy_backends.cuda.libs import nvrtc
try:
    from cuda.pathfinder import find_nvidia_header_directory
    headers = find_nvidia_header_directory("cudart")
except ImportError:  # CuPy 13 asks for the package
    headers = distribution("nvidia-cuda-runtime-cu12").locate_file("nvidia/cuda_runtime/include")
own = Path(cupy.__file__).parent / "_core" / "include"
folders = [own, *(own / "cupy" / "_cccl" / name for name in ("libcudacxx", "thrust", "cub")), headers]
source = '''
#include <cupy/complex.cuh>
#include <cuda_fp16.h>
extern "C" __global__ void twice(complex<float>* waves) { waves[threadIdx.x] *= 2.0f; }
'''
program = nvrtc.createProgram(source, "twice.cu", (), ())
nvrtc.compileProgram(program, [*(f"-I{folder}" for folder in folders), "-arch=sm_90", "-std=c++17"])
print("compiled", len(nvrtc.getCUBIN(program)) > 1000, cufft.__name__)
"""


@pytest.mark.skipif("HOLOPATH_CARD_ZIP" not in os.environ, reason="loads 0.5 GB: set HOLOPATH_CARD_ZIP=1")
@pytest.mark.skipif(this_platform() not in ONLY_FOR[f"{CARD}3.13"], reason="there are no such cards for it")
def test_libraries_for_cards_are_found(tmp_path):
    blender = Blender(tmp_path / "user", [BLENDER])
    python = python_of(blender)
    ((target, _),) = extension.build_for_cards([this_platform()], [python], tmp_path)
    status, output = blender("--command", "extension", "install-file", "-r", "user_default", "-e", target)
    assert status == 0, output
    status, output = blender("--background", "--python-exit-code", "3", "--python-expr", COMPILE)
    assert status == 0 and "compiled True cupy.cuda.cufft" in output, output
