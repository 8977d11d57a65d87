"""lit configuration: which files are tests, and which tools they call.

To run one test: `build/bin/tai-lit test/Dialect/Tai/ops.mlir`.
"""

# `config` and `lit_config` are given by lit.
# ruff: noqa: F821

import ctypes
import importlib.util
import os
import shutil

import lit.formats
from lit.llvm import llvm_config
from lit.llvm.subst import ToolSubst

config.name = "tai"
config.test_format = lit.formats.ShTest(execute_external=False)
config.suffixes = [".mlir", ".test"]
config.test_source_root = os.path.dirname(__file__)
config.test_exec_root = os.path.join(config.tai_build_dir, "test")
config.excludes = ["Inputs", "python", "unit", "fuzz", "CMakeLists.txt"]

llvm_config.with_system_environment(["HOME", "TMP", "TEMP", "CUDA_HOME", "CUDA_PATH", "CUDA_ROOT"])
llvm_config.use_default_substitutions()
# A variable without $ lives to the next label only, so that one function's
# capture cannot satisfy another's check.
config.environment["FILECHECK_OPTS"] = "-enable-var-scope --allow-unused-prefixes=false"

# The verifiers of MLIR and LLVM check the IR after each pass of the JIT.
config.environment["TAI_VERIFY_EACH"] = "1"

# LLVM's allocators poison memory that the package's own, not instrumented, code
# then uses.
if config.tai_sanitize:
    config.environment["ASAN_OPTIONS"] = "allow_user_poisoning=0"

# Compiled kernels of the tests stay out of the user's cache.
config.environment["TAI_CACHE_DIR"] = os.path.join(config.test_exec_root, "cache")

tai_tools = ["tai-opt", "tai-run", "tai-translate", "tai-lsp-server", "tai-reduce"]
tools = [ToolSubst(tool, unresolved="ignore") for tool in tai_tools]
tools += [
    ToolSubst("mlir-opt-22", os.path.join(config.llvm_tools_dir, "mlir-opt")),
    ToolSubst("split-file", os.path.join(config.llvm_tools_dir, "split-file")),
    ToolSubst("mlir-runner", os.path.join(config.llvm_tools_dir, "mlir-runner")),
    ToolSubst("mlir-translate-22", os.path.join(config.llvm_tools_dir, "mlir-translate")),
]
llvm_config.add_tool_substitutions(tools, [config.tai_tools_dir, config.llvm_tools_dir])
config.substitutions.append(("%tai_plugin", config.tai_plugin))
config.substitutions.append(("%tai_lib", config.tai_lib_dir))
config.substitutions.append(("%tai_build", config.tai_build_dir))
config.substitutions.append(("%llvm_lib", os.path.join(config.llvm_tools_dir, "..", "lib")))
config.substitutions.append(("%tai_src", config.tai_source_dir))
llvm_include = os.path.join(config.llvm_tools_dir, "..", "include")
config.substitutions.append(("%llvm_include", llvm_include))
config.substitutions.append(("%python", config.python_executable))

# A test that hangs fails; lit needs psutil to end its processes.
if importlib.util.find_spec("psutil"):
    lit_config.maxIndividualTestTime = 300

# Features, for REQUIRES lines.
# A stock mlir-opt cannot load a plugin that needs a sanitizer.
if os.path.exists(config.tai_plugin) and not config.tai_sanitize:
    config.available_features.add("plugin")
for tool in tai_tools:
    if os.path.exists(os.path.join(config.tai_tools_dir, tool)):
        config.available_features.add(tool)
# Nor can an interpreter, as long as nothing loads the run time into it.
if config.tai_python and not config.tai_sanitize:
    config.available_features.add("python")
if config.tai_sanitize:
    config.available_features.add("sanitizer")

# Parts of the CUDA toolkit, which no test machine must have.
toolkits = [os.environ.get(name) for name in ("CUDA_HOME", "CUDA_PATH", "CUDA_ROOT")]
toolkits = [root for root in toolkits if root] + ["/usr/local/cuda"]
ptxas = shutil.which(
    "ptxas", path=os.pathsep.join([os.path.join(root, "bin") for root in toolkits])
) or shutil.which("ptxas")
if ptxas:
    config.available_features.add("ptxas")
    config.substitutions.append(("%ptxas", ptxas))
else:
    lit_config.note("no ptxas in CUDA_HOME or PATH: PTX is not assembled by any test")
rustc = shutil.which("rustc")
if rustc:
    config.available_features.add("rustc")
    config.substitutions.append(("%rustc", rustc))
else:
    lit_config.note("no rustc in PATH: the C API is not called from Rust")
if any(os.path.exists(f"{root}/nvvm/libdevice/libdevice.10.bc") for root in toolkits):
    config.available_features.add("libdevice")
else:
    lit_config.note("no libdevice in CUDA_HOME: math functions on a GPU are not tested")


def has_gpu() -> bool:
    """Returns whether the CUDA driver opens and sees a device."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    count = ctypes.c_int(0)
    return driver.cuInit(0) == 0 and driver.cuDeviceGetCount(ctypes.byref(count)) == 0 and count


if has_gpu():
    config.available_features.add("cuda")
