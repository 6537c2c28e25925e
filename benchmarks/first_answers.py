"""Times to a first answer, in fresh processes and after a model's edit in a running one.

    python -m benchmarks.first_answers [--rounds 9] [--no-old] [--no-peers]

A fresh process is timed from its start to its end, with an empty home and an empty cache folder: nothing
is kept from another process.
"""

import argparse
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

from benchmarks.old_engine import NEW, OLD, both, unpacked
from benchmarks.timing import Process, by_turns, spread_text, table_text

JAX = "import jax"
IMPORTS = "import jax, equinox, llvmlite.binding"
IMPACT = {0: "erosion.impact, V", 2: "erosion.impact, V, V′, V″"}
OPTIMUM = "erosion.alpha_max"
SCIPY = "the same angle by scipy"
RUN, RUN_OPTIMUM = "erosion run", "erosion optimum"

_ROOT = Path(__file__).parents[1]
_VOLUME, _ANGLE = "0.00010140", "25.57182"  # in³ at Table 1; °: what the answers begin with


class Start(NamedTuple):
    """A fresh process.

    Args:
        arguments: of Python.
        answer: must be in what it prints.
        both: whether the old engine is measured too.
    """

    arguments: tuple[str, ...]
    answer: str = ""
    both: bool = False


def _code(text: str, answer: str = "", both: bool = False) -> Start:
    return Start(("-c", text), answer, both)


def _impact(order: int) -> Start:
    code = f'import erosion; print(erosion.impact("rotating", erosion.TABLE_1, derivatives={order}).volume)'
    return _code(code, _VOLUME, both=True)


def _peer(module: str, arguments: str, before: str = "") -> Start:
    """One impact at Table 1 by a peer, with only what it needs itself imported."""
    head = f"{before}from benchmarks import {module} as peer; from benchmarks.work import one_impact; "
    return _code(f"{head}print(peer.prepare(one_impact(), {arguments})().volume[0])", _VOLUME)


_NOT_KEPT = "import heyoka; heyoka.llvm_state.set_diskcache_enabled(False); "
STARTS = {
    JAX: _code("import jax"),
    IMPORTS: _code("import jax, equinox, llvmlite.binding"),
    IMPACT[0]: _impact(0),
    IMPACT[2]: _impact(2),
    OPTIMUM: _code('import erosion, math; print(math.degrees(erosion.alpha_max("rotating", erosion.TABLE_1).alpha))',
                   _ANGLE, both=True),
    SCIPY: Start(("benchmarks/scipy_optimum.py",), _ANGLE),
    RUN: Start(("-m", "erosion", "run", "--model", "rotating", "--json"), _VOLUME, both=True),
    RUN_OPTIMUM: Start(("-m", "erosion", "optimum", "--model", "rotating"), _ANGLE, both=True),
}  # fmt: skip
PEERS = {
    "heyoka scalar, V": _peer("heyoka_scalar", "order=0", _NOT_KEPT),
    "heyoka scalar, V, V′, V″": _peer("heyoka_scalar", "order=2", _NOT_KEPT),
    "heyoka batch refilled, V": _peer("heyoka_batch", "order=0", _NOT_KEPT),
    "heyoka batch refilled, V, V′, V″": _peer("heyoka_batch", "order=2", _NOT_KEPT),
    "diffrax Tsit5, V": _peer("diffrax_vmap", "'Tsit5', peer.TOLERANCES['Tsit5']"),
    "diffrax Dopri8, V": _peer("diffrax_vmap", "'Dopri8', peer.TOLERANCES['Dopri8']"),
    "scipy DOP853, V": _peer("scipy_dop853", ""),
}


class First(NamedTuple):
    """Seconds of every round.

    Args:
        starts: of fresh processes, by name and engine (`NEW`, `OLD`).
        edits: from a model file's change to its first volume, by engine and order of derivatives (0, 2).
    """

    starts: dict[tuple[str, str], list[float]]
    edits: dict[tuple[str, int], list[float]]

    def start(self, name: str, engine: str = NEW) -> float:
        """The median of a fresh process."""
        return statistics.median(self.starts[name, engine])

    def edit(self, order: int, engine: str = NEW) -> float:
        """The median of a model's edit."""
        return statistics.median(self.edits[engine, order])


def first_answers(source: Path | None, peers: bool, rounds: int, say: Callable[[str], None]) -> First:
    """Measure both engines and, if asked, their peers; `source` is the old engine's folder."""
    starts = {**STARTS, **(PEERS if peers else {})}
    measures = {
        (name, engine): partial(_fresh, name, start, folder)
        for name, start in starts.items()
        for engine, folder in ((NEW, None), (OLD, source))
        if engine == NEW or (start.both and source is not None)
    }
    say("Fresh processes")
    for measure in measures.values():
        measure()  # the system then has the files in memory
    slow = [(name, engine) for name, engine in measures if engine == OLD or name in PEERS]
    seconds = by_turns(measures, rounds, say, seldom=slow)
    say("A model's edits")
    with both(source) as engines:
        return First(seconds, _edits(engines, rounds, say))


