"""The CUDA kernels compiled for GPUs, by the compiler that compiles them on a user's machine; it needs no GPU."""

import ctypes
from importlib import metadata
from pathlib import Path

import pytest

from drsplat.kernels.cuda.engine import MODULES, source_of

GPUS = ("sm_75", "sm_86", "sm_90", "sm_120")  # from the oldest that NVRTC 13 knows to the newest
PACKAGES = ("nvidia-cuda-nvrtc-cu12", "nvidia-cuda-nvrtc")


@pytest.fixture(scope="module")
def nvrtc() -> ctypes.CDLL:
    for package in PACKAGES:
        try:
            files = [Path(str(file.locate())) for file in metadata.files(package) or []]
        except metadata.PackageNotFoundError:
            continue
        libraries = {file.name.split(".")[0]: file for file in files if ".alt." not in file.name and ".so" in file.name}
        ctypes.CDLL(str(libraries["libnvrtc-builtins"]))  # which the compiler looks for by its name alone
        return ctypes.CDLL(str(libraries["libnvrtc"]))
    pytest.skip(f"needs NVRTC: pip install {PACKAGES[0]}")


def log_of(nvrtc: ctypes.CDLL, program: ctypes.c_void_p) -> str:
    size = ctypes.c_size_t()
    nvrtc.nvrtcGetProgramLogSize(program, ctypes.byref(size))
    log = ctypes.create_string_buffer(size.value)
    nvrtc.nvrtcGetProgramLog(program, log)
    return log.value.decode()


@pytest.mark.parametrize("gpu", GPUS)
@pytest.mark.parametrize("module", MODULES)
def test_every_module_compiles_for_every_gpu(nvrtc, module, gpu):
    program = ctypes.c_void_p()
    nvrtc.nvrtcCreateProgram(ctypes.byref(program), source_of(module).encode(), b"drsplat.cu", 0, None, None)
    options = [f"--gpu-architecture={gpu}".encode(), b"-std=c++17"]
    failed = nvrtc.nvrtcCompileProgram(program, len(options), (ctypes.c_char_p * len(options))(*options))
    assert not failed, log_of(nvrtc, program)


def test_a_mistake_is_seen(nvrtc):
    program = ctypes.c_void_p()
    nvrtc.nvrtcCreateProgram(ctypes.byref(program), b"int f() { return g(); }", b"wrong.cu", 0, None, None)
    assert nvrtc.nvrtcCompileProgram(program, 0, None)
    assert "g" in log_of(nvrtc, program)
