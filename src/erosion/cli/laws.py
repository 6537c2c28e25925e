"""Laws at the command line and in case files: of what varies from particle to particle, and of what is uncertain."""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, reading, user_errors
from erosion.cli.options import LAWS, CaseOptions, settings, with_model_of_case
from erosion.output import briefly
from erosion.parameters import QUANTITIES
from erosion.results import Finding

LAW_FIELDS = ("rows", "uncertain", "correlation")
"""The fields of a verb's table in a case file that `LawOptions` reads."""

_FRACTION = "cutting_fraction"

_UNCERTAIN = 'Not known: `posterior -o` file, .csv, "k=normal(2, 0.2)".'


@Parameter(name="*", group=LAWS)
@dataclasses.dataclass(frozen=True)
class LawOptions:
    """Laws of several parameters together, and of what is uncertain; texts as they are typed."""

    rows: Annotated[
        Path | None,
        Parameter(help='Particles, one a row of this .csv file: "v0 [m/s], k".'),
    ] = None
    uncertain: Annotated[list[str] | None, Parameter(negative="", help=_UNCERTAIN)] = None
    correlation: Annotated[
        list[str] | None,
        Parameter(negative="", help='Of the normal scores of two laws: "v0,r=-0.5"; repeatable.'),
    ] = None

    def with_section(self, section: Mapping[str, Any], where: str, case: CaseOptions) -> "GivenLaws":
        """The same with what a case file's table gives; options win.

        Args:
            section: the table.
            where: words for it: "jet.toml: field `{}` of [stream]".
            case: of the impacts.
        """
        rows, uncertain, pairs = (section.get(name) for name in LAW_FIELDS)
        table = uncertain if isinstance(uncertain, dict) else {}
        odd = {name: law for name, law in table.items()
               if isinstance(law, list) and not all(type(value) in (int, float) for value in law)}  # fmt: skip
        lazy.refuse(
            "",
            (not (rows is None or isinstance(rows, str)),
             f"{where.format('rows')} must name a CSV file, but is {briefly(rows)}."),
            (not (uncertain is None or isinstance(uncertain, str) or table),
             f"{where.format('uncertain')} must name a file or be a table of laws, but is {briefly(uncertain)}."),
            (not (pairs is None or isinstance(pairs, dict)),
             f'{where.format("correlation")} must be a table such as {{"v0,r" = -0.5}}, but is {briefly(pairs)}.'),
            *((True, f"{where.format('uncertain')} must be a table of laws, or of lists of numbers, but has "
                     f"{name} = {briefly(law)}.") for name, law in odd.items()),
            kind=InputError,
        )  # fmt: skip
        of_file: list[str | Mapping[str, Any]] = [] if uncertain is None else [uncertain]
        if not all(isinstance(draws, list) for draws in table.values()):
            of_file = [f"{name}={law}" for name, law in table.items()]
        given = GivenLaws(
            case,
            rows=(where.format("rows"), rows),
            uncertain=(where.format("uncertain"), of_file),
            correlation=(where.format("correlation"), [f"{pair}={value}" for pair, value in (pairs or {}).items()]),
        )
        options: dict[str, Any] = {
            name: (f"Option `--{name}`", getattr(self, name)) for name in LAW_FIELDS if getattr(self, name) is not None
        }
        return dataclasses.replace(given, **options)


class ReadLaws(NamedTuple):
    """Laws that are read.

    Args:
        varied: of what varies from particle to particle.
        uncertain: of what is one number for all particles.
        draws: the posteriors' files among the latter.
    """

    varied: "lazy.JointLaw"
    uncertain: "lazy.JointLaw"
    draws: "list[lazy.Draws]"

    def findings(self, model: "lazy.CuttingModel", p: "lazy.Parameters", cutting_fraction: float) -> Iterator[Finding]:
        """Columns that are not used or apart, and what the posteriors say of the model and the case."""
        yield from self.varied.unused_columns
        yield from self.uncertain.unused_columns
        yield from self.varied.columns_apart
        for part in self.draws:
            yield from (*part.doubts(model, p, cutting_fraction), *part.of_fit())


