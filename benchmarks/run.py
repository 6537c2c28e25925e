"""The benchmark: `python -m benchmarks.run`, or `make bench`.

The engine beside heyoka, diffrax and scipy: the same work, on the same cores, at the same verified
accuracy. Then first answers in fresh processes, and warm calls.
"""

import argparse
import datetime as dt
import os
import sys
from pathlib import Path

RESULTS = Path(__file__).with_name("RESULTS.md")


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def main() -> None:
    """Measure, print and write."""
    arguments = _arguments()
    os.environ["JAX_PLATFORMS"] = "cpu"
    # After the choice of the platform: these import JAX.
    from benchmarks import measure, report
    from benchmarks.first_answers import first_answers, first_answers_text
    from benchmarks.pool import cores
    from benchmarks.verbs import verbs, verbs_text

    load = os.getloadavg()[0]
    if load > 1:
        _say(f"The machine is busy (load {load:.1f}): do not quote these numbers.")
    repeats = arguments.repeats or (2 if arguments.quick else 9)
    tables = measure.tables(arguments.quick, repeats, arguments.only, _say)
    sections = []
    if not arguments.only:
        _say("Warm calls")
        calls = verbs(20 if arguments.quick else 1, repeats // 2 + 1, _say)
        first = first_answers(not arguments.quick, 1 if arguments.quick else repeats, _say)
        sections = [first_answers_text(first), verbs_text(calls)]
    machine = report.machine(f"{len(cores())} cores")
    parts = [
        "# Results of `make bench`",
        f"{arguments.date}. {machine} Load average before the run: {load:.2f}. {repeats} repeats.",
        *(report.rates_text(table) for table in tables),
        *sections,
        report.METHOD,
    ]
    text = "\n\n".join(parts)
    print(text if arguments.full_text else text.removesuffix(report.METHOD))
    for table in tables:
        print(f"{table.title}\n{report.summary(table)}\n")
    if not (arguments.quick or arguments.only):
        RESULTS.write_text(text.rstrip() + "\n", encoding="utf-8")
        _say(f"written: {RESULTS.name}")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.run", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer impacts and peers, minutes; writes no file")
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="peers whose name has one of these words")
    parser.add_argument("--repeats", type=int, default=0, help="9, or 2 with --quick")
    parser.add_argument("--date", default=dt.date.today().isoformat(), help="of the run, for the report")
    parser.add_argument("--full-text", action="store_true", help="print the method too")
    return parser.parse_args()


if __name__ == "__main__":
    main()
