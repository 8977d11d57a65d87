"""Independent f64 transcriptions of the scenes in NumPy, each with its own adjoint.

Nothing here uses the compiler: the modules are what its results are compared with. Each
scene is a pure function of its parameters, so a small version of it is cheap.
"""