@dataclasses.dataclass(frozen=True)
class GivenLaws:
    """Laws of `LawOptions` and of a case file, with the place and the text of each.

    What is uncertain may also be draws by parameter, as a fit writes them. `case` is that of the impacts.
    """

    case: CaseOptions
    rows: tuple[str, Any]
    uncertain: tuple[str, list[str | Mapping[str, Any]]]
    correlation: tuple[str, list[str]]

    @property
    def files(self) -> list[str]:
        """The files that are read."""
        of_rows = [] if self.rows[1] is None else [str(self.rows[1])]
        return of_rows + [text for text in self.uncertain[1] if isinstance(text, str) and _is_file(text)]

    def read(self, model: "lazy.CuttingModel", laws: Mapping[str, Any]) -> ReadLaws:
        """All laws.

        Args:
            model: whose own parameters may have laws, too.
            laws: of what varies from particle to particle, read from other options.

        Raises:
            InputError: also for uncertain laws beyond the range of their parameter, and draws of another model.
        """
        where, path = self.rows
        with reading(where):
            rows = () if path is None else (lazy.read_samples(path, lazy.quantities(model)),)
        single, samples, draws = self._uncertain(model)
        pairs, uncertain_pairs = self._pairs(laws, single)
        with user_errors(fields={"samples": where, "correlation": self.correlation[0]}):
            varied = lazy.JointLaw(laws, pairs, rows)
            uncertain = lazy.JointLaw(single, uncertain_pairs, samples)
        require_same_model(draws, model, self.uncertain[0])
        try:
            uncertain.within({**lazy.ranges(model), _FRACTION: lazy.SHARE})
        except (TypeError, ValueError) as error:
            clause = re.sub(r"^Argument `(\w+)`", r"\1", str(error))
            raise InputError(f"{self.uncertain[0]}: {clause}") from error
        return ReadLaws(varied, uncertain, draws)

    def _uncertain(
        self, model: "lazy.CuttingModel"
    ) -> "tuple[dict[str, Any], tuple[lazy.JointSamples, ...], list[lazy.Draws]]":
        """Of what is uncertain the laws and the samples, and the posteriors' files among these."""
        where, texts = self.uncertain
        laws: dict[str, Any] = {}
        samples, draws, known = list[Any](), list[Any](), lazy.quantities(model)
        for text in texts:
            try:
                if not isinstance(text, str):
                    read = lazy.JointSamples(self._in_si(text, known), "draws")
                elif text.strip().endswith(".nc"):
                    draws.append(lazy.read_draws(text.strip(), known))
                    read = draws[-1].rows
                elif _is_file(text):
                    read = lazy.read_samples(text.strip(), {**known, _FRACTION: lazy.FACTORS[_FRACTION]})
                else:
                    read = self._law(text, known)
            except (TypeError, ValueError) as error:
                # A clause, or a sentence that names the file.
                said = str(error).removeprefix("Argument `columns` ").rstrip(".")
                raise InputError(f"{where}{'' if said.startswith('must ') else ':'} {said}.") from error
            is_table = isinstance(read, lazy.JointSamples)
            before = {*laws, *(name for table in samples for name in table.columns)}
            if both := [name for name in (read.columns if is_table else read) if name in before]:
                raise InputError(f"{where} must give {both[0]} once, but gives it several times.")
            if is_table:
                samples.append(read)
            else:
                laws |= read
        return laws, tuple(samples), draws

    def _in_si(self, columns: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
        """Columns of a case file, whose numbers are in its units."""
        sizes = {name: known[name].size(self.case.system) if name in known else 1.0 for name in columns}
        return {name: np.asarray(values) * sizes[name] if sizes[name] != 1 else values
                for name, values in columns.items()}  # fmt: skip

    def _law(self, text: str, known: Mapping[str, Any]) -> dict[str, Any]:
        """A law such as "k=normal(2, 0.2)"; a ValueError where it is none."""
        name, equals, words = (part.strip() for part in text.partition("="))
        if not (equals and name and words):
            raise ValueError(f'must be a file (.nc, .csv) or a law such as "k=normal(2, 0.2)", but is {briefly(text)}')
        if name not in known and name != _FRACTION:
            raise ValueError(f"must name one of {', '.join(known)}, but has {briefly(name)}")
        dimension = known[name].dimension if name in known else "1"
        self.case.require_unit(f"--uncertain {name}=", words, dimension)
        law = lazy.read_law(words, name, dimension, self.case.system)
        if law is None:
            raise ValueError(
                f"must give {name} a law ({', '.join((*lazy.LAWS, 'samples'))}), but gives {briefly(words)}"
            )
        return {name: law}

    def _pairs(self, *kinds: Mapping[str, Any]) -> list[dict[tuple[str, str], float]]:
        """Of each kind of laws the correlations that are asked for."""
        where, texts = self.correlation
        pairs: list[dict[tuple[str, str], float]] = [{} for _ in kinds]
        for text in texts:
            pair, value = _pair(text, where)
            homes = [of_kind for of_kind, laws in zip(pairs, kinds, strict=True) if {*pair} <= {*laws}]
            if not homes:
                raise InputError(
                    f"{where} must join two parameters with laws of their own, which both vary or are both uncertain, "
                    f"but has {briefly(text)}."
                )
            if pair in homes[0]:
                raise InputError(f"{where} must give {' and '.join(pair)} once, but gives them twice.")
            homes[0][pair] = value
        return pairs


def require_same_model(draws: "Sequence[lazy.Draws]", model: "lazy.CuttingModel", where: str) -> None:
    """Refuse draws of another model's parameters, which mean something else."""
    for part in draws:
        if part.model != lazy.model_name(model):
            raise InputError(
                f"{where}: {part.path} has the parameters of {part.model}, "
                f"but Option `--model` is {lazy.model_name(model)}."
            )
        with user_errors():
            part.require_same_equations(model)


def _is_file(text: str) -> bool:
    return text.strip().endswith((".nc", ".csv"))


def _pair(text: str, where: str) -> tuple[tuple[str, str], float]:
    """A pair of parameters and its correlation, of a text such as "v0,r=-0.5"."""
    names, _, number = text.partition("=")
    pair = tuple(name.strip() for name in names.split(","))
    try:
        first, second = pair
        return (first, second), float(number)
    except ValueError as error:
        raise InputError(f'{where} must be such as "v0,r=-0.5", but is {briefly(text)}.') from error


@dataclasses.dataclass(frozen=True)
class CaseAndLaws:
    """Case, model and laws of a verb that computes many impacts.

    Args:
        p: the case's scalars.
        name: what output calls the model.
        base: the model.
        numbers: its own parameters that are set.
        laws: of what varies by a law of its own.
        given: the other laws, whose files are not read yet.
        inputs: what is read, for `require_outputs`.
    """

    p: "lazy.Parameters"
    name: str
    base: "lazy.CuttingModel"
    numbers: dict[str, float]
    laws: dict[str, Any]
    given: GivenLaws
    inputs: tuple[Any, ...]

    @property
    def case(self) -> CaseOptions:
        """The options of the case."""
        return self.given.case

    @property
    def reference(self) -> "str | lazy.CuttingModel":
        """The model without its own parameters, by its name where other processes find it by that."""
        return self.base if isinstance(self.base, lazy.Correlated) else self.name

    @property
    def model(self) -> "lazy.CuttingModel":
        """With its own parameters."""
        return self.base.replace(**self.numbers)

    def read_laws(self) -> ReadLaws:
        """See `GivenLaws.read`."""
        return self.given.read(self.base, self.laws)


def case_and_laws(
    options: CaseOptions,
    verb: str,
    section: Mapping[str, Any],
    model: str | None,
    own: list[str] | None,
    joint: LawOptions | None,
) -> CaseAndLaws:
    """The case and the laws of a verb's table in the case file and of its options; options win.

    Args:
        options: the case.
        verb: whose table.
        section: the table.
        model: the option --model.
        own: the options --set.
        joint: the options for laws.
    """
    where = f"{options.case}: field `{{}}` of [{verb}]"
    section = with_model_of_case(section, options, [model] if model else None)
    p = options.parameters(changed=False)
    values: dict[str, Any] = {}
    texts = options.texts(verb, section)
    for name, (source, text) in texts.items():
        with reading(source):
            values[name] = _number_or_law(name, text, QUANTITIES[name].dimension, p.shown_in)
    options.warn_of_flow_stress(values)
    numbers, laws = _split(values)
    changes: dict[str, Any] = {**numbers}
    with user_errors():
        p = dataclasses.replace(p, **changes)
    name = model or section.get("model", "linearized")
    own_texts = settings(own, section, f"{options.case}: `set` of [{verb}]")
    given = (joint or LawOptions()).with_section(section, where, options)
    base = options.load(name)
    own_numbers, own_laws = _split(options.read_settings(name, base, own_texts, _number_or_law))
    inputs = (options.case, name, *given.files, *(text for _, text in {**texts, **own_texts}.values()))
    return CaseAndLaws(p, lazy.called(name, base), base, own_numbers, {**laws, **own_laws}, given, inputs)


def _number_or_law(name: str, text: Any, dimension: "lazy.Dimension", bare: "lazy.System") -> Any:
    law = lazy.read_law(str(text), name, dimension, bare)
    return lazy.read_quantity(str(text), dimension, bare) if law is None else law


def _split(values: dict[str, Any]) -> tuple[dict[str, float], dict[str, Any]]:
    """Numbers apart from laws."""
    numbers = {name: value for name, value in values.items() if isinstance(value, float)}
    return numbers, {name: value for name, value in values.items() if name not in numbers}
