"""Results -> matplotlib: one module for each kind of result, all in one style."""
