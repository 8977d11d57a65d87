"""Runs the PTX of a kernel as the threads of blocks, one instruction at a time.

Threads of a warp run in a random order and by themselves between the instructions at which a warp
meets: a result that is right here does not depend on the scheduling of a GPU. Two lanes that touch
the same bytes between two meetings, one of them writing, are an error, and so is a meeting to which
not all of them come.
"""

import operator
import random
import re
import struct

LANES = 32
RELATIONS = {n: getattr(operator, n) for n in ("eq", "ne", "lt", "le", "gt", "ge")}
MASKS = {8: 0xFF, 16: 0xFFFF, 32: 0xFFFFFFFF, 64: 0xFFFFFFFFFFFFFFFF}


def to_float(bits, size):
    code = {32: "<If", 64: "<Qd"}[size]
    return struct.unpack("<" + code[2], struct.pack("<" + code[1], bits))[0]


def to_bits(value, size):
    code = {32: "<If", 64: "<Qd"}[size]
    return struct.unpack("<" + code[1], struct.pack("<" + code[2], value))[0]


def signed(bits, size):
    bits &= MASKS[size]
    return bits - (1 << size) if bits >> (size - 1) else bits


class Kernel:
    """The instructions of an entry, and where its labels stand."""

    def __init__(self, text, name):
        match = re.search(
            rf"\.entry {name}\((.*?)\)\s*(?:\.[a-z0-9 ,]+\s*)*\{{(.*?)\n\}}", text, re.S
        )
        if not match:
            raise SystemExit(f"the PTX has no kernel {name}")
        self.params = re.findall(r"(\w+)\s*(?:,|$)", match[1].strip(), re.M)
        self.code, self.labels = [], {}
        for line in match[2].splitlines():
            line = line.split("//")[0].strip()
            if label := re.match(r"(\$\w+):", line):
                self.labels[label[1]] = len(self.code)
                continue
            if not line or line.startswith("."):
                continue
            for statement in filter(None, (s.strip() for s in line.split(";"))):
                if statement == "}" or statement.startswith("{ .reg"):
                    continue
                guard = re.match(r"@(!?)(%p\d+)\s+", statement)
                rest = statement[guard.end() :] if guard else statement
                op, _, args = rest.partition(" ")
                if "\t" in rest:
                    op, _, args = rest.partition("\t")
                args = [a.strip() for a in re.split(r",(?![^\[{]*[\]}])", args) if a.strip()]
                self.code.append((guard and (guard[1], guard[2]), op.strip(), args))


