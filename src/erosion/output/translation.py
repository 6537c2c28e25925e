"""Pages in other languages than English: gettext catalogues over their texts.

A message of the catalogue is a block of a text, between empty lines, as it stands in its file: with its fields, so
that a translator sees whole sentences. Words that are computed (the end of a cut, a parameter's meaning) and the
texts of figures are messages too; where they hold numbers, "#" stands for each. Sentences of the code have fields in
braces, as `str.format` has them.
"""

import dataclasses
import functools
import re
import reprlib
from collections.abc import Mapping
from pathlib import Path

_FOLDER = Path(__file__).parents[1] / "locale"
_NUMBER = re.compile(r"[−-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_POINT = re.compile(r"(?<=\d)\.(?=\d)")
_FIELD = re.compile(r"\{(\w+)\}")
_PART = r"(?:(?!\. ).)+?"  # of one sentence
_SOURCE = r"(?:[A-Za-z]:)?(?:(?!\. )[^:])+?\.(?:toml|nc|csv): |[^\s:]+: "  # the path of a file, or another name
_ANY = re.compile(rf"(){_PART}(?:\.(?= )|$)")
_PUNCTUATION = re.compile(r"([;:,] | \(|\))")
_BETWEEN_BLOCKS = re.compile(r"(\n\s*\n)")


@dataclasses.dataclass(frozen=True)
class Language:
    """A language of the pages.

    Args:
        tag: as HTML has it: "en", "de".
        messages: the translation of each English message.
        comma: whether a number has a decimal comma.
    """

    tag: str = "en"
    messages: Mapping[str, str] = dataclasses.field(default_factory=dict)
    comma: bool = False

    def text(self, message: str) -> str:
        """The translation of a few words; numbers in them stay. The words themselves where there is none."""
        words = message.strip()
        if words in self.messages:
            return message.replace(words, self.messages[words])
        numbers = _NUMBER.findall(words)
        pattern = _NUMBER.sub("#", words)
        if not numbers or pattern not in self.messages:
            return message
        pieces = self.messages[pattern].split("#")
        filled = [piece + number for piece, number in zip(pieces, map(self.number, numbers), strict=False)]
        return "".join([*filled, *pieces[len(numbers) :]])

    def label(self, label: str) -> str:
        """The translation of a label such as "V  removed volume  [in³]": its symbol and unit stay."""
        symbol, gap, rest = label.partition("  ")
        whole = self.text(label)
        if whole != label or not gap:
            return whole
        meaning, end, unit = rest.partition("  ")
        name = symbol if re.fullmatch(r"\W*\w\W*|\$.*\$|\S{1,3}|.* = .*", symbol) else self.text(symbol)
        return name + gap + (meaning if meaning.startswith("[") else self.text(meaning)) + end + unit

    def say(self, message: str, **fields: str) -> str:
        """A message of the code, such as "share at {angle}", with its fields; numbers with their decimal separators.

        A field `command` is to be typed, and stays as it is.
        """
        said = {name: text if name == "command" else self.number(text) for name, text in fields.items()}
        return self.messages.get(message, message).format(**said)

    def sentences(self, text: str) -> str:
        """Finished sentences of a fit, which a case file keeps in English; one that no message fits stays.

        A sentence may begin with the name of a file and a colon. Its fields are found where the message has them;
        a field `command` stays as it is.
        """
        said, rest = [], text
        while rest and self.messages:
            fits = ((pattern.match(rest), message, names) for pattern, message, names in self._finished)
            match, message, names = next((fit for fit in fits if fit[0]), (_ANY.match(rest), "", []))
            assert match is not None
            source, *fields = match.groups("")
            filled = (field if name == "command" else self.number(self.text(field))
                      for name, field in zip(names, fields, strict=True))  # fmt: skip
            said.append(source + message.format(*filled) if message else match[0])
            rest = rest[match.end() :].lstrip()
        return " ".join(said) or text

    @functools.cached_property
    def _finished(self) -> list[tuple[re.Pattern[str], str, list[str]]]:
        """What a finished sentence looks like, its translation with fields by their places, and the fields' names.

        The longest first. After the name of a file a sentence may begin with a small letter.
        """
        made = []
        for message, said in self.messages.items():
            if message.endswith(".") and "{%" not in message and "{{" not in message and "\n" not in message:
                names = _FIELD.findall(message)
                body = _FIELD.sub("\0", message)
                pattern = re.escape(body).replace("\0", rf"({_PART})")
                places = _FIELD.sub(lambda name, names=names: f"{{{names.index(name[1])}}}", said)
                looks = re.compile(rf"({_SOURCE})?{pattern}(?=\s|$)", re.IGNORECASE)
                made.append((len(body), looks, places, names))
        return [(looks, places, names) for _, looks, places, names in sorted(made, key=lambda one: -one[0])]

    def cited(self, source: str) -> str:
        """A source with its describing words translated; names and titles stay."""
        return "".join(map(self.text, _PUNCTUATION.split(source)))

    def template(self, source: str) -> str:
        """A text's file with each block translated."""
        return "".join(self.messages.get(block.strip(), block) for block in _BETWEEN_BLOCKS.split(source))

    def number(self, text: str) -> str:
        """A number, or a text with numbers, with its decimal separators."""
        return _POINT.sub(",", text) if self.comma else text

    def number_tex(self, tex: str) -> str:
        """The same in LaTeX, which takes a bare comma for the end of an argument."""
        return _POINT.sub("{,}", tex) if self.comma else tex


ENGLISH = Language()


def languages() -> list[str]:
    """The tags of all languages."""
    return [ENGLISH.tag, *sorted(path.stem for path in _FOLDER.glob("*.po"))]


def language(tag: str) -> Language:
    """The language with a tag.

    Raises:
        ValueError: for a tag without a catalogue.
    """
    if tag not in languages():
        raise ValueError(f"Argument `lang` must be one of {', '.join(languages())}, but is {reprlib.repr(tag)}.")
    return _read(tag)


@functools.cache
def _read(tag: str) -> Language:
    if tag == ENGLISH.tag:
        return ENGLISH
    import polib

    catalogue = polib.pofile(str(catalogue_path(tag)), encoding="utf-8")
    messages = {entry.msgid: entry.msgstr for entry in catalogue.translated_entries()}
    return Language(tag, messages, catalogue.metadata.get("X-Decimal-Separator") == ",")


def catalogue_path(tag: str) -> Path:
    """The file of a language's catalogue."""
    return _FOLDER / f"{tag}.po"
