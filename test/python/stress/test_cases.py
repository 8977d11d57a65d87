"""The table of stress cases is whole: each case has tests, and all tests that it names exist."""

from pathlib import Path

from stress_cases import CASES, cases_of

ROOT = Path(__file__).resolve().parents[3]


def test_cases_are_numbered():
    assert list(CASES) == list(range(1, 45))


def test_what_is_named_is_there():
    files = {path.stem: path.read_text() for path in (ROOT / "test/python").rglob("test_*.py")}
    here = "\n".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))
    for number, case in CASES.items():
        assert case.elsewhere or f"_s{number}_" in here or f"S{number} " in here, number
        for name in case.elsewhere:
            module, _, test = name.partition("::")
            test, _, row = test.partition("[")
            assert f"def {test or 'test_'}" in files[module], name
            assert f'"{row}' in files[module], name


def test_names_tell_cases():
    assert cases_of("test_numbers", "test_s4_s5_scales[f64]") == {4, 5}
    assert cases_of("test_kink_table", "test_kinks[S11 atan2(0, 0)-f64]") == {11}
    assert cases_of("test_stress_kinks", "test_exact[abs(0)-f64-reverse]") == {7}
    assert cases_of("test_half", "test_what_is_declared_f16_is_rounded") == set()


def test_the_page_has_all_cases():
    page = (ROOT / "docs/reports/stress.md").read_text()
    for number, case in CASES.items():
        assert f"| S{number} | {case.name} | {case.expected} |" in page
