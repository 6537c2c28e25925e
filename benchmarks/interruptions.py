"""Commands that are killed or stopped at random moments: `python -m benchmarks.interruptions kill|stop`.

`kill` ends a command by SIGKILL, runs it again, and compares all its files bit for bit with those of an undisturbed
run. One in four kills comes at any moment, two while files are there or come, one while a draft is there. `stop`
presses Ctrl-C (SIGINT) at any moment between start and end, and looks at the exit status, at what is said, at the
seconds until the end (on the clock, and of the process's own computing), at what stays, and whether the command then
runs. `--verb map`, repeatable, chooses commands; `--times 20` says how often; `--seed` draws other moments.
`--cold` lets each command begin with an empty cache, so that JAX and LLVM compile; `--log` shows each time.

A table has a row for each command; what is not as it should be is told below it, and the exit status is 1.
"""

import argparse
import collections
import hashlib
import math
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from benchmarks.timing import table_text

_LONGEST = 300  # s, until a command counts as one that hangs
_TICKS = os.sysconf("SC_CLK_TCK")
_STREAM = ["--v0", "normal(4400, 40)", "--alpha", "normal(20 deg, 2 deg)"]
_FIT = ["sand.csv", "--density", "2700 kg/m^3", "--model", "linearized"]
_JET = ["--particle", "garnet 0.3 mm", "--target", "aluminium 6061", "--v0", "100 m/s"]
_RANGES = ["--alpha", "1deg:90deg:1000", "--v0"]
_MAP = ["map", "impacts.csv", "--surface", "plate.stl", "--model", "rotating"]
_POSTERIOR = ["--draws", "125", "-o", "post.nc"]

COMMANDS: dict[str, list[str]] = {
    "run": ["run", "--plot", "run.svg"],
    "compare": ["compare", "-o", "curves.nc", "--plot", "curves.svg"],
    "optimum": ["optimum", "--sensitivities", "--plot", "best.svg"],
    "sweep": ["sweep", "--model", "rotating", *_RANGES, "10 m/s:900 m/s:1500", "-o", "out.nc"],
    "sweep-zarr": ["sweep", "--model", "rotating", *_RANGES, "10 m/s:900 m/s:600", "--chunks", "alpha=100,v0=100",
                   "-o", "out.zarr"],
    "stream": ["stream", "--model", "rotating", *_STREAM, "--n", "3e5", "-o", "out.nc", "--plot", "out.svg"],
    "verify": ["verify", "--model", "rotating"],
    "calibrate": ["calibrate", *_FIT, "--plot", "fit.svg", "--write-case", "fit.toml"],
    "posterior": ["posterior", *_FIT, *_POSTERIOR, "--plot-pairs", "pairs.svg", "--plot-prediction", "band.svg"],
    "report": ["report", "--only", "q1,q4", "-o", "page"],
    "map": [*_MAP, "-o", "map.vtp"],
    "map-nc": [*_MAP, "-o", "map.nc"],
    "map-csv": [*_MAP, "-o", "map.csv"],
    "map-figure": [*_MAP, "-o", "map.csv", "--plot", "map.png"],
    "export": ["export", "--openfoam", "of.txt", "--fluent", "fl.txt", "--table", "V.csv", "--restitution", "e.csv"],
    "advise": ["advise", *_JET, "-o", "advice.html", "--plot", "advice.svg"],
    "exercise": ["exercise", "-o", "tasks.ipynb", "--solved", "solved.ipynb"],
    "models": ["models"],
    "explore": ["explore", "--no-browser", "--port", "0"],
}  # fmt: skip
_SERVES = "explore"  # it never ends by itself
_SERVED = 12.0  # s
_WRITE = [name for name, words in COMMANDS.items() if any(word.startswith(("-o", "--plot")) for word in words)]


class Ending(NamedTuple):
    """How a command that was killed or stopped ended, and what it left."""

    moment: float  # s after its start
    status: int | None  # None where it hung
    said: str
    seconds: float  # on the clock, from the signal to the end
    computed: float  # s of the process's own computing from the signal to the end
    files: list[str]
    drafts: list[str]


