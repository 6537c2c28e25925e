"""Speed and memory of the engine beside its peers, at the same verified accuracy: `make bench`."""

import os

# Where a lane has no root in its last step, diffrax ends the whole run: it gives NaN instead, which counts as a wrong
# lane. Equinox reads this when it is imported.
os.environ.setdefault("EQX_ON_ERROR", "nan")
