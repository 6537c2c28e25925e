"""What every result keeps: a table of text and HTML with its sentences below, and numbers that JSON takes."""

import csv
import functools
import html
import importlib
import inspect
import json
import pkgutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pint
import pytest
from scipy import stats

import erosion
from erosion import ode
from erosion.cfd.map_result import MapSummary
from erosion.output.tables import to_json, to_plain
from erosion.parameters.quantities import SYSTEMS
from erosion.results import Columns, Declared, Result, System, Value, ValueGroup, from_attribute, in_unit, render
from erosion.sweeps.summary import Comparison, SweepSummary
from tests.cfd.tables import Table, hump

P = erosion.TABLE_1
SI = P.to("si").replace(v0=100.0)
DROP = ode.Problem(
    y0={"x": 0.0, "v": 0.0},
    vector_field=lambda t, y, args: {"x": y["v"], "v": 1.0 - args["drag"] * y["v"]},
    events={"ground": ode.Event(lambda t, y, args: y["x"] - 1.0)},
)


@functools.cache
def data() -> dict[str, np.ndarray]:
    """Measured volumes of the linearized model."""
    degrees = np.array([10.0, 20.0, 30.0, 45.0, 60.0, 75.0])
    volume = np.asarray(erosion.impact("linearized", P.replace(alpha=np.deg2rad(degrees))).volume) / 0.0254**3
    error = 0.05 * volume.max()
    measured = volume + error * np.random.default_rng(1).standard_normal(6)
    return {"angle [deg]": degrees, "volume [in^3/impact]": measured, "uncertainty [in^3]": np.full(6, error)}


@functools.cache
def fit() -> erosion.Calibration:
    """Of two parameters."""
    return erosion.calibrate(erosion.FitProblem("linearized", P, data(), ["k", "psi"]))


@functools.cache
def drawn() -> erosion.Posterior:
    """Of one parameter, by few draws."""
    return erosion.posterior(erosion.FitProblem("linearized", P, data(), ["psi"]), draws=125, discrepancy=False)


def of_two() -> list[erosion.FitProblem]:
    """Of two models."""
    return erosion.FitProblem.of_models(["linearized", "finnie"], P, data(), ["psi"])


def wear() -> MapSummary:
    """Of two impacts on two faces."""
    two = Table(count=[1.0, 2.0], mass=[1e-7] * 2, diameter=[4e-4] * 2, speed=[50.0] * 2, alpha=[0.4] * 2, face=[0, 1])
    return MapSummary(erosion.erosion_map("linearized", SI, two, hump(2, 1)))


