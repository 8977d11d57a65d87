"""Memory and threads of a program go when it does, without the cyclic collector."""

import contextlib
import gc
import os
import weakref

import numpy as np
import pytest
import tai as ti
from tai.errors import TaiCompilationWarning


@pytest.fixture(autouse=True)
def no_collector():
    was_on = gc.isenabled()
    gc.collect()
    gc.disable()
    yield
    if was_on:
        gc.enable()


PF_EXITING = 4


def num_threads():
    """Counts threads. One that was joined is listed until the system has cleared it away."""
    count = 0
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(OSError), open(f"/proc/self/task/{thread}/stat") as stat:
            fields = stat.read().rpartition(")")[2].split()
            count += not int(fields[6]) & PF_EXITING
    return count


def run_program():
    ti.init(arch=ti.cpu, log_level=ti.ERROR, cpu_max_num_threads=2)
    x = ti.field(ti.f32, (100_000,), needs_grad=True)
    loss = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] * x[i]

    @ti.kernel
    def take(a: ti.types.ndarray()):
        for i in range(8):
            x[i] = a[i]

    take(np.ones(8, np.float32))
    with ti.ad.Tape(loss):
        total()
    assert x.grad[3] == 2


def test_threads_of_programs_end_with_them():
    run_program()
    ti.reset()
    before = num_threads()
    for _ in range(6):
        run_program()
    ti.reset()
    assert num_threads() <= before


def test_a_refused_kernel_keeps_no_program():
    ti.init(arch=ti.cpu, log_level=ti.ERROR, cpu_max_num_threads=2)
    ti.reset()
    before = num_threads()
    for _ in range(4):
        ti.init(arch=ti.cpu, log_level=ti.ERROR, cpu_max_num_threads=2)
        x = ti.field(ti.f32, (100_000,))
        x.fill(1)

        @ti.kernel
        def wrong(x: ti.template()):
            for i in x:
                x[i] = nothing  # noqa: F821

        with pytest.raises(ti.TaiNameError):
            wrong(x)
    ti.reset()
    assert num_threads() <= before


@ti.data_oriented
class Cloud:
    def __init__(self, scale):
        self.scale = scale
        self.x = ti.field(ti.f32, 4, needs_grad=True)
        self.loss = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def fill(self):
        for i in self.x:
            self.x[i] = self.scale

    @ti.kernel
    def total(self):
        for i in self.x:
            self.loss[None] += self.x[i] * self.x[i]


def test_an_object_whose_kernels_ran_goes_when_it_is_dropped():
    ti.init(arch=ti.cpu, log_level=ti.ERROR)
    cloud = Cloud(3.0)
    cloud.fill()
    with ti.ad.Tape(cloud.loss):
        cloud.total()
    assert cloud.x.grad[0] == 6
    seen = weakref.ref(cloud)
    del cloud
    assert seen() is None
    assert len(Cloud.fill._specializations) == 0


def test_the_next_object_has_its_own_code():
    ti.init(arch=ti.cpu, log_level=ti.ERROR)
    # The next ones often have the address of the one before.
    for scale in range(1, 30):
        cloud = Cloud(float(scale))
        cloud.fill()
        cloud.fill()
        assert cloud.x.to_numpy().tolist() == [scale] * 4
        cloud.scale += 0.5
        cloud.fill()
        assert cloud.x[1] == scale + 0.5
        del cloud


def test_two_objects_at_once_and_one_goes():
    ti.init(arch=ti.cpu, log_level=ti.ERROR)
    first, second = Cloud(1.0), Cloud(2.0)
    first.fill()
    second.fill()
    del first
    second.x.fill(0)
    second.fill()
    assert second.x[0] == 2
    assert len(Cloud.fill._specializations) == 1


def test_an_object_that_goes_in_the_middle_of_its_tape():
    ti.init(arch=ti.cpu, log_level=ti.ERROR)
    cloud = Cloud(3.0)
    x, loss = cloud.x, cloud.loss
    cloud.fill()
    with ti.ad.Tape(loss):
        cloud.total()
        del cloud
    assert x.grad[2] == 6


def test_parts_of_an_object_are_read_anew():
    ti.init(arch=ti.cpu, log_level=ti.ERROR)

    class Settings:
        def __init__(self, value):
            self.value = value

    @ti.data_oriented
    class Scene:
        def __init__(self):
            self.settings = Settings(1.0)
            self.own = self
            self.out = ti.field(ti.f32, ())

        @ti.kernel
        def run(self):
            self.out[None] = self.settings.value + self.own.settings.value

    scene = Scene()
    for value in range(10):
        scene.settings = Settings(float(value))
        scene.run()
        scene.run()
        assert scene.out[None] == 2 * value


def test_objects_without_weak_references_stay_as_they_were():
    ti.init(arch=ti.cpu, log_level=ti.ERROR)

    @ti.data_oriented
    class Small:
        __slots__ = ("out", "scale")

        def __init__(self):
            self.scale = 2.0
            self.out = ti.field(ti.f32, ())

        @ti.kernel
        def run(self):
            self.out[None] = self.scale

    small = Small()
    small.run()
    small.run()
    assert small.out[None] == 2
    small.scale = 3.0
    small.run()
    assert small.out[None] == 3


def test_many_values_of_an_attribute_are_told_of():
    ti.init(arch=ti.cpu, log_level=ti.ERROR)
    cloud = Cloud(0.0)
    with pytest.warns(TaiCompilationWarning, match="'scale' changes"):
        for number in range(20):
            cloud.scale = float(number)
            cloud.fill()
