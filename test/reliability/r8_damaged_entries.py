"""R8: damaged entries of the cache are found, made again, and spoken of once.

Some of the entries are damaged, each in its own way: cut, flipped bits, zeros, more bytes, another
entry's bytes, those of another version of the format or of another CPU with a good checksum, a
link, a pipe or a folder in its place. The next process must get the right numbers, compile the
damaged ones and no others, and warn once; the one after that finds all whole.
"""

from __future__ import annotations

import os
import random
import shutil
import struct
import tempfile
from collections import Counter
from pathlib import Path

import cold_kernels
from bars import Bar

HEADER = struct.Struct("<8sIIQQQ")  # of CacheStore.cpp: magic, version, sizes, checksum
MASK = (1 << 64) - 1
PRIMES = (0x9E3779B185EBCA87, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x85EBCA77C2B2AE63,
          0x27D4EB2F165667C5)  # fmt: skip


def xxh64(data: bytes, seed: int = 0) -> int:
    """The checksum of entries."""
    p1, p2, p3, p4, p5 = PRIMES

    def turn(value: int, by: int) -> int:
        return (value << by | value >> (64 - by)) & MASK

    def step(total: int, lane: int) -> int:
        return turn((total + lane * p2) & MASK, 31) * p1 & MASK

    at, size = 0, len(data)
    if size >= 32:
        sums = [(seed + p1 + p2) & MASK, (seed + p2) & MASK, seed, (seed - p1) & MASK]
        while size - at >= 32:
            sums = [step(s, lane) for s, lane in zip(sums, struct.unpack_from("<4Q", data, at))]
            at += 32
        total = sum(turn(s, by) for s, by in zip(sums, (1, 7, 12, 18))) & MASK
        for s in sums:
            total = ((total ^ step(0, s)) * p1 + p4) & MASK
    else:
        total = (seed + p5) & MASK
    total = (total + size) & MASK
    while size - at >= 8:
        lane = struct.unpack_from("<Q", data, at)[0]
        total = (turn(total ^ step(0, lane), 27) * p1 + p4) & MASK
        at += 8
    if size - at >= 4:
        lane = struct.unpack_from("<I", data, at)[0]
        total = (turn(total ^ lane * p1 & MASK, 23) * p2 + p3) & MASK
        at += 4
    for byte in data[at:]:
        total = turn(total ^ byte * p5 & MASK, 11) * p1 & MASK
    total = (total ^ total >> 33) * p2 & MASK
    total = (total ^ total >> 29) * p3 & MASK
    return total ^ total >> 32


class Entry:
    """The parts of an entry, which can be changed and put together again, with a good checksum."""

    def __init__(self, data: bytes):
        self.magic, self.version, self.size, keys, count, self.checksum = HEADER.unpack_from(data)
        self.key = data[HEADER.size : HEADER.size + keys]
        self.payload = data[HEADER.size + keys :]
        assert count == len(self.payload)

    def header(self, checksum: int) -> bytes:
        return HEADER.pack(self.magic, self.version, self.size, len(self.key), len(self.payload),
                           checksum)  # fmt: skip

    def sealed(self) -> bytes:
        checksum = xxh64(self.payload, xxh64(self.key, xxh64(self.header(0))))
        return self.header(checksum) + self.key + self.payload


def cut(data: bytes, choose: random.Random, other: bytes) -> bytes:
    return data[: choose.randrange(len(data))]


def lengthen(data: bytes, choose: random.Random, other: bytes) -> bytes:
    return data + choose.randbytes(choose.choice((1, 8, 4096)))


def flip(data: bytes, choose: random.Random, other: bytes) -> bytes:
    damaged = bytearray(data)
    for _ in range(choose.choice((1, 1, 1, 5))):
        damaged[choose.randrange(len(data))] ^= 1 << choose.randrange(8)
    return bytes(damaged)


