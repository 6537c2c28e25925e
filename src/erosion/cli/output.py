"""Output of a verb: tables, the JSON document, erosion per mass, warnings, progress, files."""

import contextlib
import dataclasses
import os
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, as_options, reading, user_errors, warn
from erosion.cli.options import MODEL, CaseOptions
from erosion.parameters import QUANTITIES
from erosion.results import Declared, Finding, Result, ValueGroup, in_unit, render
from erosion.version import __version__

_SPACE = "\ue000"  # within a command; of private use, so that no text has it


def require_outputs(*outputs: Path | None, plot: Path | None = None, inputs: Sequence[Any] = ()) -> None:
    """Know before computing that what a verb is to write can be written, each into a file of its own.

    Args:
        outputs: files that are replaced.
        plot: a figure's files, see `plot_files`.
        inputs: what the verb reads, whose files must stay as they are: paths, models by name or path, texts of laws.

    Raises:
        InputError: one sentence naming the file.
    """
    with user_errors():
        figures = () if plot is None else lazy.plot_files(plot)
        written = [path for path in (*figures, *outputs) if path is not None]
        for path in written:
            lazy.require_writable(path)
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
    """The text or the JSON of one run of a verb, and its files; made before the verb computes.

    `docs/json.md` describes the document, `document.schema.json` in this folder checks it.

    Args:
        verb: its name.
        p: the case; None for a verb without one.
        options: of the case; where a fit wrote its file, the fit's doubts are the first findings.
        json: whether to print JSON and nothing else.
        seed: of the random numbers, where there are any.
        plot: a figure's files, see `plot_files`; None without a figure.
        files: other files by what they hold; None for what is not asked for.
        inputs: what the verb reads beside the case, see `require_outputs`.

    Raises:
        InputError: for a file that cannot be written, or that the verb reads.
    """

    def __init__(
        self,
        verb: str,
        p: "lazy.Parameters | None" = None,
        options: CaseOptions | None = None,
        *,
        json: bool,
        seed: int | None = None,
        plot: Path | None = None,
        files: Mapping[str, Path | None] | None = None,
        inputs: Sequence[Any] = (),
    ) -> None:
        self.verb, self.p, self.json, self.seed = verb, p, json, seed
        self.case = None if options is None else options.case
        self._plot, self._files = plot, {what: path for what, path in (files or {}).items() if path is not None}
        self._saved: dict[str, Path | None] = {}
        require_outputs(*self._files.values(), plot=plot, inputs=(self.case, *inputs))
        self.findings: list[Finding] = []
        if p is not None:
            self.warn(p.size_finding)
        # A new fit has doubts of its own.
        file = None if options is None or verb in ("calibrate", "posterior") else options.file
        if p is not None and file is not None:
            with user_errors():
                changed = None if options is None else options.changed(p)
                self.warn(file.doubt, changed, *file.outside(p, angle=verb == "run"))

    def warn(self, *findings: Finding | None) -> None:
        """Findings, each once: on stderr at once, and in the document."""
        for finding in findings:
            if finding is not None and finding not in self.findings:
                self.findings.append(finding)
                warn(finding)

    def show(
        self,
        result: Result,
        models: "Mapping[str, lazy.CuttingModel] | None" = None,
        also: Sequence[Declared] = (),
        *,
        name: str = "",
        title: str = "",
        varied: Mapping[str, Any] | None = None,
        sentences: Sequence[str] = (),
    ) -> None:
        """Warn of a result's findings, and print it: as a document, or as tables with its conclusions.

        Args:
            result: what was computed.
            models: by name, by which models.
            also: what the verb adds, after the result's own values.
            name: of the record in the document that the result's numbers have; without it they stand in `result`.
            title: above the first table, in place of the result's.
            varied: in words, the laws or axes of what is not a single number.
            sentences: below the tables, after the conclusions.
        """
        self.warn(*result.findings)
        own, below = result.declare(), [*result.conclusions, *sentences]
        declared = [*([ValueGroup(name, own, result.title)] if name else own), *also]
        self.present(title or result.title, declared, models, varied=varied, sentences=below)

    def present(
        self,
        title: str,
        declared: Sequence[Declared],
        models: "Mapping[str, lazy.CuttingModel] | None" = None,
        *,
        varied: Mapping[str, Any] | None = None,
        sentences: Sequence[str] = (),
    ) -> None:
        """Print what is declared, as a document, or as tables with sentences below them; arguments as of `show`."""
        if self.json:
            self._print_document(render.record(declared, self._units, has_units=True), models or {}, varied or {})
        else:
            _print_tables(render.tables(title, declared, self._units), sentences)
            self.wrote(**self._saved)

    @property
    def _units(self) -> "lazy.System":
        return "si" if self.p is None else self.p.shown_in

    def save(self, *, figure: Callable[[], Any] | None = None, **writers: Callable[[Path], Any]) -> None:
        """Write the files that are asked for, before anything is printed; `show` names them below its tables.

        Args:
            figure: makes the figure.
            writers: by what a file holds, what writes it into a path.
        """
        with user_errors():
            for what, path in self._files.items():
                writers[what](path)
        if figure is not None:
            draw(self._plot, figure)
        self._saved = {**self._files, "figure": self._plot}

    def _print_document(
        self, result: Mapping[str, Any], models: "Mapping[str, lazy.CuttingModel]", varied: Mapping[str, Any]
    ) -> None:
        described = [_model(name, model, self.p, varied) for name, model in models.items()]
        document = {
            "verb": self.verb,
            "version": __version__,
            "case": None if self.p is None else _case(self.p, self.case, varied),
            "units": None if self.p is None else self.p.shown_in,
            "model": described[0] if len(described) == 1 else described or None,
            "seed": self.seed,
            "result": result,
            "findings": [{**finding.to_dict(), "text": as_options(finding.text)} for finding in self.findings],
        }
        print(lazy.to_json(document))

    def wrote(self, *sentences: str, **paths: Path | None) -> None:
        """Say which files are written, those of a `figure` each, and sentences on them; nothing beside JSON."""
        if not self.json:
            given = {content: path for content, path in paths.items() if path is not None}
            lines = [f"{content}: {file}" for content, path in given.items()
                     for file in (lazy.plot_files(path) if content == "figure" else (path,))]  # fmt: skip
            print("".join(f"{line}\n" for line in (*lines, *sentences)), end="")


