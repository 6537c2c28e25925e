"""Inputs of wrong types, in a process of its own: in the tests' own, beartype would be the first to complain."""

import contextlib
import io
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).parents[2]


def without_type_checks(kind: str, rows: Sequence[Any], folder: Path) -> list[Any]:
    """What becomes of each row, in one process that works in `folder`.

    Args:
        kind: "python" for expressions, of which come [type, message] of what they raise;
            "command" for lists of words, of which come [status, stdout, stderr].
        rows: what to run.
        folder: where.
    """
    code = f"import sys; sys.path.insert(0, {str(_ROOT)!r}); from tests.bad_input import unchecked; unchecked.main()"
    command = [sys.executable, "-W", "error", "-c", code]
    text = json.dumps([kind, rows])
    found = subprocess.run(command, cwd=folder, input=text, capture_output=True, text=True, timeout=300, check=False)
    assert found.returncode == 0, found.stderr
    return json.loads(found.stdout)


def main() -> None:
    """Run the rows on stdin, and print what became of them."""
    kind, rows = json.load(sys.stdin)
    run = {"python": _raised, "command": _said}[kind]
    print(json.dumps([run(row) for row in rows]))


def _raised(expression: str) -> list[str]:
    import jax
    import jax.numpy as jnp
    import numpy as np
    import pandas as pd
    import xarray as xr

    import erosion

    names = {
        "np": np,
        "jax": jax,
        "jnp": jnp,
        "pd": pd,
        "xr": xr,
        "erosion": erosion,
        "P": erosion.TABLE_1,
        **vars(erosion.distributions),
    }
    own = erosion.load_model(_ROOT / "models" / "coulomb_tip.py")
    data = {"angle [deg]": [10.0, 20.0, 30.0], "erosion [-]": [1.0, 2.0, 3.0]}
    try:
        eval(expression, {**names, "DATA": data, "OWN": own})
    except Exception as error:  # noqa: BLE001 (whatever it is, it is what the row is about)
        return [type(error).__name__, str(error)]
    return ["", "nothing was raised"]


def _said(words: Sequence[str]) -> list[Any]:
    from erosion.cli import _status

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = _status(words)
    return [status, out.getvalue(), err.getvalue()]
