"""A file that a program writes is the old one or the new one, whatever happens meanwhile."""

import os
import stat
import subprocess
import sys
import textwrap

import numpy as np
import pytest
import tai as ti
from tai._impl.base import files

# The child may write so many bytes to a file: a disk that is full after them.
ROOM = 1000

PRELUDE = f"""
import os, resource, signal, sys
import numpy as np
import tai as ti
ti.init(arch=ti.cpu, log_level=ti.ERROR)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
rng = np.random.default_rng(0)
noise = rng.random((64, 64, 3)).astype(np.float32)
def full():
    resource.setrlimit(resource.RLIMIT_FSIZE, ({ROOM}, resource.RLIM_INFINITY))
"""

VOLUME = """
x = ti.field(ti.f32)
ti.root.bitmasked(ti.i, 4096).place(x)
x.from_numpy(rng.random(4096).astype(np.float32))
full()
ti.volumes.save(path, x=x)
"""
IMAGE = "full()\nti.tools.imwrite(noise, path)"
FILM = "full()\nti.tools.write_gif([(noise * 255).astype(np.uint8)] * 3, path)"
FRAME = """
gui = ti.GUI("frame", res=(64, 64), show_gui=False)
gui.set_image(noise)
full()
gui.show(path)
"""
TRACE = """
ti.reset()
ti.init(arch=ti.cpu, log_level=ti.ERROR, kernel_profiler=True)
@ti.kernel
def run(): pass
for _ in range(100): run()
full()
ti.profiler.save_trace(path)
"""
TEXT = """
from tai._impl.base import files
full()
files.write_text(path, "a" * 5000)
"""

WRITERS = {
    "volume": ("x.npz", VOLUME),
    "image": ("x.png", IMAGE),
    "film": ("x.gif", FILM),
    "frame": ("x.png", FRAME),
    "trace": ("x.json", TRACE),
    "text": ("page.md", TEXT),
}


def run(tmp_path, name, body):
    """Runs a program with the variable `path`; its lines are not those of a file."""
    program = tmp_path / "program.py"
    program.write_text(f"path = {str(tmp_path / 'out' / name)!r}\n{PRELUDE}\n" + body)
    return subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize("writer", WRITERS)
def test_a_full_disk_leaves_the_file_that_was_there(tmp_path, writer):
    name, body = WRITERS[writer]
    (tmp_path / "out").mkdir()
    old = tmp_path / "out" / name
    old.write_bytes(b"the good one")
    done = run(tmp_path, name, body)
    assert done.returncode == 1, done.stderr
    assert "OSError" in done.stderr
    assert "File too large" in done.stderr, done.stderr
    assert old.read_bytes() == b"the good one"
    assert os.listdir(old.parent) == [name]


@pytest.mark.parametrize("writer", WRITERS)
def test_with_room_the_file_is_replaced(tmp_path, writer):
    name, body = WRITERS[writer]
    (tmp_path / "out").mkdir()
    old = tmp_path / "out" / name
    old.write_bytes(b"the good one")
    done = run(tmp_path, name, body.replace("full()", ""))
    assert done.returncode == 0, done.stderr
    assert len(old.read_bytes()) > ROOM
    assert os.listdir(old.parent) == [name]


def test_ctrl_c_in_the_middle_leaves_the_file_that_was_there(tmp_path):
    path = tmp_path / "x.bin"
    path.write_bytes(b"old")

    def write():
        with files.replacing(path) as stream:
            stream.write(b"half of the ne")
            raise KeyboardInterrupt

    pytest.raises(KeyboardInterrupt, write)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["x.bin"]


def test_permissions_and_links_stay(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_bytes(b"old")
    target.chmod(0o640)
    link.symlink_to("target")
    files.write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_a_new_file_has_the_permissions_that_open_gives(tmp_path):
    (tmp_path / "other").write_bytes(b"")
    files.write_text(tmp_path / "new", "new")
    modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("other", "new")}
    assert len(modes) == 1


def test_a_link_to_nothing_makes_its_target(tmp_path):
    (tmp_path / "link").symlink_to("target")
    files.write_text(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "new"


def test_pipes_and_devices_are_written_to(tmp_path):
    reader, writer = os.pipe()
    files.write_text(f"/proc/self/fd/{writer}", "through a pipe")
    os.close(writer)
    with os.fdopen(reader) as stream:
        assert stream.read() == "through a pipe"
    files.write_text("/dev/null", "nowhere")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


def test_errors_name_the_file_that_was_asked_for(tmp_path):
    with pytest.raises(FileNotFoundError) as error:
        files.write_text(tmp_path / "no" / "x.md", "text")
    assert error.value.filename == str(tmp_path / "no" / "x.md")
    with pytest.raises(IsADirectoryError):
        files.write_text(tmp_path, "text")


def test_an_unknown_format_of_pictures_leaves_the_file(tmp_path):
    path = tmp_path / "x.nope"
    path.write_bytes(b"old")
    with pytest.raises(ti.TaiRuntimeError, match=r"written to '.*x\.nope': the end of its name"):
        ti.tools.imwrite(np.zeros((2, 2)), str(path))
    assert path.read_bytes() == b"old"


def test_pictures_go_to_streams(tmp_path):
    with open(tmp_path / "x", "w+b") as stream:
        files.save_picture(_picture(), stream, format="png")
        stream.seek(0)
        assert stream.read(4) == b"\x89PNG"


def test_upper_case_suffixes_name_one_file(tmp_path):
    x = ti.field(ti.f32)
    ti.root.bitmasked(ti.i, 8).place(x)
    x[3] = 1
    ti.volumes.save(tmp_path / "x.NPZ", x=x)
    assert os.listdir(tmp_path) == ["x.NPZ"]
    ti.volumes.load(tmp_path / "x.NPZ", x=x)
    assert x[3] == 1


def test_a_file_that_nobody_may_write_stays(tmp_path):
    path = tmp_path / "x"
    path.write_bytes(b"old")
    path.chmod(0o444)
    tmp_path.chmod(0o777)
    program = f"""
        import os, sys
        from tai._impl.base import files
        os.chdir({str(tmp_path)!r})
        if os.geteuid() == 0:
            os.setuid(65534)
        try:
            files.write_text("x", "new")
        except PermissionError as error:
            sys.exit(7 if error.filename == "x" else 1)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, timeout=280,
        check=False,
    )  # fmt: skip
    assert path.read_bytes() == b"old"
    assert done.returncode == 7, done.stderr


def _picture():
    from PIL import Image

    return Image.fromarray(np.zeros((2, 2), np.uint8))
