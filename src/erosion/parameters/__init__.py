"""Parameters of an impact: units, files and ranges.

`__init__.pyi` lists the names. Each is imported on its first use: units and materials need no JAX.
"""

from erosion.extras import on_use

__getattr__ = on_use(__name__, __file__)
