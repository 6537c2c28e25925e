"""Mistakes on the command line, in the words of all other messages."""

import re

import cyclopts
from cyclopts import exceptions

from erosion.parameters.units import shown

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
            return f"Option `{option}` must have a value, but has none."
        # What a converter of ours says; cyclopts has no words of its own here.
        case exceptions.CoercionError(argument=argument, msg=str() as said) if argument is not None:
            return f"Option `{argument.name}` {said}."
        case exceptions.CoercionError(argument=argument, token=token, target_type=kind) if (
            argument is not None and token is not None
        ):
            if kind is float:
                return f"Option `{argument.name}` must be a number such as 0.5, but is {shown(token.value)}."
            return f"Option `{argument.name}` must have a value that makes sense, but has {token.value!r}: see --help."
        case exceptions.UnknownCommandError(unused_tokens=[word, *_]) if error.app is not None:
            known = ", ".join(name for name in error.app if not name.startswith("-"))
            return f"There is no command {word!r}; there are {known}."
        case exceptions.UnusedCliTokensError(unused_tokens=[word, *_]):
            return f"The word {word!r} belongs to no option."
        case _:
            return " ".join(str(error).split())


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
