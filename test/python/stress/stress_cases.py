"""The stress cases: description, expected result, and further tests of each."""

from __future__ import annotations

import re
from typing import NamedTuple


class Case(NamedTuple):
    """A row of the table."""

    name: str
    expected: str
    elsewhere: tuple[str, ...] = ()  # module::test, or how its id begins


EXACT = "test_stress_kinks::test_exact"
MATRICES = "test_stress_matrices::"

CASES = {
    1: Case(
        "sqrt(0)",
        "infinite where the adjoint is not 0, else 0",
        (f"{EXACT}[sqrt(0)", f"{EXACT}[0 sqrt(0)"),
    ),
    2: Case("x sqrt(x) at 0", "0, the true slope", (f"{EXACT}[x sqrt(x)",)),
    3: Case("norm(0)", "0", (f"{EXACT}[norm(0)", f"{EXACT}[norm squared", f"{EXACT}[distance(0)")),
    4: Case(
        "norm(1e-200, 0, 0)", "1e-200, (1, 0, 0); f32: 1e-30", ("test_stress_kinks::test_norm",)
    ),
    5: Case("norm(1e200, 0, 0)", "1e200, (1, 0, 0); f32: 1e30", ("test_stress_kinks::test_norm",)),
    6: Case("normalized(0)", "0, slope 0", (f"{EXACT}[normalized(0)",)),
    7: Case("abs(0)", "0", (f"{EXACT}[abs(",)),
    8: Case(
        "max(x, 0), max(0, x) at 0",
        "0, 1; split: 0.5",
        (f"{EXACT}[max(x, 0)", f"{EXACT}[max(0, x)"),
    ),
    9: Case(
        "max and min at a tie",
        "the second operand; split: halves",
        (f"{EXACT}[max, tie", f"{EXACT}[min, tie"),
    ),
    10: Case("clamp at its edges", "1", (f"{EXACT}[clamp",)),
    11: Case("atan2(0, 0)", "0, 0", (f"{EXACT}[atan2(0, 0)",)),
    12: Case("pow(0, 0)", "0, 0", (f"{EXACT}[pow(0, 0)",)),
    13: Case(
        "pow(0, 2), pow(-2, 2)",
        "0, 0; -4, NaN by the exponent",
        (f"{EXACT}[pow(0, 2)", f"{EXACT}[pow(-2, 2)"),
    ),
    14: Case(
        "acos(1), asin(1)",
        "infinite; 0 where unused; clamped by an option",
        (f"{EXACT}[acos(1)", "test_stress_kinks::test_arc", "test_stress_kinks::test_clamped"),
    ),
    15: Case("select(x > 0, sqrt(x), 0) at -1, 0", "0", (f"{EXACT}[masked root",)),
    16: Case("if x > 0: y = sqrt(x) at -1", "0", (f"{EXACT}[branch",)),
    17: Case("1 / (1 + exp(-x)) at -800", "0", (f"{EXACT}[sigmoid",)),
    18: Case("5.5 mod 2", "1, -2", (f"{EXACT}[remainder", f"{EXACT}[mod")),
    19: Case("tan(0.3)", "1 + tan²", ("test_stress_kinks::test_tangent",)),
    20: Case(
        "polar rotation at F = I, 2-D and 3-D", "0, 1/2, -1/2", (f"{MATRICES}test_at_the_identity",)
    ),
    21: Case("sum of singular values at I", "I", (f"{MATRICES}test_at_the_identity",)),
    22: Case(
        "y *= c, 30 to 1e6 trips, from a field",
        "f64 1e-10; run again in parts: equal bits",
        ("test_stress_loops::test_powers", "test_stress_loops::test_trips"),
    ),
    23: Case(
        "while that the data ends, in an if",
        "differences, 1e-7",
        ("test_stress_loops::test_while",),
    ),
    24: Case(
        "gathers and scatters at Fibonacci numbers",
        "exact whole numbers",
        ("test_stress_loops::test_fibonacci",),
    ),
    25: Case(
        "sum of 1e6, condition 1e6 to 1e12",
        "f32 2e-4; f64 accumulator 1e-7; deterministic: one answer",
        ("test_sum_accuracy::test_condition", "test_sum_accuracy::test_positive"),
    ),
    26: Case(
        "1e7 into one cell, f32",
        "1e-5; f64 accumulator 1e-7; deterministic: one answer",
        ("test_sum_accuracy::test_many_into_one",),
    ),
    27: Case("the same in f64", "1e-13"),
    28: Case(
        "logistic map, 20, 40, 100 steps", "1e-9, 1e-4, flagged", ("test_ad_health::test_chaos",)
    ),
    29: Case(
        "ball with time of impact, 10 heights",
        "-1 to 1e-12, f32 1e-5; naive +1",
        ("test_programs::test_time_of_impact",),
    ),
    30: Case(
        "flat land of billiards",
        "exactly 0, and the report says so",
        ("test_ad_health::test_flat",),
    ),
    31: Case("friction corner", "the slope of the side that ran, 1e-6"),
    32: Case(
        "polar in 3-D near rotations, det < 0, rank 2",
        "f64 1e-11, f32 1e-4; finite else",
        (f"{MATRICES}test_composites", f"{MATRICES}test_where", f"{MATRICES}test_beside"),
    ),
    33: Case(
        "U, V at equal singular values",
        "finite; composites right",
        (f"{MATRICES}test_singular", f"{MATRICES}test_products", f"{MATRICES}test_product_of"),
    ),
    34: Case(
        "corotated stress at F = I", "energy 0, stress 0, exactly", (f"{MATRICES}test_corotated",)
    ),
    35: Case(
        "log J, J = 1e-3, near 1, to 0",
        "f32 1e-6 near 1; J <= 0 stops in debug",
        (f"{MATRICES}test_logarithm", f"{MATRICES}test_neo_hookean", "test_domains::test_volume"),
    ),
    36: Case(
        "functions of singular values and eigenvalues, clamp of snow",
        "1 inside and on the edge, 0 outside; at any gap f64 7e-10, f32 5e-4",
    ),
    37: Case("springs at rest length, at length zero", "0; finite", (f"{MATRICES}test_springs",)),
    38: Case(
        "denormals",
        "kept, exactly; cells without mass: 0",
        ("test_atomic_gradients::test_factors_of_a_denormal",),
    ),
    39: Case("damped spring of 1e5 steps", "f64 1e-11, f32 1e-4"),
    40: Case(
        "checkpoints, S = 1, sqrt(n), n",
        "equal bits in deterministic mode; memory 1.1 times the formula",
        ("test_ad_memory::test_recomputed",),
    ),
    41: Case("Jacobi and CG, unrolled", "the adjoint of the equation, 1e-6"),
    42: Case(
        "f16 storage of grids", "loss 1e-2, cosine 0.999", ("test_half::test_gradient_of_smoke",)
    ),
    43: Case(
        "fast mathematics",
        "CUDA's bounds; NaN and infinities are known",
        ("test_math_accuracy::test_other_modes",),
    ),
    44: Case(
        "programs that break the access rules", "named, with both lines", ("test_access_rules::",)
    ),
}


def cases_of(module: str, test: str) -> set[int]:
    """The cases that a test is about: by its name and parameters in this folder, else listed."""
    numbers = re.findall(r"(?:_s|\[S|-S|\bS)(\d+)(?=[_ -])", f"{module}::{test}")
    if numbers and not module.startswith("test_stress"):
        return {int(n) for n in numbers}
    name = f"{module}::{test}"
    return {
        number
        for number, case in CASES.items()
        if any(name.startswith(prefix) for prefix in case.elsewhere)
    }
