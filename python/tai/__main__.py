"""The command line of the package: `python -m tai`."""

from __future__ import annotations

import argparse
import runpy
import sys
from pathlib import Path

from . import about, doctor

_COMMANDS = {
    "info": "the versions, the machine and the libraries, for a report of a bug (--json)",
    "doctor": "check that tai works on this machine",
    "view": "run a program and show its pictures in a window",
    "paper": "run the experiments of the DiffTaichi paper again (in a checkout)",
}


def _run_paper(options: list[str]) -> int:
    """Runs the package `paper` of the folder of examples, which an installed package lacks."""
    folders = [Path(__file__).resolve().parents[2] / "examples", Path.cwd() / "examples"]
    for option, value in zip(options, [*options[1:], ""], strict=True):
        name, _, joined = option.partition("=")
        if name == "--examples":
            folders.append(Path(joined or value))
    for folder in folders:
        if (folder / "paper" / "__main__.py").is_file():
            sys.path.insert(0, str(folder.resolve()))
            sys.argv = ["python -m tai paper", *options]
            runpy.run_module("paper", run_name="__main__", alter_sys=True)
            return 0
    print(
        f"paper: {folders[-1]} has no folder 'paper': name the folder 'examples' of a checkout "
        "by --examples",
        file=sys.stderr,
    )
    return 2


def main() -> int:
    """Runs the command that the command line names."""
    listed = "\n".join(f"  {name:<8} {text}" for name, text in _COMMANDS.items())
    parser = argparse.ArgumentParser(
        prog="python -m tai",
        description="tai: differentiable simulation, compiled",
        epilog=f"commands:\n{listed}\n\n`python -m tai COMMAND --help` lists the options of one.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="the versions of tai and LLVM")
    parser.add_argument("command", nargs="?", choices=_COMMANDS, metavar="COMMAND")
    # The command's own options stay with the command, whatever they are called.
    at = next((i for i, word in enumerate(sys.argv[1:], 1) if not word.startswith("-")), None)
    own, rest = (sys.argv[1:], []) if at is None else (sys.argv[1 : at + 1], sys.argv[at + 1 :])
    args = parser.parse_args(own)
    if args.version:
        print(about.version_line())
        return 0
    if args.command is None:
        parser.print_help()
        return 2
    if args.command == "view":
        sys.argv = ["python -m tai.view", *rest]
        runpy.run_module("tai.view", run_name="__main__", alter_sys=True)
        return 0
    if args.command == "paper":
        return _run_paper(rest)
    own_parser = argparse.ArgumentParser(
        prog=f"python -m tai {args.command}", description=_COMMANDS[args.command]
    )
    if args.command == "doctor":
        own_parser.parse_args(rest)
        return doctor.main()
    own_parser.add_argument("--json", action="store_true", help="for programs")
    found = about.info()
    print(found.to_json() if own_parser.parse_args(rest).json else found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
