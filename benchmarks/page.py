"""The page docs/performance.md, made from benchmarks/results.json."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from erosion.plotting.labels import PALETTE
from erosion.plotting.style import house_style, new_figure, save_plot

RESULTS = Path(__file__).with_name("results.json")
DOCS = Path(__file__).parents[1] / "docs"
FIGURE = "images/speed.svg"


class Table(NamedTuple):
    """A table of a section.

    Args:
        head: of its columns.
        rows: words, counts and numbers.
        wrong: how many results failed their check.
    """

    head: list[str]
    rows: list[list[Any]]
    wrong: int = 0


def markdown(table: Table) -> str:
    """All columns but the first hold numbers."""
    lines = [table.head, ["---", *["--:"] * (len(table.head) - 1)], *table.rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines)


def _cell(value: Any) -> str:
    """Three digits; 1.2e-10, 7,120, 0.152."""
    if value is None:
        return ""
    if isinstance(value, int):
        return f"{value:,}"
    if not isinstance(value, float):
        return str(value)
    if value and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.1e}"
    return f"{float(f'{value:.3g}'):,g}"


def figure(speed: Table) -> None:
    """Draw the times over erosion's of all problems without derivatives."""
    rows = [row for row in speed.rows if row[1] == 0]
    colors = dict(zip(speed.head[3:], PALETTE.values(), strict=False))
    with house_style():
        fig = new_figure(7.2, 2.6)
        ax = fig.subplots()
        for column, (name, color) in enumerate(colors.items(), start=3):
            times = {i: row[column] for i, row in enumerate(rows) if isinstance(row[column], float)}
            ax.semilogx(list(times.values()), list(times), "o", color=color, label=name)
        ax.axvline(1.0, color="0.4", linewidth=1)
        ax.set_yticks(range(len(rows)), [row[0] for row in rows])
        ax.invert_yaxis()
        ax.set_xlabel("time over erosion's")
        fig.legend(loc="outside right center")
        save_plot(fig, DOCS / FIGURE)


def write(sections: Mapping[str, ModuleType]) -> None:
    """Make the page of what benchmarks/results.json has of the sections."""
    results = json.loads(RESULTS.read_text(encoding="utf-8"))
    parts = ["# Speed and accuracy", HEAD]
    runs: dict[str, list[str]] = {}
    for name, section in sections.items():
        if name not in results:
            continue
        measured = results[name]
        table = Table(*measured["table"])
        parts += [f"## {section.TITLE}", section.TEXT]
        if name == "speed":
            figure(table)
            parts.append(f"![Time of a lane over erosion's, by problem and contender]({FIGURE})")
        machine, versions = measured["machine"].split("; ")
        runs.setdefault(versions, []).append(section.TITLE)
        parts += [markdown(table), f"{measured['date']}, {measured['seconds'] / 60:.0f} min; {machine}."]
    parts += ["## Versions", *(f"{', '.join(titles)}: {versions}." for versions, titles in runs.items())]
    (DOCS / "performance.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


HEAD = """How long answers take, and how exact they are, beside other packages. `make bench` makes this page. Above a
load of 1 for each core only ratios mean something."""
