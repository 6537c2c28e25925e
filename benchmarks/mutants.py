"""How many small random faults in fifteen modules the tests catch: `python -m benchmarks.mutants --count 300`.

Each fault changes one operator, number, comparison or keyword of one module (cosmic-ray's operators), in a copy of the
package. The tests of the folders named beside the module run on that copy until one fails: first the fast ones, then
the slow ones. A fault that no test sees is printed with its line. `--suite` names another checkout whose tests run
instead, so that two suites can be compared on the same faults.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).parents[1]

MODULES = {
    "cfd/incidence.py": ["cfd"],
    "cfd/rows.py": ["cfd"],
    "correlations/families.py": ["correlations", "models/test_correlated.py"],
    "fits/calibration.py": ["fits"],
    "fits/least_squares.py": ["fits"],
    "impacts/optimum.py": ["impacts"],
    "impacts/trajectory.py": ["impacts"],
    "lanes/scalars.py": ["lanes"],
    "laws.py": ["test_laws.py", "streams", "fits/test_posterior.py"],
    "models/parts.py": ["models", "impacts"],
    "models/rigid.py": ["models", "impacts"],
    "ode/resolve.py": ["ode", "impacts"],
    "parameters/parameters.py": ["parameters", "bad_input"],
    "streams/tally.py": ["streams"],
    "sweeps/grid.py": ["sweeps"],
}
"""Modules that are mutated, with the folders or files below tests/ that test them."""

KINDS = (
    "Number",
    "Comparison",
    "BinaryOperator",
    "Unary",
    "AndWithOr",
    "OrWithAnd",
    "AddNot",
    "TrueWithFalse",
    "FalseWithTrue",
    "ZeroIteration",
)
UNLIKELY = ("BitOr", "BitAnd", "BitXor", "Shift", "Invert", "Is")
"""Parts of names of operators whose faults nobody makes, or that are annotations."""


@dataclass(frozen=True)
class Fault:
    """One change of one module."""

    module: str
    operator: str
    occurrence: int
    line: int
    before: str
    after: str


def faults_of(module: str) -> list[tuple[str, str, int]]:
    """Every change that an operator can make: (kind, operator, occurrence)."""
    tree = get_ast((ROOT / "src/erosion" / module).read_text())
    found = []
    for name in operator_names():
        kind = next((kind for kind in KINDS if kind in name), None)
        if kind is None or any(part in name for part in UNLIKELY):
            continue
        positions = sum(len(list(get_operator(name)().mutation_positions(node))) for node in ast_nodes(tree))
        found += [(kind, name, occurrence) for occurrence in range(positions)]
    return found


def without_annotations(code: str) -> str:
    """The syntax tree of what runs: annotations and docstrings are left out."""
    tree = ast.parse(code)
    for node in ast.walk(tree):
        for field in ("annotation", "returns"):
            if getattr(node, field, None) is not None:
                setattr(node, field, None)
    return ast.dump(tree)


def drawn(count: int, seed: int) -> list[Fault]:
    """As many faults of each module, and of each kind within a module, as far as it has them."""
    dice = random.Random(seed)
    faults: list[Fault] = []
    for index, module in enumerate(MODULES):
        code = (ROOT / "src/erosion" / module).read_text()
        wanted = count * (index + 1) // len(MODULES) - count * index // len(MODULES)
        by_kind: dict[str, list[tuple[str, int]]] = {}
        for kind, name, occurrence in faults_of(module):
            by_kind.setdefault(kind, []).append((name, occurrence))
        here: list[Fault] = []
        while len(here) < wanted and by_kind:
            kind = dice.choice(sorted(by_kind))
            name, occurrence = by_kind[kind].pop(dice.randrange(len(by_kind[kind])))
            if not by_kind[kind]:
                del by_kind[kind]
            changed = mutate_code(code, get_operator(name)(), occurrence)
            try:
                same = changed is None or without_annotations(changed) == without_annotations(code)
            except SyntaxError:
                continue
            if same:
                continue
            pairs = zip(code.splitlines(), changed.splitlines(), strict=False)
            line, (old, new) = next((n, pair) for n, pair in enumerate(pairs, 1) if pair[0] != pair[1])
            if "strict=" in old and name.endswith("TrueWithFalse"):
                continue  # `zip(strict=True)` guards the programmer
            here.append(Fault(module, name.removeprefix("core/"), occurrence, line, old.strip(), new.strip()))
        faults += here
    return faults


def planted(fault: Fault, code: str) -> str | None:
    """A module of another version with the fault in it; None if the line is not there, or more than once."""
    if code == (ROOT / "src/erosion" / fault.module).read_text():
        return mutate_code(code, get_operator("core/" + fault.operator)(), fault.occurrence)
    lines = code.split("\n")
    places = [n for n, line in enumerate(lines) if line.strip() == fault.before]
    if len(places) != 1:
        return None
    old = lines[places[0]]
    lines[places[0]] = old[: len(old) - len(old.lstrip())] + fault.after
    return "\n".join(lines)


def seen(fault: Fault, suite: Path, limit: float) -> tuple[str, float]:
    """How a suite sees a fault: by "fast" or "slow" tests, by a "timeout", "missed", or "absent" from its version."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / "src"
        shutil.copytree(suite / "src", copy, ignore=shutil.ignore_patterns("__pycache__"))
        target = copy / "erosion" / fault.module
        changed = planted(fault, target.read_text()) if target.exists() else None
        if changed is None:
            return "absent", 0.0
        target.write_text(changed)
        environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
        paths = [str(suite / "tests" / path) for path in MODULES[fault.module] if (suite / "tests" / path).exists()]
        for speed, marks in (("fast", "not slow"), ("slow", "slow")):
            options = ["-x", "-q", "-p", "no:cacheprovider", "-m", f"{marks} and not browser"]
            command = [sys.executable, "-m", "pytest", *options, *paths]
            try:
                ended = subprocess.run(
                    command, cwd=suite, env=environment, capture_output=True, timeout=limit, check=False
                )
            except subprocess.TimeoutExpired:
                return "timeout", time.perf_counter() - begin
            if ended.returncode not in (0, 5):
                return speed, time.perf_counter() - begin
    return "missed", time.perf_counter() - begin


