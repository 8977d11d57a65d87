"""The floating-point modes that the benchmark of errors compares: one line for each.

A mode is a set of options of `ti.init`. One whose option this build lacks is reported as missing.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Mode:
    """A way to compute.

    Attributes:
        name: in tables.
        bits: of the floats in which it computes; ulps are counted in them.
        options: of `init`, where `default_fp` is the name of a type.
    """

    name: str
    bits: int
    options: dict = field(default_factory=dict)

    @property
    def is_deterministic(self) -> bool:
        """Whether all runs must give the same bits."""
        return bool(self.options.get("deterministic"))


def _mode(name: str, bits: int, **options: object) -> Mode:
    return Mode(name, bits, {"default_fp": f"f{bits}", **options})


def _storage(name: str) -> Mode:
    return Mode(f"{name} storage", 32, {"precision": name})


REFERENCE = "f64 deterministic"

# One line for each mode of tai.
TAI = [
    _mode(REFERENCE, 64, deterministic=True),
    _mode("f64", 64),
    _mode("f64 compensated", 64, sums="compensated"),
    _mode("f32", 32),
    _mode("f32 unguarded", 32, ad_guards=False),
    _mode("f32 fast", 32, fast_math=True),
    _mode("f32 strict", 32, strict=True),
    _mode("f32 deterministic", 32, deterministic=True),
    _mode("f32 compensated", 32, sums="compensated"),
    _mode("f32 accurate", 32, math="accurate"),
    _mode("f32 ftz", 32, ftz=True),
    _mode("f32, f64 adjoints", 32, adjoints="f64"),
    _storage("f16"),
    _storage("bf16"),
]

# The default of taichi and quadrants is `fast_math`.
_TAICHI = [_mode("f64", 64), _mode("f32", 32), _mode("f32 exact", 32, fast_math=False)]
_ARRAYS = [_mode("f64", 64), _mode("f32", 32)]

OURS = "tai"
MODES: dict[str, list[Mode]] = {
    OURS: TAI,
    "taichi": _TAICHI,
    "quadrants": _TAICHI,
    "jax": _ARRAYS,
    "torch": _ARRAYS,
    "warp": [_mode("f32", 32)],
}
PEERS = [name for name in MODES if name != OURS]

# The purpose of a mode, in the words of the page.
ABOUT = {
    REFERENCE: "the reference: the same bits in each run",
    "f64": "when in doubt, and to judge the others by",
    "f64 compensated": "ill-conditioned sums in f64",
    "f32": "the default: enough where the dynamics contract",
    "f32 unguarded": "never: it is here to see what guards cost",
    "f32 fast": "maps of exp, sin and pow where a few ulp do not matter",
    "f32 strict": "each operation rounded by itself: the same bits on CPU and GPU",
    "f32 deterministic": "the same bits in each run: debugging, regression tests",
    "f32 compensated": "long or ill-conditioned sums, many particles in a cell",
    "f32 accurate": "elementary functions within one ulp",
    "f32 ftz": "where denormal numbers slow the processor down",
    "f32, f64 adjoints": "gradients that are sums over many steps and readers",
    "f16 storage": "memory: half the bytes, eleven bits",
    "bf16 storage": "memory: half the bytes, eight bits, the range of f32",
}


# The purpose of modes that fronts of time and error do not show.
JUSTIFIED = {"f16 storage": "half the memory", "bf16 storage": "half the memory"}


def find(system: str, name: str) -> Mode:
    """The mode of a system by its name."""
    return next(mode for mode in MODES[system] if mode.name == name)


def lacks(error: BaseException) -> bool:
    """Whether `init` says that it has no such option."""
    return "no option" in str(error) or "unexpected keyword" in str(error)