class Place:
    """A folder with the commands' inputs and caches; each command runs in a new folder beside them."""

    def __init__(self, root: Path, *, cold: bool) -> None:
        self.root, self.cold = root, cold
        self.inputs = root / "inputs"
        self.inputs.mkdir()
        _write_inputs(self.inputs)

    def folder(self) -> Path:
        """A new folder in which the inputs lie."""
        folder = self.root / "work"
        shutil.rmtree(folder, ignore_errors=True)
        if self.cold:
            shutil.rmtree(self.root / "cache", ignore_errors=True)
        shutil.copytree(self.inputs, folder)
        return folder

    def start(self, name: str, folder: Path) -> "subprocess.Popen[str]":
        """Start a command there."""
        return subprocess.Popen(
            [sys.executable, "-m", "erosion", *COMMANDS[name]],
            cwd=folder,
            env={**os.environ, "XDG_CACHE_HOME": str(self.root / "cache")},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            # A shell's background jobs ignore Ctrl-C, and so would all that they start.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )

    def whole(self, name: str, folder: Path) -> tuple[dict[str, str], float]:
        """Run a command to its end; digests of its files, and seconds."""
        begin = time.monotonic()
        process = self.start(name, folder)
        _, said = process.communicate(timeout=_LONGEST)
        if process.returncode:
            raise RuntimeError(f"{name} ended with status {process.returncode}: {said}")
        return self.digests(folder), time.monotonic() - begin

    def digests(self, folder: Path) -> dict[str, str]:
        """A digest of each file that is not an input."""
        paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        files = {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}
        return {path: digest for path, digest in files.items() if not (self.inputs / path).exists()}

    def left(self, folder: Path) -> list[str]:
        """All files and folders at the top that are not inputs."""
        return sorted(path.name for path in folder.iterdir() if not (self.inputs / path.name).exists())


def main() -> int:
    """Kill or stop, print a table, and fail where something is not as it should be."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.interruptions", description=__doc__)
    parser.add_argument("what", choices=["kill", "stop"])
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--verb", action="append", choices=list(COMMANDS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cold", action="store_true")
    parser.add_argument("--log", action="store_true")
    arguments = parser.parse_args()
    names = arguments.verb or (_WRITE if arguments.what == "kill" else list(COMMANDS))
    attack, head = (_kill, _KILL_HEAD) if arguments.what == "kill" else (_stop, _STOP_HEAD)
    rows, faults = [], []
    for name in names:
        log = _logger(name, shown=arguments.log)
        chance = random.Random(f"{arguments.what} {name} {arguments.seed}")
        with tempfile.TemporaryDirectory() as root:
            row, wrong = attack(name, Place(Path(root), cold=arguments.cold), arguments.times, chance, log)
        rows.append(row)
        faults += wrong
        print("  ".join(row), file=sys.stderr, flush=True)
    print(table_text(head, rows))
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors, seed {arguments.seed}")
    print("\n".join(faults) or "nothing that should not be")
    return 1 if faults else 0


Log = Callable[[Ending], None]
_KILL_HEAD = "command | whole [s] | kills | before a file | with files | with drafts | drafts after | not the same"
_STOP_HEAD = (
    "command | whole [s] | stops | status 130 | other | one line | wall [s] | worst | CPU [s] | worst | "
    "left files | drafts | next run wrong"
)


def _kill(name: str, place: Place, times: int, chance: random.Random, log: Log) -> tuple[list[str], list[str]]:
    place.whole(name, place.folder())
    expected, span = place.whole(name, place.folder())
    first, count = _files_of(name, place)
    outcomes, faults, drafts, wrong = [], [], 0, 0
    while len(outcomes) < times:
        folder = place.folder()
        outcome = _killed(name, place, folder, _moment_of_kill(len(outcomes), (first, span), count, chance))
        if outcome is None:  # it had ended before
            continue
        outcomes.append(outcome)
        log(outcome)
        try:
            files, _ = place.whole(name, folder)
            differ = sorted(path for path in {*files, *expected} if files.get(path) != expected.get(path))
        except (RuntimeError, subprocess.TimeoutExpired) as error:
            differ = [str(error)]
        stay = _drafts(folder)
        drafts, wrong = drafts + bool(stay), wrong + bool(differ)
        if stay or differ:
            faults.append(f"{name}, killed after {outcome.moment:.2f} s: drafts {stay}, different {differ}")
    bare = sum(not one.files for one in outcomes)
    drafted = sum(bool(one.drafts) for one in outcomes)
    counts = (len(outcomes), bare, len(outcomes) - bare, drafted, drafts, wrong)
    return [name, f"{span:.1f}", *map(str, counts)], faults


def _moment_of_kill(
    number: int, span: tuple[float, float], drafts: int, chance: random.Random
) -> Callable[[Path], Iterator[bool]]:
    """When to kill: gives, again and again, whether the moment has come."""
    kind = number % 4
    if kind == 0:
        return _after(chance.uniform(0, span[1]))
    if kind == 3 and drafts:
        return _at_draft(chance.randrange(drafts) + 1)
    return _after(chance.uniform(*span))


def _after(seconds: float) -> Callable[[Path], Iterator[bool]]:
    def moments(_: Path) -> Iterator[bool]:
        end = time.monotonic() + seconds
        while True:
            yield time.monotonic() >= end

    return moments


def _at_draft(count: int) -> Callable[[Path], Iterator[bool]]:
    """While the first, second, … draft is there that is seen."""

    def moments(folder: Path) -> Iterator[bool]:
        seen: set[str] = set()
        while True:
            seen |= set(_drafts(folder))
            yield len(seen) >= count

    return moments


def _killed(name: str, place: Place, folder: Path, moment: Callable[[Path], Iterator[bool]]) -> Ending | None:
    begin = time.monotonic()
    process = place.start(name, folder)
    for has_come in moment(folder):
        if process.poll() is not None:
            process.communicate()
            return None
        if has_come:
            break
        time.sleep(0.0005)
    process.kill()
    seconds = time.monotonic() - begin
    _, said = process.communicate()
    if process.returncode != -signal.SIGKILL:
        return None
    return Ending(seconds, process.returncode, said, 0.0, 0.0, place.left(folder), _drafts(folder))


def _files_of(name: str, place: Place) -> tuple[float, int]:
    """Seconds until the first file or draft is there, and how many drafts are seen."""
    folder = place.folder()
    begin = time.monotonic()
    process = place.start(name, folder)
    first, seen = 0.0, set()
    while process.poll() is None:
        seen |= set(_drafts(folder))
        first = first or (time.monotonic() - begin if place.left(folder) else 0.0)
        time.sleep(0.001)
    process.communicate()
    return first, len(seen)


def _stop(name: str, place: Place, times: int, chance: random.Random, log: Log) -> tuple[list[str], list[str]]:
    expected: dict[str, str] = {}
    span = _SERVED
    if name != _SERVES:
        place.whole(name, place.folder())
        expected, span = place.whole(name, place.folder())
    outcomes, faults, wrong = [], [], 0
    while len(outcomes) < times:
        folder = place.folder()
        outcome = _stopped(name, place, folder, chance.uniform(0, span))
        if outcome is None:  # it had ended before
            continue
        outcomes.append(outcome)
        log(outcome)
        differ = [] if name == _SERVES else _next_run(name, place, folder, expected)
        wrong += bool(differ)
        clean = outcome.status == 130 and outcome.said.count("\n") == 1 and not outcome.drafts and not differ
        if not clean:
            faults.append(
                f"{name}, stopped after {outcome.moment:.2f} s: status {outcome.status}, drafts {outcome.drafts}, "
                f"next run {differ or 'right'}, said {outcome.said[-300:]!r}"
            )
    return [name, f"{span:.1f}", *_stop_counts(outcomes), str(wrong)], faults


def _stop_counts(outcomes: list[Ending]) -> list[str]:
    statuses = collections.Counter(one.status for one in outcomes)
    others = " ".join(f"{status}×{count}" for status, count in statuses.items() if status != 130)
    lines = sum(one.said.count("\n") == 1 for one in outcomes)
    clock, own = [one.seconds for one in outcomes], [one.computed for one in outcomes]
    seconds = [f"{pick(values):.2f}" for values in (clock, own) for pick in (statistics.median, max)]
    names = collections.Counter(path for one in outcomes for path in one.files)
    left = " ".join(f"{path}×{count}" for path, count in names.items())
    drafts = sum(bool(one.drafts) for one in outcomes)
    return [*map(str, (len(outcomes), statuses[130])), others or "0", str(lines), *seconds, left or "0", str(drafts)]


def _stopped(name: str, place: Place, folder: Path, wait: float) -> Ending | None:
    process = place.start(name, folder)
    try:
        process.wait(wait)
    except subprocess.TimeoutExpired:
        pass
    else:
        process.communicate()
        return None
    used, begin = _computed(process.pid), time.monotonic()
    process.send_signal(signal.SIGINT)
    while (ended := _computed(process.pid, ended=True)) is None and time.monotonic() - begin < _LONGEST:
        time.sleep(0.002)
    seconds = time.monotonic() - begin
    computed = (ended or 0.0) - (used or 0.0)
    status = None
    if ended is None:
        process.kill()
    _, said = process.communicate()
    if ended is not None:
        status = process.returncode
    if status == 0:  # it was at its end
        return None
    return Ending(wait, status, said, seconds, computed, place.left(folder), _drafts(folder))


def _next_run(name: str, place: Place, folder: Path, expected: dict[str, str]) -> list[str]:
    """What is not as after an undisturbed run."""
    try:
        files, _ = place.whole(name, folder)
    except (RuntimeError, subprocess.TimeoutExpired) as error:
        return [str(error)]
    return sorted(path for path in {*files, *expected} if files.get(path) != expected.get(path))


def _computed(pid: int, *, ended: bool = False) -> float | None:
    """Processor seconds of a process's threads; with `ended`, None until it has ended and waits for its parent."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    if ended and fields[0] != "Z":
        return None
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _drafts(folder: Path) -> list[str]:
    ends = (".part", ".partial")
    return [
        os.path.relpath(Path(place, name), folder)
        for place, folders, files in os.walk(folder)
        for name in [*folders, *files]
        if name.endswith(ends)
    ]


def _logger(name: str, *, shown: bool) -> Log:
    def log(outcome: Ending) -> None:
        if shown:
            print(name, *(f"{field:.2f}" if isinstance(field, float) else field for field in outcome), file=sys.stderr)

    return log


def _write_inputs(folder: Path) -> None:
    """Measurements, and a plate with the impacts of a CFD run."""
    measured = [f"{angle},{5 * math.sin(angle / 30) ** 2 + 1:.4f},0.2\n" for angle in range(5, 90, 5)]
    (folder / "sand.csv").write_text("angle [deg],erosion [mm^3/kg],uncertainty [mm^3/kg]\n" + "".join(measured))
    (folder / "plate.stl").write_text(_plate(60))
    chance = random.Random(1)
    heads = ("x [m]", "y [m]", "z [m]", "u [m/s]", "v [m/s]", "w [m/s]", "diameter [um]", "density [kg/m^3]", "count")
    lines = [",".join(heads) + "\n"]
    for _ in range(60_000):
        x, y, size = chance.random(), chance.random(), chance.uniform(100, 300)
        steepness = chance.uniform(0.1, 1.4)
        u, w = 30 * math.cos(steepness), -30 * math.sin(steepness)
        lines.append(f"{x:.6f},{y:.6f},0,{u:.6f},0,{w:.6f},{size:.4f},2650,10\n")
    (folder / "impacts.csv").write_text("".join(lines))


def _plate(count: int) -> str:
    """A square metre of 2 count² triangles, seen from above by the particles; normals point out of the fluid."""
    facets = []
    for i in range(count):
        for j in range(count):
            (x, y), (far, deep) = (i / count, j / count), ((i + 1) / count, (j + 1) / count)
            facets += [((x, y), (far, deep), (far, y)), ((x, y), (x, deep), (far, deep))]
    corners = ("".join(f"vertex {x:.6f} {y:.6f} 0\n" for x, y in facet) for facet in facets)
    text = "".join(f"facet normal 0 0 -1\nouter loop\n{three}endloop\nendfacet\n" for three in corners)
    return f"solid plate\n{text}endsolid plate\n"


if __name__ == "__main__":
    sys.exit(main())
