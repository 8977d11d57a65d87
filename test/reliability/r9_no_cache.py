"""R9: a cache that cannot be used, or must not be, costs time and a warning, and nothing else.

Each case is a state of the disk or of the environment. A program that begins in it must get the
right numbers, and report the fault of the cache once, or not at all if there is none. If others
could put code into the folder, nothing in it is read or written.
"""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cold_kernels
from bars import Bar

KERNELS = 2
NOBODY = 65534


@dataclass
class State:
    """The state of the disk that a case has made.

    Attributes:
        cache: the folder that the program is told to use; None: the one below HOME.
        says: a word of the one warning; "" where there is to be none.
        uses: whether the cache serves a second run.
        untouched: a folder of which nothing may be read or written.
        prepare: actions of the process before all others.
    """

    cache: Path | None
    says: str = ""
    uses: bool = False
    untouched: Path | None = None
    prepare: list[Callable[[], None]] = field(default_factory=list)


def become_nobody() -> None:
    """Root may write everywhere. Modules imported later by Python may be out of reach."""
    if os.getuid() == 0:
        folder = os.environ.get("TAI_CACHE_DIR")
        os.environ["TAI_CACHE_DIR"] = ""
        cold_kernels.run_kernels(0, 1)
        os.environ.pop("TAI_CACHE_DIR")
        if folder is not None:
            os.environ["TAI_CACHE_DIR"] = folder
        os.setgroups([])
        os.setgid(NOBODY)
        os.setuid(NOBODY)


def give_away(folder: Path) -> None:
    if os.getuid() == 0:
        os.chown(folder, NOBODY, NOBODY)


