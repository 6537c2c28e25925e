"""Names of the package that verbs import on use, as JAX takes a second. `lazy.pyi` lists them."""

from erosion.extras import on_use

__getattr__ = on_use(__name__, __file__)
