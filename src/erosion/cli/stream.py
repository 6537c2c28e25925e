"""x."""
def stream() -> None:
    """x."""
