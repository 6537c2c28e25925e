"""Where plain Newton on dV/dα, begun at the linearized answer ½ arctan k, goes wrong.

`python -m benchmarks.newton` prints the table that docs/optimum.md sums up.
"""

import numpy as np

import erosion

_P = erosion.TABLE_1
_CASES = [
    ("linearized", "Table 1", {}),
    ("finnie", "Table 1", {}),
    ("rotating", "Table 1", {}),
    ("rotating", "k = 1", {"k": 1.0}),
    ("rotating-full-torque", "k = 1", {"k": 1.0}),
    ("rotating", "s = 0.5", {"s": 0.5}),
    ("rotating", "s = -0.2", {"s": -0.2}),
    ("rotating", "s = -0.5", {"s": -0.5}),
    ("rotating-full-torque", "s = -0.37", {"s": -0.37}),
    ("rotating-tan-alpha", "Table 1", {}),
    ("tan-alpha", "Table 1", {}),
]


def newton(model: str, p: erosion.Parameters, steps: int = 30) -> tuple[float, str]:
    """Plain Newton on dV/dα: where it ends, and how."""
    alpha = float(np.arctan(p.k) / 2)
    for _ in range(steps):
        hit = erosion.impact(model, p.replace(alpha=alpha), derivatives=2)
        following = alpha - float(hit.dvolume / hit.d2volume) if hit.d2volume else np.nan
        if not 0 < following <= np.pi / 2:
            return following, "leaves (0°, 90°]"
        if abs(following - alpha) < 1e-12:
            return following, "a maximum" if hit.d2volume < 0 else "a minimum"
        alpha = following
    return alpha, f"does not settle in {steps} steps"


def main() -> None:
    """Print the table."""
    print("| model | case | Newton ends at | this is | V there / V_max | certified α_max | kind |")
    print("|---|---|---|---|---|---|---|")
    for model, case, changes in _CASES:
        changes = dict(changes)
        if "s" in changes:
            changes["phidot0"] = changes.pop("s") * float(_P.v0 / _P.r)
        p = _P.replace(**changes)
        best = erosion.alpha_max(model, p)
        alpha, what = newton(model, p)
        inside = 0 < alpha <= np.pi / 2
        share = float(erosion.impact(model, p.replace(alpha=alpha)).volume / best.volume) if inside else np.nan
        where = f"{np.rad2deg(alpha):.4f}°" if np.isfinite(alpha) else "–"
        answer = "α → 0" if best.alpha == 0 else f"{np.rad2deg(best.alpha):.6f}°"
        kind = f"{best.kind} {best.side}".strip()
        print(f"| {model} | {case} | {where} | {what} | {share:.4f} | {answer} | {kind} |".replace("nan", "–"))


if __name__ == "__main__":
    main()
