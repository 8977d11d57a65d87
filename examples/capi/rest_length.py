"""A rest length found by gradient descent, through the C API and ctypes alone.

    python rest_length.py libtai.so rest_length.mlir

Python's own interface is the package `tai`. A language without bindings declares the types of the
functions that it calls, as this program does.
"""

import ctypes
import sys
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_int64, c_uint64, c_void_p


class Error(ctypes.Structure):
    """TaiError."""

    _fields_ = [
        ("status", c_int), ("message", c_char_p), ("file", c_char_p), ("line", c_int),
        ("column", c_int), ("diagnostics", c_char_p),
    ]  # fmt: skip


# The parameters of functions that return a TaiStatus; handles are pointers.
FUNCTIONS = {
    "taiProgramLoadFile": [c_void_p, c_char_p, POINTER(c_void_p)],
    "taiProgramGetKernel": [c_void_p, c_char_p, POINTER(c_void_p)],
    "taiContextFindField": [c_void_p, c_char_p, POINTER(c_void_p)],
    "taiFieldGetAdjoint": [c_void_p, POINTER(c_void_p)],
    "taiFieldWriteF64": [c_void_p, POINTER(c_int64), c_int64, c_double],
    "taiFieldReadF64": [c_void_p, POINTER(c_int64), c_int64, POINTER(c_double)],
    "taiTapeBegin": [c_void_p, c_void_p, c_bool, POINTER(c_void_p)],
    "taiTapeEnd": [c_void_p],
    "taiTapeBackward": [c_void_p],
    "taiKernelLaunch": [c_void_p, POINTER(c_uint64), c_int64, POINTER(c_uint64)],
}


def main(library: str, file: str) -> None:
    tai = ctypes.CDLL(library)
    tai.taiContextCreate.restype = c_void_p
    tai.taiContextLastError.argtypes, tai.taiContextLastError.restype = [c_void_p], Error
    tai.taiTapeDestroy.argtypes = tai.taiContextDestroy.argtypes = [c_void_p]
    for name, parameters in FUNCTIONS.items():
        getattr(tai, name).argtypes = parameters
    context = c_void_p(tai.taiContextCreate())

    def call(name: str, *args: object) -> None:
        if getattr(tai, name)(*args) != 0:
            sys.exit(tai.taiContextLastError(context).diagnostics.decode())

    def get(name: str, *args: object) -> c_void_p:
        handle = c_void_p()
        call(name, *args, byref(handle))
        return handle

    def read(field: c_void_p) -> float:
        value = c_double()
        call("taiFieldReadF64", field, None, 0, byref(value))
        return value.value

    program = get("taiProgramLoadFile", context, file.encode())
    swing = get("taiProgramGetKernel", program, b"swing")
    rest = get("taiContextFindField", context, b"rest")
    loss = get("taiContextFindField", context, b"loss")
    gradient = get("taiFieldGetAdjoint", rest)

    length = 1.0
    for _ in range(40):
        call("taiFieldWriteF64", rest, None, 0, length)
        tape = get("taiTapeBegin", context, loss, True)
        call("taiKernelLaunch", swing, None, 0, None)
        call("taiTapeEnd", tape)
        call("taiTapeBackward", tape)
        tai.taiTapeDestroy(tape)
        length -= 0.2 * read(gradient)
    print(f"rest length {length:.4f}, loss {read(loss):.1e}")
    tai.taiContextDestroy(context)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
