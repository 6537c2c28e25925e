"""Results as tables: of one impact, of a batch, of nothing, and of what JAX is tracing."""

import dataclasses
import json
import math

import jax
import numpy as np
import pytest

import erosion
from erosion.output.tables import Result, abbreviate, format_number, to_json, to_lines, to_plain, with_error

P = erosion.TABLE_1


def test_numbers_arrays_and_names_are_told_in_few_words():
    assert format_number(1.5e-4) == "0.00015"
    assert format_number(np.array([0.25, np.nan, 0.75])) == "[3] 0.25 … 0.75"
    assert format_number(np.array([np.nan, np.nan])) == "[2] nan … nan"
    assert format_number(np.zeros((0, 3))) == "[0, 3] empty"
    assert format_number("stop") == "stop"
    assert format_number(np.array(["stop", "rebound", "stop"])) == "1 rebound, 2 stop"
    assert abbreviate(4400.0) == "4400"
    assert abbreviate("stop") == "'stop'"
    assert abbreviate(np.array([1.0, 2.0])) == "<[2] 1 … 2>"


def test_what_is_traced_has_a_shape_and_no_numbers():
    said = []

    @jax.jit
    def traced(x):
        said.extend([format_number(x), abbreviate(x), repr(P.replace(alpha=x[0]))])
        return x

    traced(np.array([0.1, 0.2]))
    assert said[:2] == ["traced[2]", "<traced[2]>"]
    assert "alpha=<traced[]>" in said[2]


def test_a_batch_of_impacts_is_a_table_of_ranges():
    hit = erosion.impact("linearized", P.replace(alpha=np.deg2rad([20.0, 60.0])), derivatives=2)
    lines = {line.split()[0]: line for line in str(hit).splitlines() if line}
    assert "[2] 0.863638 … 1.81644   10⁻⁴ in³" in lines["volume"]
    assert "1 rebound, 1 stop" in lines["ended_by"]
    assert "in³/°²" in lines["d2volume"]
    html = hit._repr_html_()
    assert html.count("<tr>") == 6
    assert "1 rebound, 1 stop" in html


@pytest.mark.parametrize("k", [2.0, [1.0, 2.0]])
def test_the_best_angles_are_told(k):
    best = erosion.alpha_max("linearized", P.replace(k=k))
    said = str(best)
    assert "linearized: the angle of greatest volume" in said
    assert ("[2] 22.5 … 31.717" in said) == isinstance(k, list)
    assert ("2 interior" in said) == isinstance(k, list)
    assert "31.717" in best._repr_html_()


@dataclasses.dataclass(frozen=True)
class Measured(Result):
    values: np.ndarray
    count: np.int64
    pairs: tuple[tuple[str, float], ...]

    @property
    def title(self) -> str:
        return "three <numbers>"

    @property
    def warnings(self) -> tuple[str, ...]:
        return ("1 < 2.",)

    def rows(self) -> list[tuple[str, ...]]:
        return [("values", "", "3", "", "")]


MEASURED = Measured(np.array([1.0, np.nan]), np.int64(3), (("a", np.float64(0.1)),))


def test_a_result_is_a_table_with_sentences_below():
    lines = str(MEASURED).splitlines()
    assert (lines[0], lines[-1]) == ("three <numbers>", "1 < 2.")
    assert MEASURED._repr_html_().endswith("</table><p>1 &lt; 2.</p>")
    assert "three &lt;numbers&gt;" in MEASURED._repr_html_()


def test_a_result_is_numbers_by_name():
    numbers = MEASURED.to_dict()
    assert numbers["pairs"] == [["a", 0.1]]
    assert (type(numbers["count"]), type(numbers["values"])) == (int, list)
    assert np.isnan(numbers["values"][1])
    # JSON has no NaN.
    assert json.loads(to_json(numbers))["values"] == [1.0, None]
    with pytest.raises(TypeError, match="object is not made of numbers and texts"):
        to_plain({"a": object()})


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (31.71746, 0.00011, "31.71746 ± 0.00011"),
        (31.71746, 0.4, "31.72 ± 0.40"),
        (1.7970592e-4, 8.4e-9, "0.0001797059 ± 0.0000000084"),
        (629.4428, 0.0, "629.443"),
        (1234.5, 110.0, "1230 ± 110"),
        (0.5, math.inf, "0.5 ± inf"),
        (2e9, 3.0, "2e+09 ± 3"),
    ],
)
def test_a_number_shows_the_digits_that_its_error_leaves(value, error, text) -> None:
    assert with_error(value, error) == text


def test_names_stay_beside_their_numbers_where_a_tighter_table_does_it() -> None:
    rows = [("rotating-full-torque", "0.89526", "rebound", "23.884°", "0.90989", "interior", "rebound")]
    headings = ("model", "V", "ends by", "α_max", "V_max", "kind", "ends by")
    lines = [line.plain for line in to_lines("", rows, headings, (1, 3, 4), 80)]
    assert any(line.startswith(" rotating-full-torque  0.89526  rebound") for line in lines)
    assert max(map(len, lines)) <= 80


def test_a_name_stays_with_its_value() -> None:
    lines = [line.plain for line in to_lines("", [("a", "k = 1.284, psi = 7.678, energy_ratio = 1.42719679 m/s")],
                                             ("model", "estimates"), (), 26)]  # fmt: skip
    assert [line.split("  ")[-1].strip() for line in lines[3:-1]] == [
        "k = 1.284,", "psi = 7.678,", "energy_ratio =", "1.42719679 m/s",
    ]  # fmt: skip
