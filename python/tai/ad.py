"""`ti.ad`: gradients across kernels, forward mode, and checks of gradients."""

from __future__ import annotations

from ._impl.ad.check import check
from ._impl.ad.compare import CheckResult, GradientCheckError
from ._impl.ad.condition import Condition
from ._impl.ad.diagnose import Diagnosis, DiagnosisRow, diagnose
from ._impl.ad.forward import FwdMode, hvp, jvp
from ._impl.ad.health import HealthReport
from ._impl.ad.matrices import hessian, hessian_operator, jacobian, jacobian_operator, vjp
from ._impl.ad.memory import TapeStats
from ._impl.ad.precision import PrecisionReport
from ._impl.ad.tape import (
    Tape,
    clear_all_gradients,
    complex_kernel,
    complex_kernel_grad,
    grad_for,
    grad_replaced,
    no_grad,
)
from ._impl.ad.tuning import TunedPrecision, tune_precision
from ._impl.ad.validation import Violation
from ._impl.base.keywords import check_keywords
from ._impl.solvers.implicit import implicit
from ._impl.tracking.tracked import variable
from .errors import TaiConvergenceWarning, TaiGradientWarning

__all__ = [
    "CheckResult", "Condition", "Diagnosis", "DiagnosisRow", "FwdMode", "GradientCheckError",
    "HealthReport", "PrecisionReport", "TaiConvergenceWarning", "TaiGradientWarning", "Tape",
    "TapeStats", "TunedPrecision", "Violation", "check", "clear_all_gradients",
    "complex_kernel", "complex_kernel_grad", "diagnose", "grad_for", "grad_replaced", "hessian",
    "hessian_operator", "hvp", "implicit", "jacobian", "jacobian_operator", "jvp", "no_grad",
    "tune_precision", "variable", "vjp",
]  # fmt: skip


check_keywords(globals(), attributes=False)