MAKERS: dict[str, Callable[[], Any]] = {
    "Advice": lambda: erosion.advise(SI, particle="garnet 0.3 mm", target="copper", models=["finnie"]),
    "BestAngles": lambda: drawn().alpha_max(10, discrepancy=False),
    "Calibration": fit,
    "Comparison": lambda: Comparison(
        erosion.compare(["linearized", "finnie"], SI, alpha=np.array([0.2, float(SI.alpha), 0.6])),
        SI, {"linearized": erosion.PerMass(2700.0), "finnie": erosion.PerMass()},
    ),
    "Impact": lambda: erosion.impact("linearized", SI.replace(alpha=np.array([0.3, 0.4])), derivatives=1),
    "Impact by two": lambda: erosion.impact(
        "linearized", SI.replace(alpha=np.linspace(0.1, 0.5, 5)), derivatives=2, wrt=("alpha", "k")
    ),
    "Impact, one, by two": lambda: erosion.impact("linearized", SI, derivatives=1, wrt=("alpha", "k")),
    "MapSummary": wear,
    "Maximum": lambda: ode.maximum(
        DROP, {"drag": 0.1}, of=lambda end: -((end.t - 1.5) ** 2), over="drag", between=(0.0, 2.0), t1=9.0
    ),
    "NextTest": lambda: erosion.next_test(drawn()),
    "Optimum": lambda: erosion.alpha_max("linearized", SI),
    "Optimum of two": lambda: erosion.alpha_max("linearized", SI.replace(k=np.array([1.5, 2.0]))),
    "Parameters": lambda: SI,
    "Parameters that broadcast": lambda: SI.replace(alpha=np.linspace(0.1, 0.5, 5), k=np.array([[1.5], [2.0], [2.5]])),
    "Posterior": drawn,
    "PosteriorRanking": lambda: erosion.rank(
        [erosion.posterior(problem, draws=125, discrepancy=False) for problem in of_two()]
    ),
    "Predictions": lambda: erosion.predict(drawn(), np.array([0.3, 0.5])),
    "Predictor": lambda: drawn().predictor,
    "Profile": lambda: fit().profile("k", 5),
    "Ranking": lambda: erosion.rank([erosion.calibrate(problem) for problem in of_two()]),
    "ResidualChecks": lambda: erosion.check(fit()),
    "Solution": lambda: ode.solve(DROP, {"drag": 0.1}, t1=9.0, wrt="drag"),
    "Stream": lambda: erosion.stream(
        "linearized", SI, n=64, sensitivities=True, alpha=stats.norm(0.3, 0.02), v0=stats.norm(100.0, 3.0)
    ),
    "Stream of long turns": lambda: erosion.stream(
        "linearized", SI.replace(phidot0=1e5), n=64, best_angle=False, alpha=stats.norm(0.3, 0.02)
    ),
    "SweepSummary": lambda: SweepSummary(
        erosion.sweep("linearized", SI, alpha=np.array([0.2, 0.3])), SI, {"": erosion.PerMass(2700.0)}, Path("out.nc")
    ),
    "Trajectory": lambda: erosion.simulate("linearized", SI),
    "Verification": lambda: erosion.verify("tan-alpha"),
}  # fmt: skip
"""By the class of the result, before what the result is of."""


def subclasses(kind: type) -> Iterator[type]:
    for each in kind.__subclasses__():
        yield from (each, *subclasses(each))


def test_each_kind_of_result_is_here() -> None:
    for module in pkgutil.walk_packages(erosion.__path__, "erosion."):
        if not module.name.startswith(("erosion.explorer", "erosion.__main__")):
            importlib.import_module(module.name)
    ours = (kind for kind in subclasses(Result) if kind.__module__.startswith("erosion."))
    kinds = {kind.__name__ for kind in ours if not inspect.isabstract(kind)}
    assert {name.lstrip("_") for name in kinds} == {class_of(kind) for kind in MAKERS}


@functools.cache
def made(kind: str) -> Any:
    """One result of a kind."""
    return MAKERS[kind]()


def class_of(kind: str) -> str:
    return kind.partition(" ")[0].rstrip(",")


def values(result: Any) -> list[Value]:
    """The single numbers, words and arrays that a result declares for programs."""
    return [item for item in result.declare() if isinstance(item, Value) and item.only in ("", "data")]


def parts(declared: Sequence[Declared]) -> list[ValueGroup]:
    """The parts of a result that have a record of their own."""
    return [item for item in declared if isinstance(item, ValueGroup) and item.name and item.only in ("", "data")]


def flat(declared: Sequence[Declared]) -> Iterator[Value]:
    """The values that data have, those of parts too."""
    for item in declared:
        if isinstance(item, ValueGroup):
            yield from flat(item.values)
        elif isinstance(item, Value) and item.only in ("", "data"):
            yield item


def in_display(value: Value, system: System) -> tuple[Any, str]:
    """What a value is in tables, JSON and CSV, and its unit there."""
    if value.measure is None:
        return to_plain(value.value), value.unit
    return to_plain(in_unit(value.value, value.measure.size(system))), value.measure.unit(system)


def is_numeric(plain: Any) -> bool:
    """Whether it is a number or numbers, of the same count in each row."""
    numbers = np.ravel(np.array(plain, dtype=object))
    return numbers.size > 0 and all(isinstance(each, float) for each in numbers)


@pytest.mark.parametrize("kind", MAKERS)
def test_it_is_tables_with_sentences(kind: str) -> None:
    result = made(kind)
    said = [*result.conclusions, *result.warnings]
    assert type(result).__name__ == class_of(kind)
    tables = result.tables()
    assert tables[0].rows == result.rows()
    for table in tables:
        assert {len(row) for row in table.rows} == {len(table.headings)}
    text, page = str(result), result._repr_html_()
    assert text.startswith(result.title)
    assert text.endswith("\n".join(said))
    assert page.count("<tr>") == sum(len(table.rows) + 1 for table in tables)
    assert page.endswith("".join(f"<p>{html.escape(sentence)}</p>" for sentence in said))
    assert repr(result).startswith(f"{class_of(kind)}(")


