"""What was measured, as text: the same on the screen and in RESULTS.md."""

import importlib.metadata
import platform
import statistics
from pathlib import Path

from benchmarks import diffrax_vmap, heyoka_taylor, scipy_dop853
from benchmarks.cold import Cold
from benchmarks.contenders import LIMIT, V2
from benchmarks.measure import Row, Table
from benchmarks.reference import Reference
from benchmarks.work import Verdict

_PACKAGES = ("jax", "jaxlib", "diffrax", "optimistix", "heyoka", "scipy", "numpy", "numba", "llvmlite")

METHOD = f"""\
## Method

- One program, one process group, the same cores. Every contender gets all cores: the kernel and
  the blocks of diffrax by threads, heyoka and scipy by one spawned process per core, pinned to
  it, with interleaved shares. Everything is compiled and warmed up before it is timed; starting
  processes and moving data between them is not timed.
- The work: the rotating model at Table 1. Random: α evenly in (0.05, 1.5) rad and
  s = rφ̇0/v0 evenly in (−0.5, 0.5), a seeded sample. Ordered: the same range of α in order,
  s = 0. A contender with fewer impacts gets an evenly spread part of the same sample.
- Contenders run in rotation (A B C A B C …); rates are medians, with the least and the greatest.
  "×" is the kernel's rate over the row's, for the same quantities.
- Tolerances: the kernel's default, rtol = 1e-9. Each peer's is the loosest decade at which 99 % of
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
  (the kernel integrates the model as it is). `fast_math` on, `compact_mode` and `high_accuracy` off,
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
- **linearized** is one closed formula per impact (one array read, one written): what memory and
  trigonometry allow, not a solver. Only its rate is of interest.
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


def table_text(table: Table) -> str:
    """A table of rates, ratios and errors, one row a contender."""
    first = {}
    for row in table.rows:
        first.setdefault(row.group, row)
    lines = [
        f"## {table.title}",
        "",
        _reference_text(table.reference),
        "",
        "| contender | impacts | impacts/s, median (min–max) | × | wrong "
        "| error of V: median, 99 %, max | V′ 99 % | V″ 99 % |",
        "|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    lines += [_row_text(row, first[row.group]) for row in table.rows]
    return "\n".join(lines)


def _row_text(row: Row, kernel: Row) -> str:
    ratio = "" if row.group == LIMIT else f"{kernel.rate / row.rate:,.3g}"
    rates = f"{_number(row.rate)} ({_number(min(row.rates))}–{_number(max(row.rates))})"
    cells = [row.name, f"{row.lanes:,}", rates, ratio]
    if row.verdict is None:
        cells += ["", "", "", ""]
    else:
        errors = row.verdict.errors
        cells += [str(row.verdict.wrong), ", ".join(f"{e:.1e}" for e in errors[0])]
        cells += [f"{e[1]:.1e}" for e in errors[1:]] if row.group == V2 else ["", ""]
    return "| " + " | ".join(cells) + " |"


def _reference_text(reference: Reference) -> str:
    def one(name: str, verdict: Verdict) -> str:
        worst = ", ".join(f"{e[1]:.0e} ({e[2]:.0e})" for e in verdict.errors)
        return f"{name}: {verdict.wrong} wrong, errors at 99 % (max) {worst}"

    return f"The reference itself, against {one('heyoka at 1e-15', reference.taylor)}; {one('scipy', reference.fine)}."


def cold_text(results: dict[str, tuple[Cold, Cold]]) -> str:
    """Compile seconds and the time to the first answer."""
    lines = [
        "## Fresh processes",
        "",
        "Seconds, the caches of JAX and heyoka on disk off. First answer: from the start of the process to its end",
        "with one impact. Compile: what the first call takes more than the second (tracing, lowering,",
        "XLA; heyoka's and numba's own compilers), and XLA's part of it, with one impact and with 4,096.",
        "",
        "| contender | first answer | compile, 1 | of it XLA | compile, 4,096 | of it XLA |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for name, (one, many) in results.items():
        # The process also made a second call, which a user with one question does not make.
        cells = [f"{one.process - one.second:.2f}"]
        for cold in (one, many):
            cells += [f"{cold.first - cold.second:.2f}", f"{cold.xla:.2f}" if cold.xla else "–"]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def growth_text(results: list[tuple[int, float, float]]) -> str:
    """How the kernel's cost grows with the number of impacts."""
    lines = [
        "## How the kernel's cost grows",
        "",
        "| impacts | V: seconds | impacts/s | V, V′, V″: seconds | impacts/s |",
        "|--:|--:|--:|--:|--:|",
    ]
    for n, plain, second in results:
        lines.append(f"| {n:,} | {plain:.4f} | {_number(n / plain)} | {second:.4f} | {_number(n / second)} |")
    return "\n".join(lines)


def summary(table: Table) -> str:
    """The ratios of medians, a line each."""
    lines, kernels = [], {}
    for row in table.rows:
        kernel = kernels.setdefault(row.group, row)
        if row is not kernel and row.group != LIMIT:
            spread = statistics.median(kernel.rates) / max(row.rates), statistics.median(kernel.rates) / min(row.rates)
            lines.append(
                f"{row.name}: the kernel is {kernel.rate / row.rate:,.3g} × ({spread[0]:,.3g}–{spread[1]:,.3g})"
            )
    return "\n".join(lines)


def _number(rate: float) -> str:
    return f"{float(f'{rate:.3g}'):,.0f}"
