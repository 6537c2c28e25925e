"""The Markdown of the questions' texts as HTML: paragraphs, notes, formulas and tables."""

import re

from markupsafe import Markup

from erosion.report.text import formula, math

_INLINE = re.compile(r"\$(?P<tex>[^$]+)\$|\*\*(?P<strong>.+?)\*\*|`(?P<code>[^`]+)`")
_UNIT = re.compile(r"\[.*?\]")
_RULE = re.compile(r"\|[-:| ]+")


def blocks(text: str) -> list[str]:
    """Pieces of a text between empty lines."""
    return [block.strip() for block in re.split(r"\n\s*\n", text) if block.strip()]


def to_html(text: str) -> Markup:
    """Blocks of Markdown as blocks of HTML."""
    return Markup("\n").join(_block(block) for block in blocks(text))


def inline(text: str) -> Markup:
    """A line of text with `$formulas$`, `**strong words**` and `` `code` ``."""
    return Markup(_INLINE.sub(_element, " ".join(text.split("\n"))))


def _element(match: re.Match[str]) -> str:
    if match["tex"]:
        return math(match["tex"])
    return f"<strong>{inline(match['strong'])}</strong>" if match["strong"] else f"<code>{match['code']}</code>"


def _block(block: str) -> Markup:
    if block.startswith("$$"):
        return formula(block.strip("$").strip())
    if block.startswith("Table:"):
        return _table(*block.split("\n"))
    if block.startswith(">"):
        return Markup('<p class="note">{}</p>').format(inline(re.sub(r"(?m)^> ?", "", block)))
    return Markup("<p>{}</p>").format(inline(block))


def _table(caption: str, head: str, rule: str, *rows: str) -> Markup:
    """A table; its first column names the row. Words are aligned to the left and break into lines."""
    if not _RULE.fullmatch(rule):
        raise ValueError(f"The third line of a table must be of the form |---|--:|, but is {rule!r}.")
    top = Markup("").join(Markup("<th scope='col'>{}</th>").format(_UNIT.sub(_unbroken, cell)) for cell in _cells(head))
    body = Markup("").join(
        Markup("<tr><th scope='row'>{}</th>{}</tr>").format(
            name, Markup("").join(Markup("<td>{}</td>").format(cell) for cell in cells)
        )
        for name, *cells in map(_cells, rows)
    )
    table = Markup(
        '<div class="table" tabindex="0"><table><caption>{}</caption><thead><tr>{}</tr></thead>'
        "<tbody>{}</tbody></table></div>"
    ).format(inline(caption.removeprefix("Table:").strip()), top, body)
    return table if "-:" in rule else Markup('<div class="wordy">{}</div>').format(table)


def _cells(row: str) -> list[Markup]:
    return [inline(cell.strip()) for cell in row.strip().strip("|").split("|")]


def _unbroken(match: re.Match[str]) -> str:
    return match[0].replace(" ", "\N{NO-BREAK SPACE}")
