"""Numbers with as many digits as their errors leave them."""

import numpy as np

_PLAIN = 1e-4, 1e6  # sizes that are written without a power of ten


def rounded(value: float, size: float, least: int = 1) -> str:
    """A value whose last digit is the second one of its error; of four digits where that is not known.

    Args:
        value: the number.
        size: its error.
        least: digits of the value, however great its error is.
    """
    if not np.isfinite(value) or value == 0 or not (np.isfinite(size) and size > 0):
        return f"{value:.4g}"
    place = int(np.floor(np.log10(abs(value))))
    digits = max(2 - int(np.floor(np.log10(size))) + place, least)
    text = f"{value:.{digits - 1}e}"
    return f"{float(text):.{max(digits - 1 - place, 0)}f}" if _PLAIN[0] <= abs(value) < _PLAIN[1] else text
