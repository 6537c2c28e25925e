"""Times to a first answer, in fresh processes and after a model's edit in a running one.

    python -m benchmarks.first_answers [--rounds 9] [--no-peers]

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
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from benchmarks.timing import by_turns, spread_text, table_text

JAX = "import jax"
IMPORTS = "import jax, equinox, llvmlite.binding"
IMPACT = {0: "erosion.impact, V", 2: "erosion.impact, V, V′, V″"}
OPTIMUM = "erosion.alpha_max"
SCIPY = "the same angle by scipy"
RUN, RUN_OPTIMUM = "erosion run", "erosion optimum"

_ROOT = Path(__file__).parents[1]
_VOLUME, _ANGLE = "0.00010140", "25.57182"  # in³ at Table 1; °: what the answers begin with
_ANGLE_IN_TABLE = "25.572"  # as `erosion optimum` rounds it


class Start(NamedTuple):
    """A fresh process.

    Args:
        arguments: of Python.
        answer: must be in what it prints.
    """

    arguments: tuple[str, ...]
    answer: str = ""


def _code(text: str, answer: str = "") -> Start:
    return Start(("-c", text), answer)


def _impact(order: int) -> Start:
    code = f'import erosion; print(erosion.impact("rotating", erosion.TABLE_1, derivatives={order}).volume)'
    return _code(code, _VOLUME)


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
                   _ANGLE),
    SCIPY: Start(("benchmarks/scipy_optimum.py",), _ANGLE),
    RUN: Start(("-m", "erosion", "run", "--model", "rotating", "--json"), _VOLUME),
    RUN_OPTIMUM: Start(("-m", "erosion", "optimum", "--model", "rotating"), _ANGLE_IN_TABLE),
}  # fmt: skip
PEERS = {
    "heyoka scalar, V": _peer("heyoka_taylor", "order=0", _NOT_KEPT),
    "heyoka scalar, V, V′, V″": _peer("heyoka_taylor", "order=2", _NOT_KEPT),
    "heyoka batch refilled, V": _peer("heyoka_batch", "order=0", _NOT_KEPT),
    "heyoka batch refilled, V, V′, V″": _peer("heyoka_batch", "order=2", _NOT_KEPT),
    "diffrax Tsit5, V": _peer("diffrax_vmap", "'Tsit5', peer.TOLERANCES['Tsit5']"),
    "diffrax Dopri8, V": _peer("diffrax_vmap", "'Dopri8', peer.TOLERANCES['Dopri8']"),
    "scipy DOP853, V": _peer("scipy_dop853", ""),
}


class First(NamedTuple):
    """Seconds of every round.

    Args:
        starts: of fresh processes, by name.
        edits: from a model file's change to its first volume, by order of derivatives (0, 2).
    """

    starts: dict[str, list[float]]
    edits: dict[int, list[float]]


def first_answers(peers: bool, rounds: int, say: Callable[[str], None]) -> First:
    """Measure the package and, if asked, its peers."""
    starts = {**STARTS, **(PEERS if peers else {})}
    measures = {name: partial(_fresh, name, start) for name, start in starts.items()}
    say("Fresh processes")
    for measure in measures.values():
        measure()  # the system then has the files in memory
    seconds = by_turns(measures, rounds, say, seldom=PEERS)
    say("A model's edits")
    return First(seconds, _edits(rounds, say))


def _fresh(name: str, start: Start) -> float:
    """Seconds of a process from its start to its end."""
    with tempfile.TemporaryDirectory(prefix="nothing-kept-") as home:
        environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
        environment |= {"HOME": home, "XDG_CACHE_HOME": str(Path(home, ".cache"))}
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


def _edits(rounds: int, say: Callable[[str], None]) -> dict[int, list[float]]:
    """Change a number in a model's code, load it, compute: V, and after another change V, V′, V″."""
    seconds: dict[int, list[float]] = {0: [], 2: []}
    with tempfile.TemporaryDirectory(prefix="edited-") as folder:
        path, before = Path(folder, "growing_lip.py"), 0.0
        for order in seconds:
            _volume("rotating", order)
        for edit in range(2 * (rounds + 1)):
            order = 0 if edit % 2 else 2
            say(f"  edit {edit + 1} of {2 * (rounds + 1)}")
            path.write_text(MODEL.format(number=1 + edit / 16), encoding="utf-8")
            # Python tells versions of a file apart by whole seconds.
            os.utime(path, (edit, edit))
            took, volume = _volume(str(path), order)
            if math.isclose(volume, before, rel_tol=1e-5):
                raise RuntimeError(f"After an edit the volume was {volume}; before it {before}.")
            before = volume
            if edit >= 2:  # before, the file is new, not edited
                seconds[order].append(took)
    return seconds


def _volume(model: str, order: int) -> tuple[float, float]:
    """Seconds to load a model and compute its volume, and the volume."""
    import erosion

    begin = time.perf_counter()
    volume = erosion.impact(erosion.load_model(model), erosion.TABLE_1, derivatives=order).volume
    return time.perf_counter() - begin, float(volume)


def first_answers_text(first: First) -> str:
    """The tables of fresh processes and of edits."""
    jax = statistics.median(first.starts[JAX])
    rows = []
    for name, seconds in first.starts.items():
        after = "" if name == JAX else f"{statistics.median(seconds) - jax:+.2f}"
        rows.append([name, spread_text(seconds), after])
    edits = [[group, spread_text(first.edits[order])] for order, group in ((0, "V"), (2, "V, V′, V″"))]
    return "\n".join(
        [
            "## Fresh processes",
            "",
            "Seconds from the start of a process to its end, with one answer printed: median (min–max). Home and",
            "cache folder are empty, so that nothing is kept from another process. `alpha_max`, `erosion optimum` and",
            "the script `benchmarks/scipy_optimum.py` look for the same angle, 25.571827°. The peers take",
            "part in every third round.",
            "",
            table_text("process | s | after `import jax`", rows),
            "",
            "## A model's edit in a running process",
            "",
            "A number in the code of a plug-in changes; seconds until the file is loaded and one impact computed:",
            "median (min–max). The process has computed other impacts before.",
            "",
            table_text("first answer | s", edits),
        ]
    )


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.first_answers", description="First answers.")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--no-peers", action="store_true", help="without heyoka, diffrax and scipy")
    arguments = parser.parse_args()

    def say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    print(first_answers_text(first_answers(not arguments.no_peers, arguments.rounds, say)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
