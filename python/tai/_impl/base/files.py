"""Files of the user, each of which is whole at any time: the old one or the new one."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Container, Iterator
from typing import Any, BinaryIO

from ...errors import TaiRuntimeError

# Longer names of temporary files might be refused by the file system.
_LONGEST_SUFFIX = 32


@contextlib.contextmanager
def replacing_name(path: Any) -> Iterator[str]:
    """Gives the name of a temporary file that replaces the file `path` when the block ends without
    an exception.

    It is in the same folder, has the same suffix, and is renamed at the end: until then, and after
    a failure (a full disk, Ctrl-C), `path` is as it was. The file keeps its permissions, and a
    symbolic link stays one. A pipe or a device, and a file in a folder that takes no other ones,
    are written to directly.
    """
    found = _find(path)
    if found is not None and not stat.S_ISREG(found.st_mode):
        yield os.fspath(path)
        return
    target = os.path.realpath(os.fspath(path))
    if found is not None and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), os.fspath(path))
    part = _beside(target)
    try:
        # The umask of the process determines the permissions of a new file.
        number = os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    except OSError as error:
        if isinstance(error, PermissionError) and found is not None:
            yield target
            return
        raise type(error)(error.errno, error.strerror, os.fspath(path)) from None
    try:
        if found is not None:
            os.fchmod(number, stat.S_IMODE(found.st_mode))
        os.close(number)
        yield part
        _flush(part)
        os.replace(part, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(part)
        raise


@contextlib.contextmanager
def replacing(path: Any) -> Iterator[BinaryIO]:
    """Yields a stream whose bytes become the file `path`, replaced at once as by
    `replacing_name`.
    """
    with replacing_name(path) as name, open(name, "wb") as stream:
        yield stream


def write_text(path: Any, text: str) -> None:
    """Writes a text file, which is replaced at once as by `replacing_name`."""
    with replacing(path) as stream:
        stream.write(text.encode())


def save_picture(picture: Any, path: Any, **options: Any) -> None:
    """Saves a Pillow image to a stream, or to a file as with `replacing_name`.

    Raises:
        TaiRuntimeError: the name of the file ends in no known format.
    """
    if hasattr(path, "write"):
        picture.save(path, **options)
        return
    suffix = os.path.splitext(path)[1].lower()
    if "format" not in options and suffix not in _suffixes():
        raise TaiRuntimeError(
            f"the picture cannot be written to '{path}': the end of its name is no format",
            "write a .png or .jpg",
        )
    with replacing_name(path) as name:
        picture.save(name, **options)


def _suffixes() -> Container[str]:
    """The ends of names of files whose formats Pillow writes."""
    from PIL import Image

    Image.init()
    return {end for end, kind in Image.EXTENSION.items() if kind in Image.SAVE}


def _find(path: Any) -> os.stat_result | None:
    try:
        return os.stat(path)
    except OSError:
        return None


def _beside(target: str) -> str:
    folder, name = os.path.split(target)
    suffix = os.path.splitext(name)[1]
    suffix = suffix if len(suffix) <= _LONGEST_SUFFIX else ""
    return os.path.join(folder, f".tai-{secrets.token_hex(8)}{suffix}")


def _flush(name: str) -> None:
    """Flushes the bytes to the disk before the file is renamed, so that no crash leaves the new
    name with no content.
    """
    number = os.open(name, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(number)
    finally:
        os.close(number)
