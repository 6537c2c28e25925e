"""Files of fits: what `Fit.save` writes, read as samples for streams and maps of the same model."""

import dataclasses
import functools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr

from erosion.arguments import check_path
from erosion.fits.errors import ErrorModel
from erosion.fits.measurements import Measurements
from erosion.fits.prediction import Predictor, predictor_of
from erosion.fits.problem import FACTORS, FRACTION, OF_ERROR, SCALE, FitProblem
from erosion.laws import JointSamples
from erosion.models import CuttingModel, load_model, model_name
from erosion.models.base import own_in_words, own_parameters
from erosion.models.equations import plug_in_digest
from erosion.output import beside, require_finite
from erosion.parameters import (
    QUANTITIES,
    Parameters,
    Quantity,
    System,
    Tested,
    parse_case,
    with_paths,
)
from erosion.results import Finding, found, from_attribute

_PREDICTION = "prediction"
EQUATIONS = "equations"
"""The attribute with the digest of a plug-in's equations."""
LINE = "line"
"""The variable with each row's line of the file of data."""
SOURCE, DATA_FILE = "model_source", "data_file"
"""The attributes with what loads the model again, its name or its file, and with the tests' table; paths begin here."""
READING = "reading"
"""The attribute with how that table was read, see `Measurements`; in JSON, paths begin here."""
TESTED, FINDINGS = "tested", "findings"
"""The attributes with the ranges of the tests, as `Tested` has them, and what is doubtful in the fit; in JSON."""
TIED = "tied_to_scale"
"""The attribute with the parameters whose samples mean nothing, as the tests had units of their own; in JSON."""
_OF_METAL = ("k", "psi", "sigma")  # those that a case must share with the data


@dataclasses.dataclass(frozen=True)
class Draws:
    """The draws of a posterior, and what they were drawn with.

    Args:
        rows: the parameters of an impact that were sampled, and the share of the particles that cut if it was.
        path: of the file.
        model: its name.
        own: its own parameters that were not sampled, in words.
        equations: the digest of a plug-in, see `plug_in_digest`.
        p: the case of the fit.
        cutting_fraction: the share of the particles that cut that the fit assumed, or None where it was sampled.
        has_scale: whether the measurements were in units of their own.
        converged: whether the draws are good.
        findings: what else was doubtful in the fit.
        data: the path of the tests' table.
        typed: see `Fit.typed`.
    """

    rows: JointSamples
    path: Path
    model: str
    own: str
    equations: str
    p: Parameters
    cutting_fraction: float | None
    has_scale: bool
    converged: bool
    findings: tuple[Finding, ...]
    data: str
    typed: Mapping[str, Any]

    @functools.cached_property
    def predictor(self) -> Predictor | None:
        """The predictor of the file; None without one, and where only the shape of the wear is known."""
        with h5py.File(self.path) as file:
            is_kept = _PREDICTION in file
        return read_predictor(self.path) if is_kept and not self.has_scale else None

    def otherwise(self, p: Parameters) -> dict[str, str]:
        """What the case of the fit has otherwise than `p`, as options take it; not what was sampled."""
        numbers = [(name, float(getattr(self.p, name)), float(getattr(p, name)))
                   for name in QUANTITIES if name not in (*self.rows.columns, "alpha")]  # fmt: skip
        return {name: with_unit(before, QUANTITIES[name], p.shown_in, 9)
                for name, before, now in numbers if not np.isclose(before, now, rtol=1e-6, atol=0)}  # fmt: skip

    def require_same_equations(self, model: CuttingModel) -> None:
        """A `ValueError` where a plug-in computes something else than when the draws were made."""
        _require_same_equations(self.path, self.equations, model)

    def of_fit(self) -> list[Finding]:
        """Findings of the fit, with the name of this file."""
        abouts = [f"{finding.about} ({self.path})" if finding.about else str(self.path) for finding in self.findings]
        return [dataclasses.replace(finding, about=about)
                for finding, about in zip(self.findings, abouts, strict=True)]  # fmt: skip

    def doubts(self, model: CuttingModel, p: Parameters, cutting_fraction: float) -> list[Finding]:
        """Findings on what an impact has otherwise than the fit and its tests."""
        here = own_in_words(model, but=self.rows.columns, system="si")
        share = cutting_fraction if self.cutting_fraction is None else self.cutting_fraction
        numbers = [(QUANTITIES[name], float(getattr(self.p, name)), float(getattr(p, name)))
                   for name in _OF_METAL if name not in self.rows.columns]  # fmt: skip
        path = str(self.path)

        def otherwise(quantity: Quantity, *values: float) -> Finding:
            before, now = (with_unit(value, quantity, p.shown_in) for value in values)
            return Finding("draws_of_other_metal", path, {"symbol": quantity.symbol, "before": before, "now": now})

        doubts = found(
            (not self.converged, Finding("not_converged", path)),
            *((not np.isclose(before, now, rtol=1e-6, atol=0), otherwise(quantity, before, now))
              for quantity, before, now in numbers),
            (self.own != here, Finding("draws_of_other_model", path, {"before": self.own, "now": here})),
            (self.has_scale, Finding("draws_without_size", path)),
            (not np.isclose(share, cutting_fraction),
             Finding("draws_of_other_fraction", path, {"before": share, "now": cutting_fraction})),
        )  # fmt: skip
        outside = Tested(self.rows.tested).outside({name: getattr(p, name) for name in ("v0", "m")}, path)
        return [*doubts, *outside]


