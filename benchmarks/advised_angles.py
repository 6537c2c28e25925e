"""Does `erosion advise` find the best angle after six weighings? `python -m benchmarks.advised_angles`, minutes.

Each of five correlations is taken for the truth. Six angles are weighed with 8 % scatter, `erosion calibrate` fits them
as README.md has it, and `erosion advise` reads its file. Counted is what the advised angle removes of the most.
"""

import argparse
import contextlib
import io
import json
import tempfile
import warnings
from pathlib import Path

import numpy as np

import erosion
from erosion.cli import main

CASE = ("--particle", "garnet 80 mesh", "--target", "mild steel", "--v0", "160 m/s")
FIT = ("--model", "linearized-deformation,rotating-deformation", "--free", "k,psi,energy_ratio")
WEIGHED = np.arange(15.0, 91.0, 15.0)  # degrees
SCATTER = 0.08
FINE = np.arange(0.5, 90.1, 0.25)  # degrees
P = erosion.TABLE_1.to("si").with_particle("garnet 80 mesh").with_target("mild steel").replace(v0=160.0)
DENSITY = 7850.0  # kg/m³


def _printed(*arguments: str) -> str:
    said, none = io.StringIO(), io.StringIO()
    # A failure ends the command, and prints nothing that could be read.
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(none), contextlib.suppress(SystemExit):
        main(arguments)
    return said.getvalue()


def share(loss: np.ndarray, rng: np.random.Generator, folder: Path) -> tuple[float, float]:
    """The advised angle [°], and what it removes over the most, where `loss` is the truth at `FINE` [mg/kg]."""
    rows = np.interp(WEIGHED, FINE, loss) * (1 + SCATTER * rng.standard_normal(WEIGHED.size))
    table, fitted = folder / "rows.csv", folder / "fitted.toml"
    lines = [f"{angle:g}, {row:.6g}\n" for angle, row in zip(WEIGHED, rows, strict=True)]
    table.write_text("angle [deg], mass_loss [mg/kg]\n" + "".join(lines))
    _printed("calibrate", str(table), *FIT, "--write-case", str(fitted), *CASE)
    alpha = float(np.rad2deg(_alpha(json.loads(_printed("advise", str(fitted), "--json")))))
    return alpha, float(np.interp(alpha, FINE, loss) / loss.max())


def _alpha(document: dict) -> float:
    found = [document, *(part for part in document.values() if isinstance(part, dict))]
    return next(part["alpha"]["value"] for part in found if "alpha" in part and "low" in part)


def run() -> None:
    """Print for each correlation the sets whose advised angle removes at least 95 % of the most."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=20, help="data sets of each correlation")
    sets = parser.parse_args().sets
    warnings.simplefilter("ignore")
    total = 0
    with tempfile.TemporaryDirectory() as folder:
        names = [name for name in erosion.target("mild steel").correlations if name != "finnie-cfd"]
        for at, name in enumerate(names):
            volume = erosion.impact(erosion.load_model(name), P.replace(alpha=np.deg2rad(FINE))).volume
            loss = np.asarray(volume) / float(P.m) * DENSITY * 1e6
            found = [share(loss, np.random.default_rng([40, s, at]), Path(folder)) for s in range(sets)]
            good = sum(removed >= 0.95 for _, removed in found)
            angles, shares = zip(*found, strict=True)
            best = FINE[loss.argmax()]
            print(f"{name}: best {best:g}°, advised {min(angles):.0f}° to {max(angles):.0f}°, "
                  f"{good} of {sets} remove at least 95 %, the least {min(shares):.1%}", flush=True)  # fmt: skip
            total += good
    print(f"{total} of {sets * len(names)}")


if __name__ == "__main__":
    run()
