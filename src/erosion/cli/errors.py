"""What is wrong with what the user gave, in one sentence about options."""

import contextlib
import re
from collections.abc import Iterator

from erosion.parameters.units import about


class InputError(ValueError):
    """Something the user gave that cannot be used; the message is one sentence."""


@contextlib.contextmanager
def user_errors(*also: type[Exception]) -> Iterator[None]:
    """Errors of what the user gave become `InputError`; Python's arguments are options here."""
    try:
        yield
    except (ValueError, OSError, *also) as error:
        raise InputError(as_options(sentence(error))) from error


def as_options(text: str) -> str:
    """A sentence about Python's arguments as one about options."""
    # What a plug-in's own code says after "ValueError: " is not about options.
    return re.sub(r"(?<!Error: )\bArgument `(\w+)`", _as_option, text)


def reading(source: str) -> contextlib.AbstractContextManager[None]:
    """What a reader says of a text, "must be …", becomes an `InputError` about an option or a field of a file."""
    return about(source, InputError)


def sentence(error: Exception) -> str:
    """What an error says, without Python's "[Errno 2]"."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'The output cannot be written'}: {error.strerror}."
    return str(error) or type(error).__name__


_OPTIONS = {
    "models": "Option `--model`",
    "priors": "Option `--prior`",
    "store": "Option `--output`",
    "data": "The table",
    "candidates": "Option `--next-speeds`",
    "unit": "Option `--surface-unit`",
}
"""Python's arguments that have another name on the command line."""


def _as_option(argument: re.Match[str]) -> str:
    return _OPTIONS.get(argument[1], f"Option `--{argument[1].replace('_', '-')}`")
