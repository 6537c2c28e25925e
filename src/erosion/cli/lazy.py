"""What the verbs use of the package, imported when a verb uses it: JAX alone takes a second. `lazy.pyi` lists it."""

from erosion.extras import on_use

__getattr__ = on_use(__name__, __file__)
