"""SUNDIALS' CVODE and CVODES, lane by lane in C, for a problem of these benchmarks.

The right side, its analytic Jacobian and its derivatives by a number are written as C from the same expressions as
those of all contenders. It needs a C compiler and the library with its headers (Debian's `libsundials-dev`, 6.4).
"""

import ctypes
import functools
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.c_expressions import RECORDED, Recorded, function, given, tangents
from benchmarks.ode_problems import Case, Lanes

_DRIVER = Path(__file__).with_name("cvode_lanes.c")
_LIBRARIES = ("cvodes", "nvecserial", "sunlinsoldense", "sunmatrixdense", "m")
_POINTER = ctypes.POINTER(ctypes.c_double)


def source(case: Case, names: tuple[str, ...]) -> str:
    """The C of a case whose lanes have numbers of these names."""
    count = len(case.state)
    t, s, by, dp = Recorded("t"), given("s", count), given("by", count), Recorded("dp")
    numbers = dict(zip(names, given("p", len(names)), strict=True))
    start, rates = case.start(RECORDED, numbers), case.rates(RECORDED, t, s, numbers)
    (event,) = case.events(RECORDED, t, s, numbers)
    wrt = numbers[case.wrt]
    along = dict(zip(s, by, strict=True))
    columns = [tangents(rates, {each: 1.0}) for each in s]
    jacobian = {f"out[{j * count + i}]": entry for j, column in enumerate(columns) for i, entry in enumerate(column)}
    state = "double t, const double *s, const double *p"

    def rows(values: list[Any], target: str = "out") -> dict[str, Any]:
        return {f"{target}[{i}]": value for i, value in enumerate(values)}

    (direction,) = case.directions.values()
    parts = [
        "#include <math.h>",
        f"#define UNKNOWNS {count}\n#define PARAMETERS {len(names)}\n#define WRT {names.index(case.wrt)}",
        f"#define DIRECTION {direction}",
        function("static void start(const double *p, double *out)", rows(start)),
        function("static void start_along(const double *p, double *out)", rows(tangents(start, {wrt: 1.0}))),
        function(f"static void rates({state}, double *out)", rows(rates)),
        function(f"static void jacobian({state}, double *out)", jacobian),
        function(
            f"static void rates_along({state}, const double *by, double *out)",
            rows(tangents(rates, along | {wrt: 1.0})),
        ),
        function(f"static double event({state})", {"value": event}, returns="value"),
        function(
            f"static double event_along({state}, const double *by, double dp)",
            {"value": tangents([event], along | {wrt: dp})[0]},
            returns="value",
        ),
        f'#include "{_DRIVER}"',
    ]
    return "\n\n".join(parts) + "\n"


@functools.cache
def _compiled(case: Case, names: tuple[str, ...]) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        code, library = Path(folder, "case.c"), Path(folder, "case.so")
        code.write_text(source(case, names))
        command = ["cc", "-O3", "-march=native", "-shared", "-fPIC", "-o", library, code]
        subprocess.run([*command, *(f"-lsundials_{name}" if name != "m" else "-lm" for name in _LIBRARIES)], check=True)
        solve = ctypes.CDLL(str(library)).solve_lanes
    solve.restype = ctypes.c_long
    solve.argtypes = [ctypes.c_long, _POINTER, *[ctypes.c_double] * 3, ctypes.c_int, _POINTER, _POINTER]
    return solve


def cvode(case: Case, rtol: float, atol: float, order: int = 0) -> Callable[[Lanes], tuple[np.ndarray, np.ndarray]]:
    """When lanes end, NaN where they do not, and with `order` 1 the derivatives of that by `case.wrt`."""

    def run(lanes: Lanes) -> tuple[np.ndarray, np.ndarray]:
        numbers = np.ascontiguousarray(np.column_stack(list(lanes.values())), float)
        t, by = np.full(len(numbers), np.nan), np.full(len(numbers), np.nan)
        pointers = [array.ctypes.data_as(_POINTER) for array in (numbers, t, by)]
        solve = _compiled(case, tuple(lanes))
        solve(len(numbers), pointers[0], rtol, atol, case.t1, order, *pointers[1:])
        return t, by

    return run