def _fresh(name: str, start: Start, source: Path | None) -> float:
    """Seconds of a process from its start to its end."""
    with tempfile.TemporaryDirectory(prefix="nothing-kept-") as home:
        environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
        environment |= {"HOME": home, "XDG_CACHE_HOME": str(Path(home, ".cache"))}
        if source is not None:
            environment["PYTHONPATH"] = str(source)
        begin = time.perf_counter()
        done = subprocess.run(
            [sys.executable, *start.arguments], cwd=_ROOT, env=environment, capture_output=True, text=True, check=False
        )
        seconds = time.perf_counter() - begin
    if done.returncode or start.answer not in done.stdout:
        raise RuntimeError(f"{name}: no answer {start.answer}, but\n{done.stdout}{done.stderr}")
    return seconds


MODEL = '''\
"""A lip that grows faster than the depth."""

import erosion


class GrowingLip(erosion.models.ForceLaw):
    """F_x = -c depth (1 + {number} depth/r), F_y = k F_x."""

    def __call__(self, state, tip, p):
        """Return (F_x, F_y)."""
        horizontal = -p.stiffness * tip.depth * (1 + {number} * tip.depth / p.r)
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        """k, which sets the time scale."""
        return p.k


model = erosion.models.Rotating(force=GrowingLip())
'''


def _edits(
    engines: Mapping[str, Process], rounds: int, say: Callable[[str], None]
) -> dict[tuple[str, int], list[float]]:
    """Change a number in a model's code, load it, compute: V, and after another change V, V′, V″."""
    seconds: dict[tuple[str, int], list[float]] = {(name, order): [] for order in (0, 2) for name in engines}
    with tempfile.TemporaryDirectory(prefix="edited-") as folder:
        path, before = Path(folder, "growing_lip.py"), 0.0
        for process in engines.values():
            process.call(_volume, "rotating", 0)
            process.call(_volume, "rotating", 2)
        for edit in range(2 * (rounds + 1)):
            order = 0 if edit % 2 else 2
            say(f"  edit {edit + 1} of {2 * (rounds + 1)}")
            path.write_text(MODEL.format(number=1 + edit / 16), encoding="utf-8")
            # Python tells versions of a file apart by whole seconds.
            os.utime(path, (edit, edit))
            answers = {name: process.call(_volume, str(path), order) for name, process in engines.items()}
            volumes = [volume for _, volume in answers.values()]
            agree = all(math.isclose(volume, volumes[0], rel_tol=1e-8) for volume in volumes)
            if not agree or math.isclose(volumes[0], before, rel_tol=1e-5):
                raise RuntimeError(f"After an edit the volumes were {volumes}; before it {before}.")
            before = volumes[0]
            if edit < 2:  # the file is new, not edited
                continue
            for name, (took, _) in answers.items():
                seconds[name, order].append(took)
    return seconds


def _volume(model: str, order: int) -> tuple[float, float]:
    """Seconds to load a model and compute its volume, and the volume."""
    import erosion

    begin = time.perf_counter()
    volume = erosion.impact(erosion.load_model(model), erosion.TABLE_1, derivatives=order).volume
    return time.perf_counter() - begin, float(volume)


def first_answers_text(first: First) -> str:
    """The tables of fresh processes and of edits."""
    jax = first.start(JAX)
    rows = []
    for (name, engine), seconds in first.starts.items():
        if engine == NEW:
            old = first.starts.get((name, OLD))
            after = "" if name == JAX else f"{statistics.median(seconds) - jax:+.2f}"
            rows.append([name, spread_text(seconds), after, *_compared(seconds, old)])
    edits = []
    for order, group in ((0, "V"), (2, "V, V′, V″")):
        new, old = first.edits[NEW, order], first.edits.get((OLD, order))
        edits.append([group, spread_text(new), *_compared(new, old)])
    return "\n".join(
        [
            "## Fresh processes",
            "",
            "Seconds from the start of a process to its end, with one answer printed: median (min–max). Home and",
            "cache folder are empty, so that nothing is kept from another process. `alpha_max`, `erosion optimum` and",
            "the script `benchmarks/scipy_optimum.py` look for the same angle, 25.571827°. The old engine and the",
            "peers take part in every third round.",
            "",
            table_text("process | s | after `import jax` | old engine, s | ×", rows),
            "",
            "## A model's edit in a running process",
            "",
            "A number in the code of a plug-in changes; seconds until the file is loaded and one impact computed:",
            "median (min–max). The process has computed other impacts before.",
            "",
            table_text("first answer | s | old engine, s | ×", edits),
        ]
    )


def _compared(new: list[float], old: list[float] | None) -> list[str]:
    return [spread_text(old), f"{statistics.median(old) / statistics.median(new):.3g}"] if old else ["", ""]


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.first_answers", description="First answers.")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--no-old", action="store_true", help="without the old engine")
    parser.add_argument("--no-peers", action="store_true", help="without heyoka, diffrax and scipy")
    arguments = parser.parse_args()

    def say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    with unpacked(not arguments.no_old) as source:
        first = first_answers(source, not arguments.no_peers, arguments.rounds, say)
    print(first_answers_text(first))
    return 0


if __name__ == "__main__":
    sys.exit(main())
