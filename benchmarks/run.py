"""The benchmark: `python -m benchmarks.run`, or `make bench`.

The kernel beside heyoka, diffrax, scipy and the closed form: the same work, on the same cores,
at the same verified accuracy. `--device gpu` needs JAX's own CUDA plugin beside the package.
"""

import argparse
import datetime as dt
import os
import sys
from pathlib import Path

RESULTS = Path(__file__).with_name("RESULTS.md")


def main() -> int:
    """Measure, print and write."""
    arguments = _arguments()
    gpu = arguments.device == "gpu"
    if not gpu:
        os.environ["JAX_PLATFORMS"] = "cpu"
    import jax

    if gpu and jax.default_backend() != "gpu":
        print(
            f"There is no CUDA GPU that JAX can see (its backend is {jax.default_backend()!r}): nothing was measured."
        )
        return 1
    _measure(arguments, gpu)
    return 0


def _measure(arguments: argparse.Namespace, gpu: bool) -> None:
    # After the choice of the platform: these import JAX.
    import jax

    from benchmarks import measure, report
    from benchmarks.pool import cores

    def say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    load = os.getloadavg()[0]
    if load > 1:
        say(f"The machine is busy (load {load:.1f}): do not quote these numbers.")
    repeats = arguments.repeats or (3 if arguments.quick else 7)
    tables = measure.tables(gpu, arguments.quick, repeats, arguments.only, say)
    device = jax.devices()[0].device_kind if gpu else f"{len(cores())} cores"
    parts = [
        "# Results of `make bench`",
        f"{arguments.date}. {report.machine(device)} Load average before the run: {load:.2f}. {repeats} repeats.",
        *(report.table_text(table) for table in tables),
    ]
    if not arguments.only:
        parts.append(report.growth_text(measure.growth(10**5 if arguments.quick else 10**7, say)))
        if not gpu:
            parts.append(report.cold_text(measure.colds(arguments.quick, say)))
    parts.append(report.METHOD)
    text = "\n\n".join(parts)
    print(text if arguments.full_text else text.removesuffix(report.METHOD))
    for table in tables:
        print(f"{table.title}\n{report.summary(table)}\n")
    if not (arguments.quick or arguments.only):
        path = RESULTS.with_name("RESULTS-gpu.md") if gpu else RESULTS
        path.write_text(text.rstrip() + "\n")
        say(f"written: {path.name}")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.run", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer impacts and peers, under a minute; writes no file")
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="peers whose name has one of these words")
    parser.add_argument("--device", choices=("cpu", "gpu"), default="cpu", help="gpu: the kernel and diffrax alone")
    parser.add_argument("--repeats", type=int, default=0, help="7, or 3 with --quick")
    parser.add_argument("--date", default=dt.date.today().isoformat(), help="of the run, for the report")
    parser.add_argument("--full-text", action="store_true", help="print the method too")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