def zero(data: bytes, choose: random.Random, other: bytes) -> bytes:
    at = choose.randrange(len(data))
    size = min(len(data) - at, choose.choice((8, 64, 512, 1 << 20)))
    return data[:at] + bytes(size) + data[at + size :]


def swap(data: bytes, choose: random.Random, other: bytes) -> bytes:
    return other


def splice(data: bytes, choose: random.Random, other: bytes) -> bytes:
    """The payload of another entry behind the header and key of this one."""
    entry = Entry(data)
    return entry.header(entry.checksum) + entry.key + Entry(other).payload


def other_version(data: bytes, choose: random.Random, other: bytes) -> bytes:
    entry = Entry(data)
    entry.version += choose.choice((1, -1, 1 << 16))
    return entry.sealed()


def other_cpu(data: bytes, choose: random.Random, other: bytes) -> bytes:
    """The key is a hash of the CPU among other things."""
    entry = Entry(data)
    entry.key = choose.randbytes(len(entry.key) // 2).hex().encode()
    return entry.sealed()


DAMAGES = [cut, lengthen, flip, zero, swap, splice, other_version, other_cpu]


def damage(path: Path, choose: random.Random, others: list[bytes], counts: Counter) -> None:
    """Damages one entry in place."""
    data = path.read_bytes()
    kind = choose.choice([*DAMAGES, "link", "pipe", "folder"])
    counts[kind if isinstance(kind, str) else kind.__name__] += 1
    if callable(kind):
        damaged = data
        while damaged == data:
            damaged = kind(data, choose, choose.choice(others))
        path.write_bytes(damaged)
        return
    path.unlink()
    if kind == "link":
        path.symlink_to(choose.choice(["/etc/passwd", "/dev/zero", "nowhere", path.name]))
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.mkdir()


def judge(cache: Path, kernels: int, damaged: int) -> list[str]:
    """The faults of the two runs after so many entries were damaged."""
    ended = cold_kernels.run(0, kernels, cache)
    after = cold_kernels.run(0, kernels, cache)
    problems = [one.problem for one in (ended, after) if one.problem]
    if ended.compiled.total() != damaged:
        problems.append(f"{damaged} damaged, {ended.compiled.total()} compiled")
    if len(ended.warnings) != 1 or "damaged" not in ended.warnings[0]:
        problems.append(f"{len(ended.warnings)} warnings: {ended.warnings[:2]}")
    if after.compiled or after.warnings:
        problems.append(f"not made whole: {after.compiled}, {after.warnings}")
    return problems


def main() -> None:
    bar = Bar(
        "R8", "damaged entries of the cache", full=10_000, short=60, adds=True,
        target="10,000: each found, compiled again, warned of once",
        miss="a run with wrong numbers, that uses a damaged entry, or that warns twice or never",
    )  # fmt: skip
    args = bar.parse()
    choose = random.Random(args.seed)
    kernels = 15 if args.short else 50
    counts: Counter[str] = Counter()
    done = wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder) / "cache"
        first = cold_kernels.run(0, kernels, cache)
        whole = {path.name: path.read_bytes() for path in cold_kernels.entries(cache)}
        assert not first.problem and len(whole) == kernels * cold_kernels.ENTRIES, first.problem
        assert all(Entry(data).sealed() == data for data in whole.values())
        while done < args.count and bar.left() > 0:
            size = min(args.count - done, choose.choice((1, 3, len(whole) // 2, len(whole))))
            chosen = choose.sample(cold_kernels.entries(cache), size)
            for path in chosen:
                damage(path, choose, list(whole.values()), counts)
            problems = judge(cache, kernels, size)
            for problem in problems:
                print(f"after {done}: {problem}", flush=True)
            if problems:
                wrong += 1
                shutil.rmtree(cache)
                cold_kernels.run(0, kernels, cache)
            done += size
    kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(counts.items()))
    bar.report(
        f"{done} entries ({kinds.replace('_', ' ')})", f"{wrong} runs with errors",
        met=not wrong and done > 0,
    )  # fmt: skip


if __name__ == "__main__":
    main()
