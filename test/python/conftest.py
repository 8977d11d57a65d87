"""Fixtures and options that all tests share."""

import os
import random
import shutil
import signal
import tempfile
import time

import pytest
import tai as ti

import device_lists
import device_tensors
import layout_lists
import layouts

# Programs in the background may have been started with Ctrl-C ignored, which those that tests start
# would inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests of kernels that run on every layout in the normal run, too.
ON_EVERY_LAYOUT = {
    "test_atomic_gradients",
    "test_infinite_adjoints",
    "test_matrices",
    "test_random_programs",
    "test_semantics_calls",
    "test_semantics_overwriting",
    "test_stress_loops",
    "test_ties",
}


def pytest_addoption(parser):
    parser.addoption(
        "--layout", action="append", choices=[*layouts.LAYOUTS, *layouts.LAZY],
        help="run each test with its fields on this layout; may be given many times",
    )  # fmt: skip
    parser.addoption(
        "--arch", choices=["cpu", "cuda", "emulated", "python"],
        default=os.environ.get("TAI_TEST_ARCH"),
        help="run each test there, programs that it starts included; emulated: as on a GPU, "
        "without one; python: by the interpreter",
    )  # fmt: skip
    parser.addoption(
        "--stop-after", type=float, metavar="SECONDS",
        help="start no test after that long; the process ends as it always does",
    )  # fmt: skip
    parser.addoption(
        "--long", action="store_true", help="larger sizes and all ways in test_differential.py"
    )
    parser.addoption(
        "--shuffle", type=int, metavar="SEED",
        help="run the tests in another order: none may depend on what ran before",
    )  # fmt: skip
    parser.addoption(
        "--quick", action="store_true",
        help="of each file, the first test that is not marked as slow: `make check`",
    )  # fmt: skip
    parser.addoption(
        "--part", metavar="K/N",
        help="run each Nth of the chosen tests, from the Kth on (of 0 to N - 1)",
    )  # fmt: skip


START = time.monotonic()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item, nextitem):
    seconds = item.config.getoption("--stop-after")
    if seconds and time.monotonic() - START > seconds:
        item.session.shouldstop = f"{seconds:.0f} seconds are over"


# The folder of compiled kernels that this process made, for its workers as well.
CACHE = pytest.StashKey[str]()


def pytest_configure(config):
    # A program that keeps its first kernel looks through the whole folder: in the user's own one,
    # that may take a tenth of a second in each test.
    if "TAI_CACHE_DIR" not in os.environ:
        os.environ["TAI_CACHE_DIR"] = config.stash[CACHE] = tempfile.mkdtemp(prefix="tai-tests-")
    # Windows are opened by tests with a display of their own (xvfb.py), and by no others.
    os.environ.pop("DISPLAY", None)
    os.environ.pop("WAYLAND_DISPLAY", None)
    # The verifiers of MLIR and LLVM check the IR after each pass.
    os.environ.setdefault("TAI_VERIFY_EACH", "1")
    arch = config.getoption("--arch")
    if arch:
        # `ti.init` looks here first.
        os.environ["TI_ARCH"] = "cuda" if arch == "emulated" else arch
        os.environ["TAI_CUDA_EMULATION"] = "1" if arch == "emulated" else ""
    # JAX computes where the kernels do, and leaves GPU memory to the other workers.
    if arch != "cuda":
        os.environ.setdefault("JAX_PLATFORMS", "cpu")
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Leaves out, on a GPU, tests of views by NumPy, and without git, those that ask it."""
    try:
        return (yield)
    except FileNotFoundError as error:
        if error.filename != "git":
            raise
        pytest.skip("needs git")
    except BufferError as error:
        if "on the GPU, where NumPy has no arrays" not in str(error):
            raise
        pytest.skip("NumPy has no arrays of a GPU")


def pytest_unconfigure(config):
    if folder := config.stash.get(CACHE, None):
        del os.environ["TAI_CACHE_DIR"]
        shutil.rmtree(folder, ignore_errors=True)


def _choose_for_device(config, items):
    """Leaves out tests for which one run suffices, and marks tests that are known to fail on a
    device."""
    wrong = device_lists.missing({item.module.__name__: item.module for item in items})
    if wrong:
        raise pytest.UsageError(f"device_lists.py lists what is not there: {', '.join(wrong)}")
    once = [item for item in items if device_lists.reason(device_lists.ONE_RUN_DOES, item)]
    if once:
        config.hook.pytest_deselected(items=once)
        items[:] = [item for item in items if item not in set(once)]
    on_gpu = os.environ.get("TAI_CUDA_EMULATION") != "1"
    for item in items:
        reason = device_lists.reason(device_lists.FAILS_ON_A_DEVICE, item)
        if reason:
            item.add_marker(pytest.mark.xfail(reason=reason, strict=True))
        reason = device_lists.reason(device_lists.NOT_RUN_ON_A_GPU, item)
        if reason and on_gpu:
            item.add_marker(pytest.mark.xfail(reason=reason, run=False))


def pytest_generate_tests(metafunc):
    if "layout" not in metafunc.fixturenames:
        return
    chosen = metafunc.config.getoption("--layout")
    if not chosen and metafunc.module.__name__ in ON_EVERY_LAYOUT:
        chosen = layouts.LAYOUTS
    name = metafunc.module.__name__
    if name in layout_lists.ABOUT_LAYOUTS or name.startswith("test_sparse"):
        chosen = None
    if name in layout_lists.DENSE_FILES:
        chosen = None
    if metafunc.function.__name__ in layout_lists.DENSE_ALONE.get(name, ()):
        chosen = None
    if chosen:
        metafunc.parametrize("layout", chosen, indirect=True)


def pytest_collection_modifyitems(config, items):
    wrong = layout_lists.missing({item.module.__name__: item.module for item in items})
    if wrong:
        raise pytest.UsageError(f"layout_lists.py lists what is not there: {', '.join(wrong)}")
    if os.environ.get("TI_ARCH") == "cuda":
        _choose_for_device(config, items)
    if config.getoption("--layout"):
        items[:] = [item for item in items if "layout" in getattr(item, "callspec", _NONE).params]
    if config.getoption("--quick"):
        files: dict = {}
        for item in items:
            if not item.get_closest_marker("slow"):
                files.setdefault(item.path, item)
        items[:] = files.values()
    if (seed := config.getoption("--shuffle")) is not None:
        random.Random(seed).shuffle(items)
    if part := config.getoption("--part"):
        first, count = map(int, part.split("/"))
        items[:] = items[first::count]


def pytest_report_collectionfinish(config, items):
    return f"{len(items)} tests chosen" if config.getoption("--part") else None


class _NONE:
    params: tuple = ()


@pytest.fixture
def layout(request):
    """The name of the layout that dense levels at the root have in this test."""
    name = getattr(request, "param", "dense")
    with layouts.below(name):
        yield name


@pytest.fixture(autouse=True)
def fresh_program(layout):
    """Each test starts with no fields and the default options."""
    ti.init(arch=ti.cpu, offline_cache=False)
    yield
    ti.reset()


@pytest.fixture
def library(monkeypatch):
    """The library that has tensors of the GPU: torch, or a stand-in."""
    made = device_tensors.open_library(monkeypatch)
    if made is None:
        pytest.skip("needs torch")
    yield made
    made.close()


@pytest.fixture
def slow_calls(monkeypatch):
    """How often launches went through Python."""
    return device_tensors.count_slow_calls(monkeypatch)
