"""The compiler from Python functions to the IR of kernels."""
