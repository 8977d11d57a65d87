"""`ti.optim`: optimisers of fields and arrays, as kernels on the device.

```python
x = ti.field(ti.f32, shape=8, needs_grad=True)
optimizer = ti.optim.Adam([x], lr=0.1)
with ti.ad.Tape(loss) as tape:
    compute_loss()
optimizer.step()
```
"""

from __future__ import annotations

from ._impl.base.keywords import check_keywords
from ._impl.optim.first_order import SGD, Adam, Optimizer
from ._impl.optim.gauss_newton import GaussNewton
from ._impl.optim.lbfgs import LBFGS
from ._impl.optim.objective import Result
from ._impl.optim.scipy_bridge import scipy_minimize

__all__ = ["LBFGS", "SGD", "Adam", "GaussNewton", "Optimizer", "Result", "scipy_minimize"]


check_keywords(globals())
