"""Shape and type checks of every function are on during tests, and only then."""

from jaxtyping import install_import_hook

# Before anything of the package is imported.
_hook = install_import_hook("erosion", "beartype.beartype")
_hook.__enter__()
