"""`ti.profiler` on the CPU and on a GPU, which is the emulated one where there is none."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import tai as ti

EMULATED = os.environ.get("TAI_CUDA_EMULATION") != ""


@pytest.fixture(params=["cpu", "cuda"])
def arch(request, monkeypatch):
    monkeypatch.setenv("TI_ARCH", request.param)
    if EMULATED:
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(kernel_profiler=True, offline_cache=False)
    return request.param


def make_program():
    x = ti.field(ti.f32, shape=1000)
    y = ti.field(ti.f64, shape=(4, 100))

    @ti.kernel
    def scale(by: ti.f32):
        for i in x:
            x[i] *= by

    @ti.kernel
    def fill(row: ti.i32):
        for i in range(100):
            y[row, i] = i

    return x, scale, fill


def test_rows(arch):
    x, scale, fill = make_program()
    for _ in range(3):
        scale(2.0)
    fill(1)
    rows = {row.name.removesuffix("_0"): row for row in ti.profiler.get_stats()}
    assert set(rows) == {"scale", "fill"}
    one = rows["scale"]
    assert one.counter == 3
    assert 0 <= one.min <= one.avg <= one.max <= one.total
    assert one.kind == ("device" if arch == "cuda" else "host")
    # All of x is read and written; of y, one row of four is written.
    assert one.bytes == 2 * 4 * 1000
    assert rows["fill"].bytes == 8 * 100
    file, number, _ = one.place.rsplit(":", 2)
    first = make_program.__code__.co_firstlineno
    assert Path(file).name == Path(__file__).name
    # The kernel, or the loop in it.
    assert int(number) in range(first + 4, first + 8)
    if arch == "cuda":
        assert one.threads >= 1 and one.blocks >= 1
    # By the name of the kernel, whatever its loops are called.
    assert ti.profiler.query_kernel_profiler_info("scale").counter == 3
    assert ti.profiler.get_kernel_profiler_total_time() == pytest.approx(
        sum(row.total for row in rows.values()) / 1000
    )


def test_tables(arch, capsys):
    x, scale, fill = make_program()
    scale(2.0)
    fill(2)
    ti.profiler.print_kernel_profiler_info()
    out = capsys.readouterr().out.splitlines()
    assert any("scale" in line and "(test_profiler.py:" in line for line in out[1:])
    assert ("regs" in out[0]) == (arch == "cuda")
    # All names of kernels begin below the word "kernel".
    begin = out[0].index("kernel")
    assert all(line[begin - 2 : begin] == "  " and line[begin] != " " for line in out)
    ti.profiler.print_kernel_profiler_info("trace")
    out = capsys.readouterr().out.splitlines()
    # A GPU fills memory, too, which has no shape.
    kernels = [line.split()[-1] for line in out[1:] if arch == "cpu" or " x " in line]
    assert [name.removesuffix("_0") for name in kernels] == ["scale", "fill"]
    with pytest.raises(ti.TaiRuntimeError, match="'count', 'roofline' and 'trace'"):
        ti.profiler.print_kernel_profiler_info("counts")


def test_memory_counts_for_itself(arch):
    x, scale, _ = make_program()
    scale(2.0)
    x.to_numpy()
    kernels = ti.profiler.get_stats()
    everything = ti.profiler.get_stats(memory=True)
    assert all(row.kind != "memory" for row in kernels)
    names = {row.name for row in everything if row.kind == "memory"}
    assert ("copy to the host" in names) == (arch == "cuda")


def test_trace(arch, tmp_path):
    x, scale, fill = make_program()
    for _ in range(3):
        scale(2.0)
    fill(0)
    path = tmp_path / "trace.json"
    ti.profiler.save_trace(path)
    events = json.loads(path.read_text())["traceEvents"]
    names = {e["pid"]: e["args"]["name"] for e in events if e["name"] == "process_name"}
    done = [e for e in events if e["ph"] == "X"]
    host = [e for e in done if names[e["pid"]] == "host"]
    assert [e["name"] for e in host if e["cat"] == "host"] == ["scale", "scale", "scale", "fill"]
    for event in done:
        assert event["dur"] >= 0 and event["ts"] >= 0
    if arch == "cpu":
        assert set(names.values()) == {"host"}
        return
    gpu = [e for e in done if names[e["pid"]] == "GPU"]
    loops = [e for e in gpu if e["cat"] == "device"]
    assert [e["name"] for e in loops] == ["scale_0", "scale_0", "scale_0", "fill_0"]
    # One after another, each after it was queued, by the same clock.
    for before, after in zip(gpu, gpu[1:], strict=False):
        assert before["ts"] + before["dur"] <= after["ts"] + 1
    starts = {e["id"]: e for e in events if e["ph"] == "s"}
    ends = {e["id"]: e for e in events if e["ph"] == "f"}
    assert len(starts) == len(ends) == len(gpu)
    for number, start in starts.items():
        assert start["ts"] <= ends[number]["ts"]
    assert loops[0]["args"]["place"].rpartition("/")[2].startswith("test_profiler.py:")


def test_replays_are_timed_kernel_by_kernel(arch):
    x = ti.field(ti.f64, shape=50, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def add():
        for i in x:
            loss[None] += x[i] ** 2

    with ti.ad.Tape(loss) as tape:
        for _ in range(6):
            add()
    ti.profiler.clear_kernel_profiler_info()
    for _ in range(4):
        loss[None] = 0
        tape.replay()
    rows = {row.name: row.counter for row in ti.profiler.get_stats()}
    suffix = "_0" if arch == "cuda" else ""
    assert rows[f"add{suffix}"] == 24
    assert rows[f"add_grad{suffix}"] == 24


def test_nothing_is_kept_while_it_is_off(arch):
    ti.init(offline_cache=False)
    x, scale, _ = make_program()
    scale(2.0)
    with pytest.raises(ti.TaiRuntimeError, match="kernel_profiler=True"):
        ti.profiler.save_trace("nowhere")


def test_places_are_those_of_the_source_as_it_is_now(tmp_path):
    """Also where the code comes out of the cache of another program."""
    text = (
        "import tai as ti\n"
        "ti.init(kernel_profiler=True, offline_cache=True,"
        f" offline_cache_file_path={str(tmp_path / 'cache')!r})\n"
        "x = ti.field(ti.f32, shape=8)\n"
        "@ti.kernel\n"
        "def work():\n"
        "    for i in x:\n"
        "        x[i] += 1\n"
        "work()\n"
        "print(ti.profiler.get_stats()[0].place)\n"
    )
    program = tmp_path / "program.py"
    environment = {**os.environ, "TI_ARCH": "cuda"}
    if EMULATED:
        environment["TAI_CUDA_EMULATION"] = "1"
    lines = []
    for given in (text, "# A line more.\n" + text):
        program.write_text(given)
        done = subprocess.run(
            [sys.executable, str(program)], capture_output=True, text=True, check=True,
            env=environment,
        )  # fmt: skip
        lines.append(int(done.stdout.rsplit(":", 2)[1]))
    assert lines == [6, 7]


def test_the_share_of_the_measured_bandwidth(arch, capsys):
    x, scale, fill = make_program()
    scale(2.0)
    fill(1)
    names = {row.name for row in ti.profiler.get_stats()}
    assert all(row.roof is None and row.roofline is None for row in ti.profiler.get_stats())
    found = ti.profiler.measure_bandwidth()
    assert found > 0
    rows = ti.profiler.get_stats()
    # The kernel of the measurement is in no table, and its fields are gone.
    assert {row.name for row in rows} == names
    for row in rows:
        assert row.roofline == pytest.approx(row.gigabytes_per_second / found)
    capsys.readouterr()
    ti.profiler.print_kernel_profiler_info("roofline")
    table = capsys.readouterr().out
    assert f"measured bandwidth: {found:.1f} GB/s" in table
    assert "roof" in table and f"{rows[0].roofline:.0%}" in table
    ti.profiler.print_memory_profiler_info()
    assert "bandwidth" not in capsys.readouterr().out
    assert not any("bandwidth" in row["name"] for row in ti.profiler._events())


def test_no_bandwidth_is_measured_in_a_tape():
    ti.init()
    x = ti.field(ti.f32, shape=(), needs_grad=True)
    with ti.ad.Tape(x):
        x[None] += 1.0
        with pytest.raises(ti.TaiRuntimeError, match="which a tape would record"):
            ti.profiler.measure_bandwidth()
