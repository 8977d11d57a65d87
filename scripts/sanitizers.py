"""The tests in the presets asan and tsan: which of them run, and their environment.

The Python interpreter is not built with a sanitizer, so it must preload the runtime (LD_PRELOAD),
as must the processes that tests start. Reports go to files and are counted, because a test may
discard the output of a process, and a process that is expected to fail may fail for the wrong
reason.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# Files of test/python that run with AddressSanitizer: those of kernels that make test repeats on
# the emulated device (EMULATED in run_tests.py), and those about memory that Python and the
# library share, hand over, or give back.
MEMORY = """
    array_overlaps changed_arrays custom_gradients exit field_copies fills half host_access_errors
    interop launches lifetimes sanitizer sparse_cells sparse_errors stored_outputs tensor_arguments
    tensor_tapes thread_tapes volumes
""".split()

# With ThreadSanitizer: those in which several threads run, or one and a clock.
THREADS = "device_threads interrupts launches running_launches thread_tapes waiting_calls".split()


@dataclass
class Sanitizer:
    """One of the presets."""

    name: str  # of the preset and of the run time
    kinds: list[str]  # of tests
    files: list[str]  # of test/python, without test_ and .py
    settings: dict[str, str]  # of the run time

    def options(self, reports: Path | None) -> str:
        settings = dict(self.settings)
        if reports:
            settings["log_path"] = str(reports / "report")
        return ":".join(f"{name}={value}" for name, value in settings.items())

    def environment(self, reports: Path | None) -> dict[str, str]:
        """For programs that were built with the sanitizer."""
        variables = {f"{self.name.upper()}_OPTIONS": self.options(reports)}
        if self.name == "asan":
            # Reports of undefined behaviour come with the place alone otherwise.
            variables["UBSAN_OPTIONS"] = "print_stacktrace=1"
            variables["LSAN_OPTIONS"] = f"suppressions={ROOT / 'test/lsan.supp'}:report_objects=0"
        return variables

    def python_environment(self, build: Path, reports: Path | None) -> dict[str, str]:
        """For interpreters, which know nothing of it, and all that they start."""
        loaded = [find_library(f"libclang_rt.{self.name}-x86_64.so")]
        if self.name == "asan":
            # It looks for what throws exceptions when it starts.
            loaded.append(find_library("libstdc++.so.6"))
        path = [str(build / "python"), *filter(None, [os.environ.get("PYTHONPATH")])]
        variables = self.environment(reports) | {
            "LD_PRELOAD": " ".join(loaded),
            "PYTHONPATH": os.pathsep.join(path),
            "TAI_BUILD_DIR": str(build),
        }
        if self.name == "asan":
            # Memory that CPython keeps to the end looks like leaks. Its own allocator hides objects
            # that are used after they are gone.
            variables["ASAN_OPTIONS"] += ":detect_leaks=0"
            variables["PYTHONMALLOC"] = "malloc"
            variables["TI_SANITIZE"] = "address"
        return variables


SANITIZERS = {
    "asan": Sanitizer(
        "asan",
        ["lit", "gtest", "pytest"],
        MEMORY,
        {
            # LLVM's allocators poison memory that the package's own, not instrumented, code then
            # uses.
            "allow_user_poisoning": "0",
            # Tests ask for 2**60 elements, of NumPy too, and expect to be refused.
            "allocator_may_return_null": "1",
        },
    ),
    "tsan": Sanitizer(
        "tsan",
        ["gtest", "pytest"],
        THREADS,
        {
            # Accesses by LLVM, CPython and NumPy are not seen, so that their calls of memcpy or
            # free do not show who else may use the memory. Locks count everywhere.
            "ignore_noninstrumented_modules": "1",
            "suppressions": str(ROOT / "test/tsan.supp"),
            # Options of a test that forks; a report does not end the process.
            "die_after_fork": "0",
            "exitcode": "0",
        },
    ),
}


def find_library(name: str) -> str:
    """The path of a library that clang links."""
    command = ["clang-22", f"-print-file-name={name}"]
    path = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    if not Path(path).is_absolute():
        raise SystemExit(f"{name} is missing: install libclang-rt-22-dev")
    return path


def find_reports(folder: Path) -> list[str]:
    """The first line of each report, and where the fault was seen."""
    found = []
    for path in sorted(folder.glob("report*")):
        text = path.read_text(errors="replace")
        for part in re.split(r"(?m)^(?==+$|==\d+==ERROR|WARNING: ThreadSanitizer)", text):
            first = re.search(r"(?m)^.*(?:(?:ERROR|WARNING): \w+Sanitizer|runtime error).*", part)
            if first and "Sanitizer failed to allocate" not in first[0]:
                summary = re.search(r"(?m)^SUMMARY: .*", part)
                found.append(summary[0] if summary else first[0])
    return found


if __name__ == "__main__":
    # Prints the environment of one test for a shell.
    chosen = SANITIZERS[sys.argv[1]]
    for name, value in chosen.python_environment(ROOT / f"build-{chosen.name}", None).items():
        print(f"export {name}={shlex.quote(value)}")
