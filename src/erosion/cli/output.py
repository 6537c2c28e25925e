"""What a verb says, tables, one JSON document of the same form for all verbs, warnings; and the files it may write."""

import os
import re
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from erosion.cli.errors import InputError, user_errors
from erosion.cli.kept_programs import silence_matplotlib
from erosion.parameters.quantities import QUANTITIES
from erosion.version import __version__

if TYPE_CHECKING:
    from erosion.models.base import CuttingModel
    from erosion.parameters.parameters import Parameters
    from erosion.parameters.per_mass import PerMass


def require_outputs(*outputs: Path | None, plot: Path | None = None, inputs: Sequence[Any] = ()) -> None:
    """Know before computing that what a verb is to write can be written, each into a file of its own.

    Args:
        outputs: files that are replaced.
        plot: a figure's file.
        inputs: what the verb reads, whose files must stay as they are: paths, models by name or path, texts of laws.

    Raises:
        InputError: one sentence naming the file.
    """
    from erosion.files import require_writable

    with user_errors():
        if plot is not None:
            silence_matplotlib()
            from erosion.plotting.style import require_plot_path

            require_plot_path(plot)
        for path in outputs:
            if path is not None:
                require_writable(path)
    written = [path for path in (plot, *outputs) if path is not None]
    require_apart(written, inputs)
    named = [path.resolve() for path in written]
    for i, path in enumerate(named):
        if path in named[:i]:
            raise InputError(f"{path}: is named twice, but every file must be another.")


def require_apart(outputs: Sequence[Path], inputs: Sequence[Any]) -> None:
    """Refuse to write a file, or into a folder, that the verb reads; arguments as of `require_outputs`.

    Raises:
        InputError: one sentence naming the file.
    """
    texts = [
        re.sub(r"\s*samples\s*\((.*)\)\s*", r"\1", str(given), flags=re.S) for given in inputs if given is not None
    ]
    # What is too long for a path, as a long list of values, is none.
    read = [Path(text.strip()) for text in texts if len(text) < 4096 and "\0" not in text]
    for path in outputs:
        for file in read:
            if path.resolve() in (file.resolve(), *file.resolve().parents):
                raise InputError(f"{path}: must not be written, because {file} is read.")


class Output:
    """The text or the JSON of one run of a verb.

    `docs/json.md` describes the document, `document.schema.json` in this folder checks it.

    Args:
        verb: its name.
        p: the case; None for a verb without one.
        case: the case's file; None for Table 1.
        json: whether to print JSON and nothing else.
        seed: of the random numbers, where there are any.
    """

    def __init__(
        self,
        verb: str,
        p: "Parameters | None" = None,
        case: Path | None = None,
        *,
        json: bool,
        seed: int | None = None,
    ) -> None:
        self.verb, self.p, self.case, self.json, self.seed = verb, p, case, json, seed
        self.warnings: list[str] = []
        if p is not None and p.size_warning:
            self.warn(p.size_warning)

    def warn(self, message: str) -> None:
        """A warning: on stderr at once, and in the document."""
        self.warnings.append(message)
        warn(message)

    def warn_all(self, groups: Iterable[Sequence[str]]) -> None:
        """Warnings, in groups."""
        for group in groups:
            for message in group:
                self.warn(message)

    def judge(self, per_mass: "PerMass", volume: Any, p: "Parameters") -> None:
        """A warning where the erosion ratio of these volumes is far from what tests find."""
        if message := per_mass.warning(volume, p):
            self.warn(message)

    def document(
        self,
        result: Mapping[str, Any],
        models: "Mapping[str, CuttingModel] | None" = None,
        units: Mapping[str, str] | None = None,
        varied: Mapping[str, Any] | None = None,
    ) -> None:
        """Print the document.

        Args:
            result: numbers by name, of any depth.
            models: by name, what was computed.
            units: unit by name of the numbers in `result` that have one.
            varied: in words, the distributions or axes of what is not a single number.
        """
        from erosion.tables import to_json

        described = [_model(name, model, self.p, varied or {}) for name, model in (models or {}).items()]
        document = {
            "verb": self.verb,
            "version": __version__,
            "case": None if self.p is None else _case(self.p, self.case, varied or {}),
            "units": None if self.p is None else self.p.units,
            "model": described[0] if len(described) == 1 else described or None,
            "seed": self.seed,
            "result": _with_units(result, units or {}),
            "warnings": self.warnings,
        }
        print(to_json(document))


def _case(p: "Parameters", file: Path | None, varied: Mapping[str, Any]) -> dict[str, Any]:
    numbers = {
        name: {"value": float(getattr(p, name)), "unit": quantity.unit(p.units)}
        for name, quantity in QUANTITIES.items()
        if name not in varied
    }
    words = {name: str(words) for name, words in varied.items()}
    return {"name": "Table 1" if file is None else file.stem, "file": file and str(file),
            "parameters": numbers, "varied": words}  # fmt: skip


def _model(name: str, model: "CuttingModel", p: "Parameters | None", varied: Mapping[str, Any]) -> dict[str, Any]:
    from erosion.models.own_parameters import own_parameters

    units = "si" if p is None else p.units
    own = {
        key: {"value": parameter.value, "unit": parameter.quantity.unit(units)}
        for key, parameter in own_parameters(model).items()
        if key not in varied
    }
    return {"name": name, "own_parameters": own}


def _with_units(value: Any, units: Mapping[str, str]) -> Any:
    """The same, with each number or group of numbers that `units` names beside its unit."""
    if isinstance(value, Mapping):
        return {
            key: {"value": item, "unit": units[key]} if key in units else _with_units(item, units)
            for key, item in value.items()
        }
    if isinstance(value, (list, tuple)):
        return [_with_units(item, units) for item in value]
    return value


def print_table(
    title: str,
    rows: "Sequence[Sequence[Any]]",
    headings: "Sequence[str] | None" = None,
    numbers: "Collection[int]" = (2,),
    statements: Sequence[str] = (),
) -> None:
    """A table on stdout, in colour where it is a terminal, and sentences below it.

    Args:
        title: above the table.
        rows: cells, as text or rich text.
        headings: of the columns.
        numbers: the columns that are flush right.
        statements: each wrapped between words.
    """
    from rich.console import Console

    from erosion.tables import HEADINGS, WIDTH, to_lines

    console = Console(highlight=False)
    # Where no one says how wide it is, nothing need be shortened.
    width = console.width if console.is_terminal or "COLUMNS" in os.environ else WIDTH
    # rich would end the process, with status 1, where the reader of a pipe has gone.
    with console.capture() as captured:
        for line in to_lines(title, rows, headings or HEADINGS, numbers, width):
            console.print(line, soft_wrap=True)
        for statement in statements:
            console.print(statement, markup=False, width=width)
    print(captured.get(), end="")


def print_paths(**paths: Path | None) -> None:
    """Where the files are that a verb has written, those that there are."""
    for content, path in paths.items():
        if path is not None:
            print(f"{content}: {path}")


def warn(message: str) -> None:
    """A warning on stderr, where there is one."""
    if sys.stderr is not None:
        print(f"warning: {message}", file=sys.stderr)
