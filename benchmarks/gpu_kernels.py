"""Every kernel of the benchmark's problems, assembled by ptxas: `python -m benchmarks.gpu_kernels`, half an hour.

It needs no GPU. Printed are registers, spilled bytes and stack of each kernel, for each kind of GPU. A kernel that is
not assembled, or that has an inexact operation, fails the run. `--only TEXT` takes some problems.
"""

import argparse
import re
import subprocess
import sys
import time
from pathlib import Path

import erosion
from benchmarks.gpu import jobs_of_bits
from erosion.lanes import gpu
from erosion.lanes.graph import Graph
from erosion.lanes.thread_ir import thread_ir

_TARGETS = ("sm_80", "sm_90", "sm_100")
_INEXACT = re.compile(r"\S*\.(?:approx|ftz|full)\S*|\b(?:add|sub|mul|mad|div|sqrt|rcp)\.f(?:32|64)\b")
_LONGEST = 600  # seconds that ptxas may take


def ptxas() -> str:
    """The assembler of NVIDIA's package."""
    found = [str(path) for folder in sys.path for path in Path(folder).glob("nvidia/*/bin/ptxas")]
    if not found:
        raise FileNotFoundError("ptxas is missing: pip install nvidia-cuda-nvcc-cu12.")
    return found[0]


def assemble(code: str, target: str) -> str:
    """Registers, bytes of spills and bytes of stack of PTX."""
    command = [ptxas(), f"-arch={target}", "-v", "-", "-o", "/dev/null"]
    done = subprocess.run(command, input=code, text=True, capture_output=True, check=False, timeout=_LONGEST)
    if done.returncode:
        raise ValueError(done.stderr)
    stack, spills, registers = (
        re.search(pattern, done.stderr)
        for pattern in (r"(\d+) bytes stack", r"(\d+) bytes spill loads", r"Used (\d+) registers")
    )
    return " | ".join(match[1] if match else "?" for match in (registers, spills, stack))


def run() -> int:
    """Assemble and print; the number of kernels that failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", default="")
    asked = parser.parse_args()
    failed, name = 0, ""
    usual = gpu.Lanewise.__init__

    def kernel(graph: Graph, of_tapes: int) -> None:
        nonlocal failed
        begin = time.perf_counter()
        code = gpu.ptx(thread_ir(graph, of_tapes))
        lines, inexact = code.count("\n"), _INEXACT.findall(code)
        failed += bool(inexact)
        for target in _TARGETS:
            try:
                numbers = assemble(code, target)
            except (ValueError, subprocess.TimeoutExpired) as error:
                numbers, failed = f"FAILED: {error}", failed + 1
            print(f"{name} | {target} | {lines} | {numbers} | {time.perf_counter() - begin:.1f} s", flush=True)
        if inexact:
            print(f"{name}: INEXACT: {inexact[:5]}", flush=True)

    def compiled(self: gpu.Lanewise, function, examples, *, tapes: int = 0, **options) -> None:
        usual(self, function, examples, tapes=tapes, **options)
        kernel(gpu.flatten(self.closed), tapes)

    gpu.Lanewise.__init__ = compiled
    print(
        f"erosion {erosion.__version__}: problem | GPU | lines | registers | spill loads, bytes | stack, bytes | time"
    )
    for name, job in jobs_of_bits().items():
        if asked.only in name:
            job(3)()
    return failed


if __name__ == "__main__":
    sys.exit(run() > 0)