def _require_same_equations(path: Path, equations: str, model: CuttingModel) -> None:
    if plug_in_digest(model) != equations:
        raise ValueError(
            f"{path}: has draws of {model_name(model)} as it was, but its equations have changed since; draw again."
        )


def with_unit(value: float, quantity: Quantity, system: System, digits: int = 6) -> str:
    """A number [SI] in the unit of a system, as options take it: "4400 in/s"."""
    return f"{value / quantity.size(system):.{digits}g} {quantity.unit(system)}".removesuffix(" 1")


def read_draws(path: str | Path, quantities: Mapping[str, Quantity]) -> Draws:
    """Read what `Fit.save` or `erosion posterior -o` has written.

    Args:
        path: of the file (.nc).
        quantities: the parameters of the model that is to take them, see `erosion.models.quantities`.

    Raises:
        ValueError: for a file that is something else, or has parameters that the model has not.
    """
    path = check_path("path", path)
    dataset = _opened(path)
    attrs = dataset.attrs
    known = {**quantities, FRACTION: FACTORS[FRACTION]}
    columns = {}
    # The noise and the scale are of the measurements, not of an impact, and so is what the scale decides.
    of_tests = [*OF_ERROR, SCALE, *_kept(attrs, TIED, [])]
    for name in map(str, dataset.drop_vars(of_tests, errors="ignore").data_vars):
        values = dataset[name]
        if name not in known or values.attrs.get("units") != known[name].unit("si"):
            raise ValueError(
                f"{path}: has draws of {name} [{values.attrs.get('units', '?')}] for {attrs['model']}, which is not a "
                f"parameter here; they are {', '.join(quantities)}."
            )
        columns[name] = values.values
        if not columns[name].size or not np.isfinite(columns[name]).all():
            raise ValueError(f"{path}: must have finite draws of {name}, one or more, but has not.")
    if not columns:
        raise ValueError(f"{path}: must have draws of parameters of an impact, but has none.")
    try:
        case = parse_case(attrs["case"])
    except ValueError as error:
        raise ValueError(f"{path}: must hold the draws of a posterior, but its case cannot be read.") from error
    return Draws(
        JointSamples(columns, str(path), tested={name: tuple(ends) for name, ends in _kept(attrs, TESTED, {}).items()}),
        path,
        model=attrs["model"],
        own=attrs.get("own_parameters", ""),
        equations=attrs.get(EQUATIONS, ""),
        p=case,
        cutting_fraction=None if FRACTION in columns else float(attrs.get(FRACTION, 1.0)),
        has_scale=SCALE in dataset,
        converged=bool(attrs.get("converged", 1)),
        findings=from_attribute(attrs.get(FINDINGS, "")),
        data=beside(path, attrs[DATA_FILE]) if DATA_FILE in attrs else "rows.csv",
        typed=with_paths(_kept(attrs, READING, {}), functools.partial(beside, path)),
    )


def _kept(attrs: Mapping[str, Any], name: str, without: Any) -> Any:
    """What an attribute keeps in JSON, or `without` where the file lacks it."""
    return json.loads(attrs[name]) if name in attrs else without


