"""Compares passes on kernels with the same passes on the module.

A pass that is declared for no op in particular looks at one kernel only, so it gives the same on
the module, on each kernel, and on each kernel with one thread. On the module, `tai-lower-layout`
lists in the alias scopes of an access those of the kernels before it.

    compare_nested.py TAI_OPT FILE TD...
"""

import re
import subprocess
import sys
from pathlib import Path


def run(tai_opt: str, path: str, pipeline: str, *options: str) -> str:
    command = [tai_opt, path, f"--pass-pipeline=builtin.module({pipeline})", *options]
    made = subprocess.run(command, capture_output=True, text=True)
    if made.returncode:
        sys.exit(f"{pipeline} {options}: {made.returncode}\n{made.stderr[:2000]}")
    return made.stdout


def main() -> None:
    tai_opt, path, *files = sys.argv[1:]
    passes = [
        name for file in files for name in re.findall(r': Pass<"([\w-]+)">', Path(file).read_text())
    ]
    changed = 0
    for name in passes:
        whole = run(tai_opt, path, name)
        nested = f"tai.kernel({name})"
        parallel = run(tai_opt, path, nested)
        if run(tai_opt, path, nested, "--mlir-disable-threading") != parallel:
            sys.exit(f"{name}: another result on one thread")
        if parallel != whole and name != "tai-lower-layout":
            sys.exit(f"{name}: another result on kernels")
        changed += whole != run(tai_opt, path, "")
    print(f"{len(passes)} passes on kernels: no difference, {changed} of them change something")


if __name__ == "__main__":
    main()