def _case(p: "lazy.Parameters", file: Path | None, varied: Mapping[str, Any]) -> dict[str, Any]:
    numbers = {
        name: {"value": in_unit(float(getattr(p, name)), quantity.size(p.shown_in)), "unit": quantity.unit(p.shown_in)}
        for name, quantity in QUANTITIES.items()
        if name not in varied
    }
    words = {name: str(words) for name, words in varied.items()}
    return {"name": "Table 1" if file is None else file.stem, "file": file and str(file),
            "parameters": numbers, "varied": words}  # fmt: skip


def _model(
    name: str, model: "lazy.CuttingModel", p: "lazy.Parameters | None", varied: Mapping[str, Any]
) -> dict[str, Any]:
    units = "si" if p is None else p.shown_in
    own = {
        key: {
            "value": in_unit(parameter.value, parameter.quantity.size(units)),
            "unit": parameter.quantity.unit(units),
        }
        for key, parameter in lazy.own_parameters(model).items()
        if key not in varied
    }
    return {"name": name, "own_parameters": own}


def _print_tables(tables: Sequence[render.PrintedTable], sentences: Sequence[str]) -> None:
    """Print tables, in colour where stdout is a terminal, and sentences below the last.

    Each sentence is wrapped between words, but not within a command, which would be lost to copy and paste.
    """
    from rich.console import Console  # 70 ms that a verb without warnings does without

    console = Console(highlight=False)
    # Where no one says how wide it is, nothing need be shortened.
    width = console.width if console.is_terminal or "COLUMNS" in os.environ else lazy.WIDTH
    # rich would end the process, with status 1, where the reader of a pipe has gone.
    with console.capture() as captured:
        for at, table in enumerate(tables):
            if at and tables[at - 1].notes:
                console.print()  # so that notes do not look like the next title
            for line in table.lines(width):
                console.print(line, soft_wrap=True)
            for sentence in [*table.notes, *(sentences if table is tables[-1] else ())]:
                kept = re.sub("[“„]erosion [^“”]*", lambda quoted: quoted[0].replace(" ", _SPACE), sentence)
                lines = textwrap.fill(kept, width, break_long_words=False, break_on_hyphens=False)
                console.print(lines, markup=False, soft_wrap=True)
    print(captured.get().replace(_SPACE, " "), end="")