def prediction_groups(predictor: Predictor) -> dict[str, xr.Dataset]:
    """Groups that `read_predictor` needs beside the draws' file: the draws of each hypothesis."""
    problem = predictor.problem
    own = {name: float(parameter.value) for name, parameter in own_parameters(problem.model).items()}
    error = problem.data.error
    described = {
        "free": list(problem.free),
        "seed": predictor.seed,
        "own": json.dumps(own),
        "dimension": problem.data.dimension,
        "unit": problem.data.unit,
        "cutting_fraction": problem.cutting_fraction,
        **({} if problem.density is None else {"density": problem.density}),
        **({} if error is None else {"error": [*dataclasses.astuple(error)]}),
    }
    groups = {_PREDICTION: xr.Dataset(attrs=described)}
    for name, hypothesis in predictor.hypotheses.items():
        values = {of: ("draw", column) for of, column in hypothesis.values.items()}
        about = {
            "weight": hypothesis.weight,
            "converged": int(hypothesis.converged),
            "log_evidence": hypothesis.log_evidence,
        }
        groups[f"{_PREDICTION}/{name}"] = xr.Dataset(values, attrs=about)
    return groups


def read_predictor(path: str | Path) -> Predictor:
    """The predictions of a posterior from the file that `Fit.save` wrote; they are those before it was saved.

    Args:
        path: of the file (.nc).

    Raises:
        ValueError: for a file that holds something else, or draws without predictions.
    """
    path = check_path("path", path)
    attrs = _opened(path).attrs
    model, p = load_model(model_of_draws(path)), parse_case(attrs["case"])
    _require_same_equations(path, attrs.get(EQUATIONS, ""), model)
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        if _PREDICTION not in tree.children:
            raise ValueError(f"{path}: has draws without predictions.")
        about, hypotheses = tree[_PREDICTION].attrs, tree[_PREDICTION].children
        rows = {**tree["observed_data"].data_vars, **tree["constant_data"].data_vars}
        columns = {name: values.values for name, values in rows.items()}
        error = about.get("error")
        data = Measurements(
            columns["alpha"], columns["erosion"], about["dimension"], columns.get("uncertainty"), columns.get("v0"),
            columns.get("m"), shown_in=p.shown_in, source=attrs["data"],
            error=None if error is None else ErrorModel(*map(float, error)),
            parts=columns.get("parts"), speeds=columns.get("speeds"), lines=columns.get(LINE),
            unit=str(about.get("unit", "")),
        )  # fmt: skip
        density = None if "density" not in about else float(about["density"])
        names = tuple(np.atleast_1d(about["free"]).tolist())
        problem = FitProblem(model.replace(**json.loads(about["own"])), p, data, names, density=density,
                             cutting_fraction=float(about["cutting_fraction"]))  # fmt: skip
        if any(np.ndim(hypothesis.attrs["log_evidence"]) for hypothesis in hypotheses.values()):
            raise ValueError(f"{path}: was written by an older version, whose predictions cannot be read; fit again.")
        read = {
            str(name): {
                "values": {str(of): column.values for of, column in hypothesis.data_vars.items()},
                "log_evidence": float(hypothesis.attrs["log_evidence"]),
                "weight": float(hypothesis.attrs["weight"]),
                "converged": bool(hypothesis.attrs.get("converged", 1)),
            }
            for name, hypothesis in hypotheses.items()
        }
    return predictor_of(problem, read, int(about["seed"]))


def model_of_draws(path: str | Path) -> str:
    """The name of the model whose draws a file has, or the path of its file; errors as of `read_draws`."""
    path = check_path("path", path)
    attrs = _opened(path).attrs
    return with_paths(str(attrs.get(SOURCE) or attrs["model"]), functools.partial(beside, path))


def _opened(path: Path) -> xr.Dataset:
    """The draws with the attributes that `Fit.save` gives them."""
    require_finite(path)
    try:
        with xr.open_dataset(path, group="posterior", engine="h5netcdf") as stored:
            dataset = stored.load()
    except FileNotFoundError:
        raise ValueError(f"{path}: is not there.") from None
    # Damaged bytes may be anything to the libraries.
    except (OSError, ValueError, RuntimeError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise ValueError(f"{path}: must hold the draws of a posterior, but cannot be read as such.") from error
    if dataset.attrs.get("inference_library") != "erosion" or not {"unit_system", "case", "model"} <= {*dataset.attrs}:
        raise ValueError(f"{path}: must hold the draws of a posterior of this program, but holds something else.")
    return dataset
