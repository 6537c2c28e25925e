"""Mistakes on the command line as one sentence about options, in letters that the terminal has."""

import codecs
import contextlib
import functools
import re
import sys
import unicodedata
from collections.abc import Iterator, Mapping

import cyclopts
from cyclopts import exceptions

from erosion.output import briefly
from erosion.parameters import about
from erosion.results import Finding

_POWERS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻ⁿ", "0123456789-n")
_SPELLED = {
    "α": "alpha", "β": "beta", "Δ": "D", "μ": "u", "µ": "u", "π": "pi", "ρ": "rho", "σ": "sigma", "Σ": "sum ",
    "φ": "phi", "ψ": "psi", "χ": "chi", "ω": "omega", "∂": "d", "′": "'", "\u0307": "'", "\u0304": "", "ẋ": "x'",
    "ẏ": "y'", "°": "deg", "₀": "0", "₁": "1", "₂": "2", "─": "-", "│": "|", "–": "-", "…": "...", "×": "x", "·": "*",
    "±": "+-", "≤": "<=", "≥": ">=", "→": "->", "✓": "+", "✗": "x", "√": "sqrt ", "½": "1/2", "∞": "inf",
}  # fmt: skip

_ENDLESS = 1000  # letters without a space; paths may be long


def spell_out() -> None:
    """Have stdout and stderr spell what their encoding lacks; what has no spelling appears as its number."""
    codecs.register_error("erosion-spelled", _spelled)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="erosion-spelled")  # pyrefly: ignore


def _spelled(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text, at = error.object, error.start
    if ord(text[at]) in _POWERS:
        begins = at == 0 or ord(text[at - 1]) not in _POWERS
        return "^" * begins + text[at].translate(_POWERS), at + 1
    if text[at] in _SPELLED:
        return _SPELLED[text[at]], at + 1
    return codecs.backslashreplace_errors(UnicodeEncodeError(error.encoding, text, at, at + 1, error.reason))


def printable(text: str) -> str:
    """A message for a terminal: what a terminal would obey is escaped, and an endless word is cut."""
    text = "".join(
        letter.encode("unicode_escape").decode() if unicodedata.category(letter) in ("Cc", "Cf") else letter
        for letter in text
    )
    return re.sub(rf"\S{{{_ENDLESS},}}", lambda word: f"{word[0][:40]}… ({len(word[0]):,} characters)", text)


def warn(finding: Finding) -> None:
    """A finding on stderr, where there is one; arguments of Python are options here."""
    if sys.stderr is not None:
        print(f"{finding.level}: {printable(as_options(finding.text))}", file=sys.stderr)


_NO_FIELDS: Mapping[str, str] = {}


class InputError(ValueError):
    """Something the user gave that cannot be used; the message is one sentence."""


@contextlib.contextmanager
def input_errors(*kinds: type[Exception], fields: Mapping[str, str] = _NO_FIELDS) -> Iterator[None]:
    """Errors of these kinds become `InputError`; Python's arguments are options here, or fields of a file."""
    try:
        yield
    except kinds as error:
        raise InputError(as_options(sentence(error), fields)) from error


def user_errors(
    *also: type[Exception], fields: Mapping[str, str] = _NO_FIELDS
) -> contextlib.AbstractContextManager[None]:
    """See `input_errors`, of the kinds that what the user gave causes, and others."""
    return input_errors(ValueError, OSError, *also, fields=fields)


def as_options(text: str, fields: Mapping[str, str] = _NO_FIELDS) -> str:
    """A sentence about Python's arguments as one about options, or about the fields of a file that give them."""
    names = {**_OPTIONS, **fields}
    # What a plug-in's own code says after "ValueError: " is not about options.
    return re.sub(
        r"(?<!Error: )\bArgument `(\w+)`",
        lambda argument: names.get(argument[1], f"Option `--{argument[1].replace('_', '-')}`"),
        text,
    )


reading = functools.partial(about, kind=InputError)
"""What a reader says of a text, "must be …", becomes an `InputError` about an option or a field of a file."""


def sentence(error: Exception) -> str:
    """The text of an error, without Python's "[Errno 2]"."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'The output cannot be written'}: {error.strerror}."
    if isinstance(error, UnicodeDecodeError):
        return "A file that a library reads is not text in UTF-8: look for a `matplotlibrc`."
    return str(error) or type(error).__name__


_OPTIONS = {
    "models": "Option `--model`",
    "priors": "Option `--prior`",
    "store": "Option `--output`",
    "data": "The table",
    "unit": "Option `--surface-unit`",
}
"""Python's arguments that have another name on the command line."""


_NEGATIVE = re.compile(r"-[\d.]")


def explain(error: cyclopts.CycloptsError) -> str:
    """One sentence on what was typed wrong."""
    match error:
        case exceptions.UnknownOptionError():
            word = error.token.keyword or error.token.value
            if option := _option_before(error, word):
                return f"Option `{option}` must not have a negative value, but has {word}."
            near = re.search(r" Did you mean .*\?", str(error))
            return f"Option `{word}` is unknown.{near[0] if near else ''}"
        case exceptions.RepeatArgumentError():
            return f"Option `{error.token.keyword}` must be given once, but is given several times."
        case exceptions.MissingArgumentError(argument=argument) if argument is not None:
            option = error.keyword or argument.name
            if word := _negative_after(error, option):
                return f"Option `{option}` must not have a negative value, but has {word}."
            return f"Option `{option}` must {_one_of(argument)}, but has none."
        # What a converter of ours says; cyclopts has no words of its own here.
        case exceptions.CoercionError(argument=argument, msg=str() as said) if argument is not None:
            return f"Option `{argument.name}` {said}."
        case exceptions.ValidationError(argument=argument, exception_message=str() as said) if argument is not None:
            return f"Option `{argument.name}` {said}."
        case exceptions.CoercionError(argument=argument, token=token, target_type=kind) if (
            argument is not None and token is not None
        ):
            if kind is float:
                return f"Option `{argument.name}` must be a number such as 0.5, but is {briefly(token.value)}."
            value = briefly(token.value)
            if argument.get_choices(force=True):
                return f"Option `{argument.name}` must {_one_of(argument)}, but has {value}."
            return f"Option `{argument.name}` must have a value that makes sense, but has {value}: see --help."
        case exceptions.UnknownCommandError(unused_tokens=[word, *_]) if error.app is not None:
            known = ", ".join(name for name in error.app if not name.startswith("-"))
            return f"There is no command {word!r}; there are {known}."
        case exceptions.UnusedCliTokensError(unused_tokens=[word, *_]):
            return f"The word {word!r} belongs to no option."
        case _:
            return " ".join(str(error).split())


def _one_of(argument: cyclopts.Argument) -> str:
    """What an option must have: one of its choices, where it has some."""
    choices = argument.get_choices(force=True)
    return f"have one of the values {', '.join(choices)}" if choices else "have a value"


def _option_before(error: exceptions.UnknownOptionError, word: str) -> str | None:
    """The option that a negative value such as -5deg follows, which cyclopts takes for an option."""
    words = error.root_input_tokens or []
    if not _NEGATIVE.match(word) or word not in words:
        return None
    return next((option for option in reversed(words[: words.index(word)]) if option.startswith("--")), None)


def _negative_after(error: exceptions.MissingArgumentError, option: str) -> str | None:
    """The negative value that follows an option, and that cyclopts takes for another one."""
    words = error.root_input_tokens or []
    following = words[words.index(option) + 1 :] if option in words else []
    return following[0] if following and _NEGATIVE.match(following[0]) else None