def draw(path: Path | None, figure: Callable[[], Any]) -> None:
    """Draw a figure into its files, where any is asked for."""
    if path is not None:
        with user_errors():
            lazy.save_plots(figure, lazy.plot_files(path))


@Parameter(name="*", group=MODEL)
@dataclasses.dataclass(frozen=True)
class PerMassOptions:
    """Options of erosion per mass of particles."""

    density: Annotated[
        str | None,
        Parameter(help='Of the target, for g/kg: "2.7 g/cm^3"; --target has one.'),
    ] = None
    cutting_fraction: Annotated[
        float | None,
        Parameter(help="Share of the particles that cut, about 0.5 by Finnie."),
    ] = None

    def per_mass(self, options: CaseOptions, usual_fraction: float = 1.0) -> "lazy.PerMass":
        """With what --target or the case file give where these options give nothing.

        Raises:
            InputError: one sentence naming the option or the file.
        """
        with user_errors():
            file = options.file
            of_case = lazy.PerMass(cutting_fraction=usual_fraction) if file is None else file.per_mass(usual_fraction)
            _, metal = options.materials()
        density = density_option("density", self.density)
        fraction = of_case.cutting_fraction if self.cutting_fraction is None else self.cutting_fraction
        if file is not None and "cutting_fraction" in file.table and fraction != of_case.cutting_fraction:
            numbers = {"fraction": of_case.cutting_fraction}
            options.warn_once(Finding("fraction_replaces_field", str(options.case), numbers))
        with user_errors():
            if density is None and options.target is None:
                density = of_case.density
            return lazy.PerMass(density if metal is None else metal.density_beside(density), fraction)


def density_option(name: str, text: str | None) -> float | None:
    """The density of an option [kg/m³]; None where it is not given."""
    with reading(f"Option `--{name}`"):
        return None if text is None else lazy.read_density(text)


def weighing(model: "lazy.CuttingModel", given: PerMassOptions | None, options: CaseOptions) -> "lazy.PerMass":
    """The conversion of a model's volume to erosion per mass of particles.

    Raises:
        InputError: also for the density of another metal than a correlation's.
    """
    given = given or PerMassOptions()
    per_mass = given.per_mass(options)
    try:
        return lazy.per_mass_of(model, per_mass)
    except ValueError as error:
        source = "Option `--density`"
        if given.density is None:
            source = f"{options.case}: the density" if options.target is None else "The density of `--target`"
        message = str(error).replace("Argument `density`", source)
        usual = options.load(model.label) if isinstance(model, lazy.Correlated) else None
        if isinstance(model, lazy.Correlated) and isinstance(usual, lazy.Correlated) and model.density != usual.density:
            message = (
                f"Parameter `density` of {model.label} is set to {float(model.density):g} kg/m³ (`--set`, or `set` in "
                f"the case file), but {source[0].lower()}{source[1:]} is {per_mass.density:g} kg/m³: leave one of them "
                "out."
            )
        raise InputError(message) from error


_SLOWEST = 10  # per second; a slower rate says less than the time left


@contextlib.contextmanager
def progress_bar(title: str) -> Iterator["lazy.Progress"]:
    """Give the `progress` of any verb, shown as a bar; `title` stands there until the first call."""
    from rich.console import Console  # with `progress` 100 ms, which is for terminals alone
    from rich.progress import BarColumn, Progress as Bar, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True, highlight=False)
    is_shown = sys.stderr is not None and sys.stderr.isatty()
    with Bar(*columns, console=console, transient=True, disable=not is_shown) as bar:
        console.show_cursor()  # which a signal that ends the process would leave hidden
        task = bar.add_task(title, total=None, rate="")

        def show(work: str, done: int, total: int) -> None:
            speed = bar.tasks[0].speed or 0
            rate = f"{speed:,.0f}/s" if speed > _SLOWEST else ""
            # Without a total the bar moves to and fro: the first part is computed, or no one knows how many follow.
            bar.update(task, description=work, completed=done, total=(total or None) if done else None, rate=rate)

        yield show