@pytest.mark.parametrize("kind", MAKERS)
def test_it_is_numbers_by_name(kind: str) -> None:
    numbers = made(kind).to_dict()
    assert numbers.keys() == json.loads(to_json(numbers)).keys() != set()


@pytest.mark.parametrize("kind", MAKERS)
def test_all_outputs_have_the_numbers_that_it_declares(kind: str) -> None:
    result = made(kind)
    numbers, document = result.to_dict(), render.record(result.declare(), result.shown_in, has_units=True)
    dataset, columns = result.to_dataset(), list(csv.DictReader(result.to_csv().splitlines()))
    assert document.keys() <= numbers.keys()
    for part in parts(result.declare()):
        np.testing.assert_equal(numbers[part.name], render.record(part.values, result.shown_in))
        for value in part.values:
            if isinstance(value, Value) and f"{part.name}_{value.name}" in dataset:
                stored = dataset[f"{part.name}_{value.name}"]
                np.testing.assert_equal(stored.values.tolist(), to_plain(value.value))
                assert stored.attrs.get("units", "") == in_display(value, "si")[1]
    assert [finding["code"] for finding in numbers["findings"]] == [finding.code for finding in result.findings]
    assert [each.code for each in from_attribute(dataset.attrs["findings"])] == [each.code for each in result.findings]
    for value in values(result):
        (plain, unit), (in_si, unit_in_si) = in_display(value, result.shown_in), in_display(value, "si")
        np.testing.assert_equal([*numbers[value.name].values()] if value.labels else numbers[value.name], plain)
        assert numbers["units"].get(value.name, "") == unit
        if unit:
            np.testing.assert_equal(document[value.name], {"value": numbers[value.name], "unit": unit})
        if is_numeric(plain) or value.name in dataset:
            np.testing.assert_equal(dataset[value.name].values.tolist(), in_si)
            assert dataset[value.name].attrs.get("units", "") == unit_in_si
        heading = f"{value.name} [{unit}]" if unit not in ("", "1") else value.name
        if value.labels and value.name in dataset:
            (dim,) = dataset[value.name].dims
            np.testing.assert_equal([dataset[value.name].sel({dim: label}).item() for label in value.labels], in_si)
        elif is_numeric(plain) and heading in columns[0] and not follows_columns(result):
            in_lines = [float(line[heading]) for line in columns]
            np.testing.assert_equal(in_lines, np.broadcast_to(plain, shape_of_lines(result)).ravel().tolist())


def follows_columns(result: Result) -> bool:
    """Whether CSV is a table of the result, which stands alone."""
    return any(isinstance(item, Columns) and [item.name] == [*result.lines] for item in result.declare())


def shape_of_lines(result: Result) -> tuple[int, ...]:
    """Of the arrays that CSV has."""
    if result.lines:
        sizes = result.to_dataset().sizes
        return tuple(sizes[dim] for dim in result.lines)
    arrays = [value.value for value in values(result) if isinstance(value.value, np.ndarray) and value.dims is None]
    return np.broadcast_shapes(*map(np.shape, arrays))


@pytest.mark.parametrize("kind", MAKERS)
def test_csv_has_all_numbers_of_its_lines(kind: str) -> None:
    result = made(kind)
    dataset, lines = result.to_dataset(), list(csv.DictReader(result.to_csv().splitlines()))
    headings = {heading.partition(" [")[0] for heading in lines[0]}
    before = f"{result.lines[0]}_" if follows_columns(result) else ""
    assert "correlation" not in headings
    assert len(lines) == np.prod(shape_of_lines(result))
    if result.lines:
        along = [name for name, number in dataset.data_vars.items() if number.dims == tuple(result.lines)]
        assert {str(name).removeprefix(before) for name in along} <= headings


