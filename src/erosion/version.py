"""The version, in one place, and since when it runs."""

import time

__version__ = "0.1.0"

IMPORTED = time.time_ns()
"""When the package was imported [ns]: what is written into its files later is not what runs."""
