"""The measurements as text: the same on the screen and in RESULTS.md."""

import importlib.metadata
import platform
from pathlib import Path

from benchmarks import diffrax_vmap, heyoka_taylor, scipy_dop853
from benchmarks.contenders import V2
from benchmarks.measure import Reference, Row, Table
from benchmarks.timing import rate_text, table_text
from benchmarks.work import Verdict

_PACKAGES = ("jax", "jaxlib", "diffrax", "optimistix", "heyoka", "scipy", "numpy", "numba", "llvmlite")

METHOD = f"""\
## Method

- One program, one process group, the same cores. Every contender gets all cores: the engine
  and diffrax by threads, heyoka and scipy by one spawned process per core,
  pinned to it, with interleaved shares. Rates are of compiled and warm code, without the start of
  processes and without the data that moves between them; first answers are with both.
- The work: the rotating model at Table 1. Random: α evenly in (0.05, 1.5) rad and
  s = rφ̇0/v0 evenly in (−0.5, 0.5), a seeded sample. Ordered: the same range of α in order,
  s = 0. A contender with fewer impacts gets an evenly spread part of the same sample.
- Contenders run by turns (A B C A B C …), in every table; rates are medians, with the least and the
  greatest. "×" is the engine's rate over the row's, for the same quantities.
- Tolerances: the engine's default, rtol = 1e-9. Each peer's is the loosest decade at which 99 % of
  its volumes are right to 2e-9: heyoka {heyoka_taylor.TOLERANCE:g}, scipy {scipy_dop853.TOLERANCE:g},
  diffrax Tsit5 {diffrax_vmap.TOLERANCES["Tsit5"]:g} and Dopri8 {diffrax_vmap.TOLERANCES["Dopri8"]:g}.
- Errors of V are relative to V. V′ and V″ pass through zero: their errors are relative to their
  own size or the median size, whichever is larger. "Wrong" counts impacts with another end
  than the reference, no finite answer, or a volume off by more than 1e-6; the errors are those of
  all the others.
- The reference is `erosion.impact(rtol=1e-13)`, after a check against two solutions that share no
  code with it: heyoka's variational integrator at 1e-15, and scipy's DOP853 at 1e-13 with steps of
  at most 0.02/ω, so that no event hides inside one.

## How each peer was set up, and what its answers needed

- **heyoka** integrates the equations without units and without x, which nothing here needs
  (the engine takes the model as it is). `fast_math` on, `compact_mode` and `high_accuracy` off,
  parameters at run time, one integrator for all impacts. A start at depth exactly 0 makes it lose
  an event inside its first step, about 1 impact in 1,000 (the shortest cuts); a start 1e-300 deep
  loses none. "Scalar" is `taylor_adaptive` with `propagate_until`. The SIMD batch's own
  `propagate_until` ends all lanes at the first terminal event of any, which is wrong here; "batch
  refilled" steps it, marks ended lanes in the events' callbacks, and lets a numba function store
  and replace them. V′ and V″ come from `var_ode_sys` to second order with respect to α (through
  the initial velocity: one direction, 18 equations), plus the term of the end's own motion.
- **diffrax** gets one event on the minimum of both functions, falling (with two events it reports
  the first of the tree, not the earliest), and a Newton root finder at 1e-12. An event that dips and
  returns within a step is lost: those are its wrong lanes, and a tighter tolerance only makes them rarer.
- **scipy** gets both events, terminal and falling, and the start 1e-300 deep: from 0 it would find
  the event at contact whenever a cut ends within the first step.
"""


def machine(device: str) -> str:
    """Processor, cores and versions."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        cpu = models[0] if models else cpu
    versions = ", ".join(f"{name} {_version(name)}" for name in _PACKAGES)
    return f"{device}; {cpu}. Python {platform.python_version()}, {versions}, erosion {_version('erosion')}."


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "absent"


def rates_text(table: Table) -> str:
    """A table of rates, ratios and errors, one row a contender."""
    rates = "contender | impacts | impacts/s, median (min–max) | ×"
    errors = "wrong | error of V: median, 99 %, max | V′ 99 % | V″ 99 %"
    rows = table_text(f"{rates} | {errors}", [_cells(row, table.times(row.name)) for row in table.rows])
    return "\n".join([f"## {table.title}", "", _reference_text(table.reference), "", rows])


def _cells(row: Row, times: float | None) -> list[str]:
    rates = f"{rate_text(row.rate)} ({rate_text(min(row.rates))}–{rate_text(max(row.rates))})"
    cells = [row.name, f"{row.lanes:,}", rates, "" if times is None else f"{times:,.3g}"]
    errors = row.verdict.errors
    cells += [str(row.verdict.wrong), ", ".join(f"{e:.1e}" for e in errors[0])]
    return [*cells, *([f"{e[1]:.1e}" for e in errors[1:]] if row.group == V2 else ["", ""])]


def _reference_text(reference: Reference) -> str:
    def one(name: str, verdict: Verdict) -> str:
        worst = ", ".join(f"{e[1]:.0e} ({e[2]:.0e})" for e in verdict.errors)
        return f"{name}: {verdict.wrong} wrong, errors at 99 % (max) {worst}"

    return f"The reference itself, against {one('heyoka at 1e-15', reference.taylor)}; {one('scipy', reference.fine)}."


def summary(table: Table) -> str:
    """The ratios of medians, a line each, with the row's own spread."""
    lines = []
    for row in table.rows:
        times = table.times(row.name)
        if times is not None and not row.name.startswith("erosion"):
            rates = times * row.rate / max(row.rates), times * row.rate / min(row.rates)
            lines.append(f"{row.name}: the engine is {times:,.3g} × as fast ({rates[0]:,.3g}–{rates[1]:,.3g})")
    return "\n".join(lines)
