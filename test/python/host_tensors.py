"""Tensors on the host: those of torch where it is installed, and stand-ins for them."""

import numpy as np

try:
    import torch
except ImportError:
    torch = None


class HostTensor:
    """The attributes of a tensor of torch in host memory that kernels read."""

    is_cuda = False
    is_leaf = True

    def __init__(self, values, requires_grad=False, counter=None, base=None):
        self.values = values
        self.requires_grad, self.grad = requires_grad, None
        self.shape, self.dtype = values.shape, f"torch.{values.dtype}"
        self._counter = [0] if counter is None else counter
        self._base = base

    @property
    def _version(self):
        return self._counter[0]

    def data_ptr(self):
        return self.values.ctypes.data

    def is_contiguous(self):
        return self.values.flags.c_contiguous

    def detach(self):
        return HostTensor(self.values, counter=self._counter)

    def numpy(self):
        return self.values

    def new_zeros(self, shape):
        return HostTensor(np.zeros(shape, self.values.dtype))

    def zero_(self):
        return self.add_(-self.values)

    def add_(self, amount):
        self._counter[0] += 1
        self.values += amount
        return self

    def __getitem__(self, key):
        return HostTensor(self.values[key], counter=self._counter)


class StandIns:
    """Makes stand-ins."""

    @staticmethod
    def tensor(values, requires_grad=False):
        """A tensor; one that requires a gradient has one of zeros."""
        made = HostTensor(np.array(values, np.float64), requires_grad)
        made.grad = made.new_zeros(made.shape) if requires_grad else None
        return made


class Torch:
    """Makes tensors of torch."""

    @staticmethod
    def tensor(values, requires_grad=False):
        """A tensor; one that requires a gradient has one of zeros."""
        made = torch.tensor(np.array(values, np.float64), requires_grad=requires_grad)
        made.grad = torch.zeros_like(made) if requires_grad else None
        return made


LIBRARIES = [StandIns] if torch is None else [StandIns, Torch]