def main() -> None:
    """Draw faults, run the tests on each, and print what was missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--suite", type=Path, default=ROOT, help="a checkout whose tests run")
    parser.add_argument("--limit", type=float, default=600.0, help="seconds after which a run counts as caught")
    parser.add_argument("--modules", nargs="+", choices=MODULES, default=list(MODULES))
    parser.add_argument("--part", default="0/1", help="i/n: every n-th fault from the i-th")
    parser.add_argument("--only", type=Path, help="a file of results: the faults that it lists as missed")
    parser.add_argument("--out", type=Path, default=Path("mutants.json"))
    asked = parser.parse_args()
    faults = [fault for fault in drawn(asked.count, asked.seed) if fault.module in asked.modules]
    if asked.only:
        listed = json.loads(asked.only.read_text())
        missed = {(row["module"], row["operator"], row["occurrence"]) for row in listed if row["seen"] == "missed"}
        faults = [fault for fault in faults if (fault.module, fault.operator, fault.occurrence) in missed]
    part, parts = map(int, asked.part.split("/"))
    rows = []
    for fault in faults[part::parts]:
        by, seconds = seen(fault, asked.suite.resolve(), asked.limit)
        rows.append({**asdict(fault), "seen": by, "seconds": round(seconds, 1)})
        asked.out.write_text(json.dumps(rows, indent=1))
        if by == "missed":
            print(f"missed: {fault.module}:{fault.line}  {fault.before}  →  {fault.after}", flush=True)
    for module in MODULES:
        here = [row for row in rows if row["module"] == module]
        if here:
            print(f"{module:28} {sum(row['seen'] != 'missed' for row in here):3} of {len(here)} caught")
    print(f"{sum(row['seen'] != 'missed' for row in rows)} of {len(rows)} caught")


if __name__ == "__main__":
    main()
