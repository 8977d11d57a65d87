"""The report of shadows proposes forms that keep digits, and verifies them."""

import numpy as np
import pytest
import tai as ti
from tai._impl.base import rewrites

TYPES = [(ti.f32, 24), (ti.f64, 53)]


@pytest.mark.parametrize("bits", [24, 53])
@pytest.mark.parametrize(("before", "after"), rewrites._FORMS)
def test_each_known_form_is_verified(before, after, bits, tmp_path):
    """The form is found in source text, and the verification accepts it."""
    path = tmp_path / "source.py"
    path.write_text(f"import tai as t\ny = {before}\n")
    overflows = before in ("log(1 + exp(A))", "log(exp(A) + exp(B))") or "** 2 + " in before
    error = 2.0 ** (2 - bits / 2)
    found = rewrites.propose(str(path), 2, 5, bits, 0.0 if overflows else error, overflows)
    assert found is not None and found.before == before
    name = {"log1p": "t.math.log1p", "expm1": "t.math.expm1"}
    expected = after
    for plain in ("log1p", "expm1"):
        expected = expected.replace(plain, name[plain])
    for plain in ("sin(", "cos(", "cosh(", "hypot(", "max(", "sqrt(", "exp("):
        expected = expected.replace(plain, f"t.{plain}")
    for twice in ("t.math.t.", "t.t."):
        expected = expected.replace(twice, twice[:-2])
    if "sinh" not in expected:
        assert found.after == expected
    assert found.error_after <= 0.01 * min(found.error, 1.0)
    assert found.values >= 3


@pytest.mark.parametrize(
    "text",
    [
        "a + b",
        "a - b",
        "1 - ti.sin(x)",
        "1 / (1 + x) - 1 / (1 + y)",  # loses the same digits in another form
        "(1 + x) ** 2 - (1 + y) ** 2",
        "1 - ti.cos(unknown(x)[0], 2)",
        "ti.exp(x) - 'text'",
        "a ** n - b ** n",
    ],
)
def test_no_form_is_proposed(text, tmp_path):
    path = tmp_path / "source.py"
    path.write_text(f"import tai as ti\ny = {text}\n")
    assert rewrites.propose(str(path), 2, 5, 24, 1e-2, False) is None


def test_a_wrong_form_is_not_verified():
    """A form that is another function, or loses as much, is refused."""
    for after in ("2 * ti.sin(x) ** 2", "ti.cos(0 * x) - ti.cos(x)", "x * x / 2"):
        assert rewrites._verify("1 - ti.cos(x)", after, 24, 1e-3, False) is None


def test_places_without_a_source(tmp_path):
    assert rewrites.propose(None, 0, 0, 24, 0.1, False) is None
    assert rewrites.propose(str(tmp_path / "none.py"), 3, 1, 24, 0.1, False) is None
    broken = tmp_path / "broken.py"
    broken.write_text("y = (1 -\n")
    assert rewrites.propose(str(broken), 1, 5, 24, 0.1, False) is None
    # 16-bit numbers are not computed here.
    whole = tmp_path / "whole.py"
    whole.write_text("y = 1 - cos(x)\n")
    assert rewrites.propose(str(whole), 1, 5, 11, 0.1, False) is None


@pytest.mark.parametrize(("kind", "bits"), TYPES)
def test_report_proposes_and_the_program_is_better(kind, bits):
    ti.init(arch=ti.cpu, shadow=True, default_fp=kind)
    n = 16
    x, big = ti.field(kind, n), ti.field(kind, ())
    y, z = ti.field(kind, (5, n)), ti.field(kind, (5, n))
    small = 1e-3 if bits == 24 else 1e-7
    x.from_numpy(small * np.linspace(1, 2, n))
    big[None] = 1e4

    @ti.kernel
    def before():
        for i in x:
            y[0, i] = 1 - ti.cos(x[i])
            y[1, i] = (x[i] + big[None]) - big[None]
            y[2, i] = ti.log(1.0 + x[i] * 1e-2)
            y[3, i] = ti.exp(x[i] * 1e-2) - 1
            y[4, i] = ti.sqrt(x[i] + big[None]) - ti.sqrt(big[None])

    @ti.kernel
    def after():
        for i in x:
            z[0, i] = 2 * ti.sin(x[i] / 2) ** 2
            z[1, i] = x[i]
            z[2, i] = ti.math.log1p(x[i] * 1e-2)
            z[3, i] = ti.math.expm1(x[i] * 1e-2)
            z[4, i] = x[i] / (ti.sqrt(x[i] + big[None]) + ti.sqrt(big[None]))

    before()
    report = ti.tools.shadow_report()
    forms = {row.rewrite.before: row.rewrite.after for row in report if row.rewrite}
    assert forms["1 - ti.cos(x[i])"] == "2 * ti.sin(x[i] / 2) ** 2"
    assert forms["x[i] + big[None] - big[None]"] == "x[i]"
    assert forms["ti.log(1.0 + x[i] * 0.01)"] == "ti.math.log1p(x[i] * 0.01)"
    assert forms["ti.exp(x[i] * 0.01) - 1"] == "ti.math.expm1(x[i] * 0.01)"
    assert len(forms) == 5
    for row in report:
        assert f"rewrite: {row.rewrite}" in str(report)
        assert f"write {row.rewrite.after}" in report.on_source()
    ti.tools.clear_shadow_report()
    after()
    assert not ti.tools.shadow_report()


def test_overflow_of_a_norm_and_of_softplus():
    ti.init(arch=ti.cpu, shadow=True, default_fp=ti.f32)
    x, y, z = ti.field(ti.f32, 8), ti.field(ti.f32, (2, 8)), ti.field(ti.f32, 8)
    x.from_numpy(np.linspace(1, 2, 8, dtype=np.float32) * 1e20)
    z.fill(100)

    @ti.kernel
    def run():
        for i in x:
            y[0, i] = ti.sqrt(x[i] * x[i] + x[i] ** 2)
            y[1, i] = ti.log(1 + ti.exp(z[i]))

    run()
    found = {row.rewrite.after for row in ti.tools.shadow_report() if row.rewrite}
    assert "ti.hypot(x[i], x[i])" in found
    assert "ti.max(z[i], 0) + ti.math.log1p(ti.exp(-abs(z[i])))" in found