@pytest.mark.parametrize("kind", MAKERS)
def test_files_name_each_dimension(kind: str) -> None:
    result = made(kind)
    lists = [item for item in flat(result.declare()) if isinstance(item.value, list)]
    assert [value.name for value in lists if not (value.dims or value.labels)] == []


@pytest.mark.parametrize("kind", MAKERS)
def test_files_have_the_columns_that_it_declares(kind: str) -> None:
    result = made(kind)
    dataset = result.to_dataset()
    for group in result.declare():
        if isinstance(group, Columns) and group.only in ("", "data"):
            for value in group.values:
                if value.only != "table":
                    assert_known_alike(dataset[f"{group.name}_{value.name}"].values.tolist(), to_plain(value.value))


def test_a_word_or_number_that_is_not_known_is_a_gap_in_files() -> None:
    words, numbers = ["stop", None], [None, 2.0]
    declared = [Columns("models", "Models", [Value("end", words), Value("volume", numbers, unit="m^3")])]
    dataset, lines = (
        render.dataset("", declared, {}),
        list(csv.DictReader(render.csv(declared, "si", ["models"]).splitlines())),
    )
    assert_known_alike(dataset.models_end.values.tolist(), words)
    assert_known_alike(dataset.models_volume.values.tolist(), numbers)
    assert [line["end"] for line in lines] == ["stop", ""]
    assert [line["volume [m^3]"] for line in lines] == ["nan", "2.0"]
    assert render.record(declared, "si")["models"][1] == {"end": None, "volume": 2.0}


def assert_known_alike(stored: list[Any], values: list[Any]) -> None:
    """An empty word stands for a word that is not known, NaN for a number."""
    unknown = "" if any(isinstance(value, str) for value in values) else np.nan
    np.testing.assert_equal(stored, [unknown if value is None else value for value in values])


@pytest.mark.parametrize("kind", MAKERS)
def test_a_table_has_the_numbers_in_other_units_alone(kind: str) -> None:
    registry: Any = pint.UnitRegistry()
    registry.define("percent = 0.01 = %")
    result = made(kind)
    table = result.tables()[0]
    rows = {row[0]: dict(zip(table.headings, row, strict=True)) for row in table.rows}
    assert len(rows) == len(table.rows)
    for value in values(result):
        if value.name in rows and value.only == "" and isinstance(value.value, float) and not np.isnan(value.value):
            row = rows[value.name]
            of_unit = registry.parse_expression(row.get("unit", "").replace("°²", "degree²"))
            shown = registry.Quantity(float(row["value"].partition(" ")[0].replace(",", "")) * of_unit)
            # With its standard error a number has its digits down to the second of the error.
            expected = pytest.approx(value.value, rel=2e-4, abs=0.06 * (value.error or 0.0))
            assert shown.to(in_display(value, "si")[1]).magnitude == expected, value.name


def quantities_in(document: Any) -> Iterator[dict[str, Any]]:
    """Each number with its unit in a document."""
    if isinstance(document, dict) and document.keys() == {"value", "unit"}:
        yield document
    elif isinstance(document, (dict, list, tuple)):
        for each in document.values() if isinstance(document, dict) else document:
            yield from quantities_in(each)


@pytest.mark.parametrize("kind", MAKERS)
def test_both_unit_systems_show_equal_quantities(kind: str) -> None:
    registry: Any = pint.UnitRegistry()
    registry.define("bit = []")
    of_each = [[*quantities_in(render.record(made(kind).declare(), system, has_units=True))] for system in SYSTEMS]
    for one, other in zip(*of_each, strict=True):
        factor = float(registry.Quantity(1.0, other["unit"]).to(one["unit"]).magnitude)
        for there, here in zip(numbers_in(one["value"]), numbers_in(other["value"]), strict=True):
            assert there == pytest.approx(here * factor, rel=1e-12, abs=0, nan_ok=True)


def numbers_in(plain: Any) -> list[float]:
    """The numbers of a number, list or record."""
    if isinstance(plain, (dict, list, tuple)):
        return [
            number for each in (plain.values() if isinstance(plain, dict) else plain) for number in numbers_in(each)
        ]
    return [] if plain is None or isinstance(plain, str) else [float(plain)]
