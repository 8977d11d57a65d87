"""Tensors on a GPU for tests: those of torch where it has one, else stand-ins.

A stand-in has its memory on the emulated device, and has the attributes of a tensor of torch. Its
library works late: when somebody waits for its stream. If tai does not wait for it, the results are
wrong.
"""

import ctypes
import os

import numpy as np
import tai as ti
from tai import _core
from tai._impl.base.program import get_program
from tai._impl.interop import streams
from tai._impl.launch import kernels

ON_GPU = os.environ.get("TI_ARCH") == "cuda" and os.environ.get("TAI_CUDA_EMULATION") != "1"


def find_torch():
    """torch if it works on a GPU that the tests run on, or None."""
    if not ON_GPU:
        return None
    try:
        import torch
    except ImportError:
        return None
    return torch if torch.cuda.is_available() else None


class Stream:
    """A queue of work that is done when somebody waits for it."""

    def __init__(self):
        self._pending = []
        self.told = 0  # how often it was told that the device has come so far
        self._function = ctypes.CFUNCTYPE(None, ctypes.c_int32)(self._tell)
        self.address = ctypes.cast(self._function, ctypes.c_void_p).value

    def do(self, work):
        self._pending.append(work)

    def synchronize(self):
        pending, self._pending = self._pending, []
        for work in pending:
            work()

    def _tell(self, what):
        if what == 0:
            self.synchronize()
        else:
            self.told += 1


class _Device:
    def __init__(self, index):
        self.index = index


class Tensor:
    """The attributes of a tensor of torch that kernels read."""

    is_cuda = True

    def __init__(self, library, host, memory, requires_grad=False, version=None, index=0):
        self._library, self._host, self._memory = library, host, memory
        self._counter = [0] if version is None else version
        self.requires_grad, self.grad = requires_grad, None
        self.device = _Device(index)
        self.shape, self.dtype = host.shape, f"torch.{host.dtype}"

    @property
    def _version(self):
        return self._counter[0]

    def data_ptr(self):
        return self._host.ctypes.data if self._host.size else 0

    def stride(self):
        return tuple(step // self._host.itemsize for step in self._host.strides)

    def is_contiguous(self):
        return self._host.flags.c_contiguous

    def detach(self):
        made = Tensor(
            self._library, self._host, self._memory, version=self._counter, index=self.device.index
        )
        made.dtype = self.dtype
        return made

    def new_zeros(self, shape):
        return self._library.tensor(np.zeros(shape, self._host.dtype))

    def __getitem__(self, key):
        return Tensor(self._library, self._host[key], self._memory, version=self._counter)

    def _write(self, work):
        self._counter[0] += 1
        self._library.stream.do(work)
        return self

    def copy_(self, values):
        if isinstance(values, Tensor):
            return self._write(lambda: np.copyto(self._host, values._host))
        return self._write(lambda: np.copyto(self._host, np.asarray(values)))

    def zero_(self):
        return self._write(lambda: self._host.fill(0))

    def add_(self, amount):
        return self._write(lambda: np.add(self._host, amount, out=self._host))


class StandIns:
    """The library of stand-ins."""

    torch = None

    def __init__(self):
        self.stream = Stream()
        self._before = streams.set_current_stream(lambda device: self.stream.address)

    def close(self):
        streams.set_current_stream(self._before)

    def tensor(self, values, requires_grad=False, index=0):
        values = np.asarray(values)
        memory = _core.DeviceMemory(get_program().context, values.nbytes)
        # The emulated device's memory can be read here.
        raw = (ctypes.c_char * max(values.nbytes, 1)).from_address(memory.address)
        host = np.frombuffer(raw, values.dtype, values.size).reshape(values.shape)
        made = Tensor(self, host, memory, requires_grad, index=index)
        kept = values.copy()
        # The stream keeps the memory, whoever drops the tensor before it is done.
        self.stream.do(lambda memory=memory: np.copyto(host, kept))
        return made

    def numpy(self, tensor):
        self.stream.synchronize()
        return tensor._host.copy()

    def parts(self):
        """How often the stream was told to go on."""
        return self.stream.told


class Torch:
    """The same by torch itself."""

    def __init__(self, torch):
        self.torch = torch
        self._context = torch.cuda.stream(torch.cuda.Stream())
        self._context.__enter__()

    def close(self):
        self.torch.cuda.synchronize()
        self._context.__exit__(None, None, None)

    def tensor(self, values, requires_grad=False, index=0):
        # Late, as the stand-ins are.
        late = self.torch.zeros(1 << 20, device="cuda")
        for _ in range(30):
            late += 1
        made = self.torch.tensor(np.asarray(values), device=f"cuda:{index}")
        return made.requires_grad_(requires_grad)

    def numpy(self, tensor):
        return tensor.detach().cpu().numpy()

    def parts(self):
        return None


def open_library(monkeypatch):
    """Tensors for the device that the tests run on, an emulated one if there is no other.

    Returns None on a GPU without torch.
    """
    torch = find_torch()
    if torch is not None:
        ti.init(arch=ti.cuda, offline_cache=False)
        return Torch(torch)
    if ON_GPU:
        return None
    monkeypatch.setenv("TI_ARCH", "cuda")
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(offline_cache=False)
    return StandIns()


def count_slow_calls(monkeypatch):
    """A list that gets the names of kernels whose calls run Python code of tai."""
    names = []
    for cls in (kernels.Kernel, kernels.GradientKernel):
        slow = cls._launch_slow

        def counted(self, args, kwargs, slow=slow):
            names.append(self.__name__)
            return slow(self, args, kwargs)

        monkeypatch.setattr(cls, "_launch_slow", counted)
    return names
