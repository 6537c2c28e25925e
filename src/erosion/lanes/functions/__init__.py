"""Elementary functions as plain arithmetic, for the compiler of lanes.

The vector code calls no library of functions. Each function here is sums, products, selects and
operations on the bits of a float64, so its bits do not depend on the machine's library. There are
no branches: every case is computed, and one is selected.

The compiler may round a product and its sum once (fma) or twice. Where a rounding error must be
known, the product is exact instead: its two factors have at most 53 bits together.

Each polynomial minimizes the largest relative error of its function on the stated interval (Remez's
exchange and Lawson's weights, in 45 digits). The first coefficients were rounded to float64 one
after another, and the rest fitted again each time. The stated error is that of the function.

Errors in the docstrings are the largest of some 10⁷ random points against 113-bit results, with and
without fma, in units in the last place (ulp) of the exact result. Where the result is subnormal,
the unit is 2⁻¹⁰⁷⁴. Special values are those of C99, annex F, and of NumPy.
"""

from collections.abc import Callable, Mapping

from jax import Array

from erosion.lanes.functions.derived import acosh, asinh, atanh, cosh, erf, erfc, sinh, tanh
from erosion.lanes.functions.elementary import (
    acos,
    asin,
    atan,
    atan2,
    cbrt,
    cos,
    exp,
    exp2,
    expm1,
    log,
    log1p,
    logistic,
    power,
    rsqrt,
    sin,
    tan,
)

FUNCTIONS: Mapping[str, Callable[..., Array]] = {"pow": power} | {
    function.__name__: function
    for function in (
        exp, exp2, expm1, log, log1p, sin, cos, tan, asin, acos, atan, atan2, sinh, cosh, tanh, asinh, acosh, atanh,
        cbrt, rsqrt, logistic, erf, erfc,
    )
}  # fmt: skip
"""By JAX's name of its primitive, each function."""
