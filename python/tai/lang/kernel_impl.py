"""`ti.lang.kernel_impl`: kernels and functions."""

from .._impl.launch.kernels import Kernel, data_oriented, func, kernel, pyfunc, real_func

__all__ = ["Kernel", "data_oriented", "func", "kernel", "pyfunc", "real_func"]
