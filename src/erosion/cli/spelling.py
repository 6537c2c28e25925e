"""Greek letters, powers and lines for a terminal that lacks them, in place of an error after all was computed."""

import codecs
import sys

_POWERS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_SPELLED = {
    "α": "alpha", "β": "beta", "Δ": "D", "μ": "u", "µ": "u", "π": "pi", "ρ": "rho", "σ": "sigma", "Σ": "sum ",
    "φ": "phi", "ψ": "psi", "χ": "chi", "ω": "omega", "∂": "d", "′": "'", "\u0307": "'", "\u0304": "", "ẋ": "x'",
    "ẏ": "y'", "°": "deg", "₀": "0", "₁": "1", "₂": "2", "─": "-", "│": "|", "–": "-", "…": "...", "×": "x", "·": "*",
    "±": "+-", "≤": "<=", "≥": ">=", "→": "->", "✓": "+", "✗": "x", "√": "sqrt ", "½": "1/2", "∞": "inf",
}  # fmt: skip


def spell_out() -> None:
    """Have stdout and stderr spell what their encoding lacks; what has no spelling appears as its number."""
    codecs.register_error("erosion-spelled", _spelled)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="erosion-spelled")  # pyright: ignore[reportAttributeAccessIssue]


def _spelled(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text, at = error.object, error.start
    if ord(text[at]) in _POWERS:
        begins = at == 0 or ord(text[at - 1]) not in _POWERS
        return "^" * begins + text[at].translate(_POWERS), at + 1
    if text[at] in _SPELLED:
        return _SPELLED[text[at]], at + 1
    return codecs.backslashreplace_errors(UnicodeEncodeError(error.encoding, text, at, at + 1, error.reason))