class Thread:
    def __init__(self, kernel, memory, params, special):
        self.kernel, self.memory, self.special = kernel, memory, special
        self.params = dict(zip(kernel.params, params, strict=True))
        self.registers, self.at, self.waiting, self.done = {}, 0, None, False

    def get(self, name):
        if name.startswith("%"):
            return self.special[name] if name in self.special else self.registers[name]
        if name.startswith(("0f", "0d")):
            return int(name[2:], 16)
        return int(name, 0)

    def address(self, operand):
        base, _, offset = operand.strip("[]").partition("+")
        return self.get(base) + int(offset or 0)

    def step(self):
        """Runs one instruction; `waiting` says at which the warp must meet."""
        guard, op, args = self.kernel.code[self.at]
        if guard and bool(self.registers[guard[1]]) == (guard[0] == "!"):
            self.at += 1
            return
        parts = op.split(".")
        name, kind = parts[0], parts[-1]
        size = int(re.sub(r"\D", "", kind) or 0) if re.fullmatch(r"[busf]\d+", kind) else 32
        if name == "bra":
            self.at = self.kernel.labels[args[0]]
            return
        if name in ("ret", "exit"):
            self.done = True
            return
        if name == "trap":
            raise SystemExit("the kernel gives up")
        if ".sync" in op or name == "activemask":
            self.waiting = op, args
            return
        self.at += 1
        if name == "ld" and parts[1] == "param":
            self.registers[args[0]] = self.params[args[1].strip("[]")]
        elif name == "atom" or "relaxed" in parts:
            place, old = self.address(args[1]), 0
            old = self.registers[args[0]] = self.memory.peek(place, size)

            def add(value):
                if parts[-1][0] != "f":
                    return old + value
                return to_bits(to_float(old, size) + to_float(value, size), size)

            change = {
                "add": add,
                "or": lambda value: old | value,
                "max": lambda value: max(old, value & MASKS[size]),
                "exch": lambda value: value,
            }
            if name == "atom":
                self.memory.poke(place, change[parts[2]](self.get(args[2])), size)
        elif name == "ld":
            for i, register in enumerate(args[0].strip("{}").split(", ")):
                place = self.address(args[1]) + i * size // 8
                self.registers[register] = self.memory.load(self, place, size)
        elif name == "mov" and args[0].startswith("{"):
            registers = args[0].strip("{}").split(", ")
            for i, register in enumerate(registers):
                part = size // len(registers)
                self.registers[register] = self.get(args[1]) >> i * part & MASKS[part]
        elif name == "mov" and args[1].startswith("{"):
            values = [self.get(v) for v in args[1].strip("{}").split(", ")]
            part = size // len(values)
            self.registers[args[0]] = sum(
                (v & MASKS[part]) << i * part for i, v in enumerate(values)
            )
        elif name == "st":
            for i, value in enumerate(args[1].strip("{}").split(", ")):
                place = self.address(args[0]) + i * size // 8
                self.memory.store(self, place, self.get(value), size)
        else:
            self.registers[args[0]] = self.compute(name, parts, size, args)

    def compute(self, name, parts, size, args):
        values = [self.get(a) for a in args[1:]]
        kind = parts[-1]
        if name in ("mov", "cvta"):
            return values[0]
        if name == "bfe":
            return values[0] >> values[1] & ((1 << values[2]) - 1)
        if name == "clz":
            return size - (values[0] & MASKS[size]).bit_length()
        if name == "setp" and parts[1] == "nan":
            return any(to_float(v, size) != to_float(v, size) for v in values)
        if name == "setp":
            return self.compare(parts[1], kind, size, *values)
        if name == "selp":
            return values[0] if values[2] else values[1]
        if kind == "pred":
            return {
                "or": lambda: values[0] or values[1],
                "and": lambda: values[0] and values[1],
                "xor": lambda: values[0] != values[1],
                "not": lambda: not values[0],
            }[name]()
        if name == "cvt":
            to, source = parts[-2], parts[-1]
            out, inner = int(to[1:]), int(source[1:])
            if source[0] == "f":
                value = to_float(values[0], inner)
                return (to_bits(value, out) if to[0] == "f" else int(value)) & MASKS[out]
            value = signed(values[0], inner) if source[0] == "s" else values[0] & MASKS[inner]
            return to_bits(value, out) if to[0] == "f" else value & MASKS[out]
        if kind[0] == "f":
            floats = [to_float(v, size) for v in values]
            result = {
                "add": lambda a, b: a + b,
                "sub": lambda a, b: a - b,
                "mul": lambda a, b: a * b,
                "neg": lambda a: -a,
            }[name](*floats)
            return to_bits(result, size)
        if "wide" in parts:
            values = [signed(v, size) if kind[0] == "s" else v & MASKS[size] for v in values]
            result = values[0] * values[1] + (values[2] if name == "mad" else 0)
            return result & MASKS[2 * size]
        numbers = [signed(v, size) if kind[0] == "s" else v & MASKS[size] for v in values]
        result = {
            "add": lambda a, b: a + b,
            "sub": lambda a, b: a - b,
            "mul": lambda a, b: a * b,
            "mad": lambda a, b, c: a * b + c,
            "shl": lambda a, b: a << b,
            "shr": lambda a, b: a >> b,
            "and": lambda a, b: a & b,
            "or": lambda a, b: a | b,
            "xor": lambda a, b: a ^ b,
            "not": lambda a: ~a,
            "neg": lambda a: -a,
            "min": min,
            "max": max,
            "popc": lambda a: a.bit_count(),
            "rem": lambda a, b: a % b,
            "div": lambda a, b: a // b,
        }[name](*numbers)
        return result & (0xFFFFFFFF if name == "popc" else MASKS[size])

    def compare(self, how, kind, size, a, b):
        if kind[0] == "f":
            a, b = to_float(a, size), to_float(b, size)
        elif kind[0] == "s":
            a, b = signed(a, size), signed(b, size)
        else:
            a, b = a & MASKS[size], b & MASKS[size]
        if how == "num":
            return a == a and b == b
        if kind[0] == "f" and how.endswith("u"):
            # True for what cannot be compared.
            opposite = {"ltu": "ge", "leu": "gt", "gtu": "le", "geu": "lt", "neu": "eq"}
            return not RELATIONS[opposite[how]](a, b)
        return RELATIONS[how](a, b)


