"""Meanings of columns by the user: units and names, "x,y,z=mm, d50=diameter [um]"."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from erosion.output import briefly, list_item, split_list
from erosion.output.files import read_toml
from erosion.parameters.quantities import about
from erosion.tables.headings import NO_UNIT, columns_of, heading_parts
from erosion.tables.source import TableError


def read_meanings(given: str | Mapping[str, str] | None) -> dict[str, str]:
    """Read meanings of columns: "x,y,z=mm, d50=diameter [um]", a TOML file with such entries, or a mapping.

    A heading with a comma stands in quotes, as in a CSV file: '"Loss, total"=mass_loss [mg]'. A meaning may, too.

    Raises:
        TableError: for what is none of these.
    """
    if given is None or isinstance(given, Mapping):
        return dict(given or {})
    if given.endswith(".toml"):
        meant = read_toml(Path(given), TableError)
        if wrong := next((heading for heading, text in meant.items() if not isinstance(text, str)), None):
            raise TableError(f'{given}: {wrong!r} must be a text such as "mm".')
        return meant
    meant, headings = {}, list[str]()
    with about("Argument `columns`", TableError):
        entries = split_list(given)
    for entry in entries:
        start, equals, text = (part.strip() for part in entry.rpartition("="))
        headings.append(start if equals else text)
        if equals:
            text = text.removeprefix('"').removesuffix('"')
            meant |= dict.fromkeys(headings, text)
            headings = []
    if headings or not meant or not all(meant) or not all(meant.values()):
        raise TableError(f'Argument `columns` must be such as "x,y,z=mm, d50=diameter [um]", but is {briefly(given)}.')
    return meant


def written_meanings(meant: Mapping[str, str]) -> str:
    """Meanings as the text that `read_meanings` takes."""
    return ", ".join(f"{list_item(heading)}={text}" for heading, text in meant.items())


def explained(title: str, headings: Sequence[str], meant: Mapping[str, str]) -> list[str]:
    """The headings of a table with the units or the names that a user gives them.

    Raises:
        TableError: for a column that is not there, and one that has its unit.
    """
    texts = list(headings)
    for name, text in meant.items():
        at = columns_of(headings, name)
        if not at:
            known = briefly(", ".join(heading.strip() for heading in headings))
            raise TableError(f"{title}: has no column {name!r}, which Argument `columns` names; it has {known}.")
        if not text.endswith("]") and any(heading_parts(headings[i])[1] not in NO_UNIT for i in at):
            raise TableError(f"{title}: column {name!r} has its unit, so Argument `columns` must not give it another.")
        for i in at:
            texts[i] = text if text.endswith("]") else f"{heading_parts(headings[i])[0]} [{text}]"
    return texts
