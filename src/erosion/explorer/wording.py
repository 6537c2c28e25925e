"""Errors as the page says them."""

_LONGEST = 300  # characters; a link or an entry may repeat as many as it likes


def sentence(error: BaseException) -> str:
    """An error in one line of bounded length. What is an argument in Python is a field here."""
    line = " ".join(str(error).split()).replace("Argument `", "Field `") or type(error).__name__
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]} …"