class Memory:
    """Bytes of the device, and who has touched them since the last meeting."""

    base = 1 << 32

    def __init__(self, data):
        self.data, self.readers, self.writers = bytearray(data), {}, {}

    def meet(self):
        self.readers, self.writers = {}, {}

    def touch(self, thread, address, size, writes):
        for byte in range(address, address + size // 8):
            writer = self.writers.setdefault(byte, thread) if writes else self.writers.get(byte)
            others = self.readers.get(byte, set()) - {thread}
            if (writer not in (None, thread)) or (writes and others):
                raise SystemExit(f"two lanes meet at byte {byte - self.base} in `{thread.at}`")
            if not writes:
                self.readers.setdefault(byte, set()).add(thread)

    def load(self, thread, address, size):
        self.touch(thread, address, size, False)
        return self.peek(address, size)

    def peek(self, address, size):
        at = address - self.base
        if at < 0 or at + size // 8 > len(self.data):
            raise SystemExit(f"a load from {at}")
        return int.from_bytes(self.data[at : at + size // 8], "little")

    def store(self, thread, address, value, size):
        self.touch(thread, address, size, True)
        self.poke(address, value, size)

    def poke(self, address, value, size):
        at = address - self.base
        if at < 0 or at + size // 8 > len(self.data):
            raise SystemExit(f"a store to {at}")
        self.data[at : at + size // 8] = (value & MASKS[size]).to_bytes(size // 8, "little")


def go_on(lane, values):
    for register, value in zip(lane.waiting[1][0].split("|"), values, strict=True):
        lane.registers[register] = value
    lane.at += 1
    lane.waiting = None


def meet_some(lanes, order):
    """Lets lanes go on that ask who is there, or that meet those of whom they know, if any do."""
    waiting = {i: lane for i, lane in enumerate(lanes) if lane.waiting}
    asking = [i for i, lane in waiting.items() if lane.waiting[0].startswith("activemask")]
    if asking:
        here = [i for i in asking if lanes[i].at == lanes[asking[0]].at]
        told = order.choice([here, here, here[: len(here) // 2 + 1]])
        for i in told:
            go_on(lanes[i], [sum(1 << k for k in told)])
        return True
    for lane in waiting.values():
        op, args = lane.waiting
        if not op.startswith("match.all.sync"):
            continue
        mask = lane.get(args[2])
        known = [i for i in range(LANES) if mask >> i & 1]
        if any(i not in waiting or lanes[i].at != lane.at for i in known):
            raise SystemExit(f"not all lanes of {mask:x} come to `{op}`")
        values = [lanes[i].get(args[1]) for i in known]
        same = len(set(values)) == 1
        for i in known:
            go_on(lanes[i], [mask if same else 0, same])
        return True
    return False


def meet(lanes, memory):
    """All threads of a warp have come to where they meet."""
    op = lanes[0].waiting[0]
    if len(lanes) != LANES or any(lane.done or lane.at != lanes[0].at for lane in lanes):
        raise SystemExit(f"not all lanes come to `{op}`")
    arguments = [lane.waiting[1] for lane in lanes]
    if any(lane.get(a[-1]) & MASKS[32] != MASKS[32] for lane, a in zip(lanes, arguments)):
        raise SystemExit("not the whole warp is asked for")
    values = [lane.get(a[1]) if len(a) > 1 else None for lane, a in zip(lanes, arguments)]
    for i, (lane, args) in enumerate(zip(lanes, arguments)):
        if op == "bar.warp.sync":
            memory.meet()
        elif op.startswith("match.any.sync"):
            same = sum(1 << k for k in range(LANES) if values[k] == values[i])
            lane.registers[args[0]] = same
        elif op.startswith("vote.sync.any"):
            lane.registers[args[0]] = any(values)
        elif op.startswith("shfl.sync.idx"):
            lane.registers[args[0]] = values[lane.get(args[2]) & 31]
        else:
            raise SystemExit(f"`{op}` is not known")
        lane.at += 1
        lane.waiting = None


def run(kernel, data, params, blocks, threads, seed):
    """The bytes of the memory after the kernel; `params` are offsets in it."""
    order = random.Random(seed)
    memory = Memory(data)
    addresses = [memory.base + p for p in params]
    for block in order.sample(range(blocks), blocks):
        warps = range(0, threads, LANES)
        for first in order.sample(warps, len(warps)):
            memory.meet()
            lanes = [
                Thread(
                    kernel,
                    memory,
                    addresses,
                    {
                        "%tid.x": t,
                        "%ctaid.x": block,
                        "%ntid.x": threads,
                        "%nctaid.x": blocks,
                        "%laneid": t % LANES,
                    },
                )
                for t in range(first, min(first + LANES, threads))
            ]
            while not all(lane.done for lane in lanes):
                ready = [lane for lane in lanes if not lane.done and not lane.waiting]
                if not ready:
                    if not meet_some(lanes, order):
                        meet(lanes, memory)
                    continue
                lane = order.choice(ready)
                for _ in range(order.choice((1, 3, 1000))):
                    if not lane.done and not lane.waiting:
                        lane.step()
    return bytes(memory.data)