@contextlib.contextmanager
def mounted(folder: Path, options: str) -> Iterator[bool]:
    """A small disk of its own at a folder; false where the user may not mount one."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder]
    good = os.getuid() == 0 and subprocess.run(command, capture_output=True).returncode == 0
    try:
        yield good
    finally:
        if good:
            subprocess.run(["umount", "-l", folder], check=True)


Case = Callable[[Path], Iterator[State]]
CASES: list[Case] = []


def case(function: Callable[[Path], Iterator[State]]):
    CASES.append(contextlib.contextmanager(function))
    return function


def shared(folder: Path) -> Path:
    """A folder with earlier compiled code, and good entries."""
    cache = folder / "cache"
    cold_kernels.run(0, KERNELS, cache)
    return cache


# Disks


@case
def full_disk(folder: Path) -> Iterator[State]:
    with mounted(folder / "disk", "size=16k,mode=700") as good:
        cache = folder / "disk/cache"
        if good:
            cache.mkdir(mode=0o700)
            with contextlib.suppress(OSError):
                (folder / "disk/rest").write_bytes(bytes(1 << 16))
        yield State(cache, "cannot write to the compile cache", prepare=[] if good else [no_room])


def no_room() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, 500))


@case
def files_have_a_limit(folder: Path) -> Iterator[State]:
    yield State(folder / "cache", "cannot write to the compile cache", prepare=[no_room])


@case
def no_file_can_be_made(folder: Path) -> Iterator[State]:
    """A disk without inodes."""
    with mounted(folder / "disk", "size=1m,nr_inodes=2,mode=700") as good:
        cache = folder / "disk/cache"
        if good:
            cache.mkdir(mode=0o700)
        yield State(cache, "cannot write to the compile cache", prepare=[] if good else [no_room])


@case
def read_only_disk(folder: Path) -> Iterator[State]:
    with mounted(folder / "disk", "mode=700") as good:
        cache = folder / "disk/cache"
        if good:
            cold_kernels.run(0, KERNELS, cache)
            command = ["mount", "-o", "remount,ro", folder / "disk"]
            subprocess.run(command, check=True, capture_output=True)
            yield State(cache, "is not used: Read-only file system")
        else:
            yield from read_only_folder(folder)


@case
def read_only_folder(folder: Path) -> Iterator[State]:
    cache = folder / "cache"
    cache.mkdir(mode=0o700)
    give_away(cache)
    cache.chmod(0o500)
    folder.chmod(0o755)
    yield State(cache, "is not used: Permission denied", prepare=[become_nobody])


# Homes


def at_home(home: str | None) -> Callable[[], None]:
    def prepare() -> None:
        for name in ("XDG_CACHE_HOME", "HOME"):
            os.environ.pop(name, None)
        if home is not None:
            os.environ["HOME"] = home

    return prepare


@case
def home_that_cannot_be_written(folder: Path) -> Iterator[State]:
    folder.chmod(0o755)
    home = folder / "home"
    home.mkdir(mode=0o555)
    yield State(None, "is not used: Permission denied", prepare=[at_home(str(home)), become_nobody])


@case
def home_that_is_not_there(folder: Path) -> Iterator[State]:
    folder.chmod(0o755)
    prepare = [at_home(str(folder / "none/home")), become_nobody]
    yield State(None, "is not used: Permission denied", prepare=prepare)


@case
def home_that_is_not_set(folder: Path) -> Iterator[State]:
    """That of the list of users stands in: nobody has none."""
    yield State(None, "is not used: Permission denied", prepare=[at_home(None), become_nobody])


@case
def home_that_is_a_file(folder: Path) -> Iterator[State]:
    (folder / "home").write_text("")
    yield State(None, "is not used: Not a directory", prepare=[at_home(str(folder / "home"))])


@case
def home_without_text(folder: Path) -> Iterator[State]:
    os.chdir(folder)
    yield State(None, "", uses=True, prepare=[at_home(""), lambda: os.chdir(folder)])


# Folders


@case
def link_of_my_own(folder: Path) -> Iterator[State]:
    (folder / "real").mkdir(mode=0o700)
    (folder / "cache").symlink_to(folder / "real")
    yield State(folder / "cache", uses=True)


@case
def link_of_another_user(folder: Path) -> Iterator[State]:
    cache = shared(folder)
    (folder / "link").symlink_to(cache)
    if os.getuid() != 0:
        folder.chmod(0o777)
        yield State(cache, "others may write", untouched=cache)
        return
    os.lchown(folder / "link", NOBODY, NOBODY)
    yield State(folder / "link", "a link that belongs to another user", untouched=cache)


@case
def link_to_nowhere(folder: Path) -> Iterator[State]:
    (folder / "cache").symlink_to(folder / "gone/for/good")
    yield State(folder / "cache", "is not used")


@case
def link_to_itself(folder: Path) -> Iterator[State]:
    (folder / "cache").symlink_to(folder / "cache")
    yield State(folder / "cache", "is not used: Too many levels of symbolic links")


@case
def everybody_may_write(folder: Path) -> Iterator[State]:
    cache = shared(folder)
    cache.chmod(0o777)
    yield State(cache, "others may write to it", untouched=cache)


@case
def group_may_write(folder: Path) -> Iterator[State]:
    cache = shared(folder)
    cache.chmod(0o770)
    yield State(cache, "others may write to it", untouched=cache)


@case
def everybody_may_write_above(folder: Path) -> Iterator[State]:
    cache = shared(folder)
    folder.chmod(0o777)
    yield State(cache, "above it", untouched=cache)


@case
def everybody_may_write_above_a_link(folder: Path) -> Iterator[State]:
    (folder / "open").mkdir()
    (folder / "open").chmod(0o777)
    cache = shared(folder / "open")
    (folder / "link").symlink_to(cache)
    yield State(folder / "link", "above it", untouched=cache)


@case
def link_that_everybody_may_turn(folder: Path) -> Iterator[State]:
    """Where it lies, anybody may put another; that is then no link of ours, and is refused."""
    cache = folder / "cache"
    cache.mkdir(mode=0o700)
    (folder / "open").mkdir()
    (folder / "open").chmod(0o777)
    (folder / "open/link").symlink_to(cache)
    yield State(folder / "open/link", uses=True)


@case
def folder_of_another_user(folder: Path) -> Iterator[State]:
    cache = shared(folder)
    if os.getuid() == 0:
        give_away(cache)
        yield State(cache, "belongs to another user", untouched=cache)
    else:
        yield State(Path("/"), "belongs to another user")


@case
def file_in_its_place(folder: Path) -> Iterator[State]:
    (folder / "cache").write_text("mine")
    yield State(folder / "cache", "is not used: Not a directory")


@case
def pipe_in_its_place(folder: Path) -> Iterator[State]:
    os.mkfifo(folder / "cache")
    yield State(folder / "cache", "is not used: Not a directory")


@case
def name_that_is_too_long(folder: Path) -> Iterator[State]:
    yield State(folder / ("x" * 300), "is not used: File name too long")


@case
def folder_that_goes(folder: Path) -> Iterator[State]:
    """Removed by somebody else while the program runs."""
    cache = shared(folder)
    begin = cold_kernels.ti.init

    def prepare() -> None:
        def init(**options):
            begin(**options)
            shutil.rmtree(cache)

        cold_kernels.ti.init = init

    yield State(cache, "cannot write to the compile cache", prepare=[prepare])


@case
def name_that_is_not_ascii(folder: Path) -> Iterator[State]:
    yield State(folder / "größe 緩存\n", uses=True)


def snapshot(folder: Path) -> dict[str, tuple]:
    return {
        path.name: (info.st_mtime_ns, info.st_atime_ns, info.st_size)
        for path in sorted(folder.iterdir())
        for info in [path.stat()]
    }


def judge(one: Case) -> list[str]:
    """The faults of a case."""
    problems = []
    with tempfile.TemporaryDirectory(prefix="tai-r9-") as name, one(Path(name)) as state:

        def prepare() -> None:
            for step in state.prepare:
                step()

        before = snapshot(state.untouched) if state.untouched else {}
        for turn in range(2):
            ended = cold_kernels.run(0, KERNELS, state.cache, prepare)
            if ended.problem:
                problems.append(ended.problem)
            warnings = ended.warnings
            if len(warnings) != int(bool(state.says)) or state.says not in "".join(warnings):
                problems.append(f"said {warnings}, not once '{state.says}'")
            if ended.hits and (turn == 0 or not state.uses):
                problems.append(f"{ended.hits} functions came from the cache")
            if turn == 1 and state.uses and ended.compiled:
                problems.append(f"{ended.compiled.total()} functions were compiled again")
        if state.untouched and snapshot(state.untouched) != before:
            problems.append(f"'{state.untouched}' was read or written")
    return problems


def main() -> None:
    bar = Bar(
        "R9", "disks and folders of no use", full=len(CASES), short=len(CASES) // 2,
        target="full, read-only, missing, linked, open to others: runs, warns once, refuses",
        miss="a case that fails, warns twice or never, or uses a folder that others may write",
    )  # fmt: skip
    bar.parser.add_argument("--only", help="the case of this name")
    args = bar.parse()
    chosen = [one for one in CASES if args.only in (None, one.__name__)]
    # Every so many, so that a short run has some of each kind.
    count = min(args.count, len(chosen))
    chosen = [chosen[(args.seed + i * len(chosen) // count) % len(chosen)] for i in range(count)]
    wrong = 0
    for one in chosen:
        if problems := judge(one):
            wrong += 1
            print(f"{one.__name__}: {'; '.join(problems)}", flush=True)
    how = "as root" if os.getuid() == 0 else "without root, where disks are limits of files"
    bar.report(f"{len(chosen)} cases {how}", f"{wrong} with errors", met=not wrong)


if __name__ == "__main__":
    main()
