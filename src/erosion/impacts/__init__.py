"""Impacts: one or many, followed by steps, and the angle at which most is removed.

`__init__.pyi` lists the names. Each is imported on its first use: a worker of a cluster is pinned before JAX loads.
"""

from erosion.extras import on_use

__getattr__ = on_use(__name__, __file__)
