"""The interface of fits by least squares and by draws: samples, predictions, and a file that keeps both."""

import abc
import functools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from erosion.arguments import check_path
from erosion.fits.fit_files import (
    DATA_FILE,
    EQUATIONS,
    FINDINGS,
    LINE,
    READING,
    SOURCE,
    TESTED,
    TIED,
    prediction_groups,
)
from erosion.fits.least_squares import Group
from erosion.fits.likelihood import given_laws, sampled_quantities
from erosion.fits.measurements import Measurements
from erosion.fits.prediction import Predictor
from erosion.fits.problem import FRACTION, OF_ERROR, SCALE, FitProblem
from erosion.fits.tempering import SamplingError
from erosion.laws import JointSamples, law_as_typed
from erosion.models import model_name, model_source, own_in_words
from erosion.models.equations import plug_in_digest
from erosion.output.files import require_writable, seen_from, write_whole
from erosion.parameters.case_files import dump_case, with_paths
from erosion.parameters.quantities import Quantity
from erosion.results import Finding, Result, System, ValueGroup, to_attribute
from erosion.version import __version__


class Fit(Result):
    """A model fitted to tests."""

    @property
    @abc.abstractmethod
    def problem(self) -> FitProblem:
        """The model and the case as they were given, the free parameters, and the data."""

    @functools.cached_property
    @abc.abstractmethod
    def predictor(self) -> Predictor:
        """The average of the hypotheses, which predictions ask."""

    @functools.cached_property
    @abc.abstractmethod
    def samples(self) -> xr.Dataset:
        """Samples of each parameter, over the dimensions (chain, draw)."""

    @functools.cached_property
    @abc.abstractmethod
    def groups(self) -> Sequence[Group]:
        """The parameters that the data leave open together."""

    @property
    def data(self) -> Measurements:
        """The measurements."""
        return self.problem.data

    @property
    def typed(self) -> dict[str, Any]:
        """The options of `erosion posterior` that read the tests and state the priors, by name.

        A prior that no text names is an empty text.
        """
        known = sampled_quantities(self.problem)
        laws = {name: law_as_typed(law, known[name].dimension) for name, law in given_laws(self.problem).items()}
        return {**self.data.reading, **({"prior": laws} if laws else {})}

    @property
    @abc.abstractmethod
    def quantities(self) -> Mapping[str, Quantity]:
        """Symbol, meaning and dimension of each parameter."""

    def of_parameters(self, name: str, numbers: Mapping[str, Any]) -> ValueGroup:
        """Numbers of parameters, such as estimates or intervals, which JSON and files have by name."""
        return ValueGroup(
            name, [self.quantities[of].declare(of, number) for of, number in numbers.items()], only="data"
        )

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.problem.p.shown_in

    @property
    def erosion_unit(self) -> str:
        """The unit of the data's erosion, as programs read it."""
        return self.data.erosion_unit

    @property
    def converged(self) -> bool:
        """Whether the samples are good."""
        return all(hypothesis.converged for hypothesis in self.predictor.hypotheses.values())

    @property
    def tied_to_scale(self) -> tuple[str, ...]:
        """The parameters that data in units of their own leave open, as the scale has their influence."""
        tied = {name for group in self.groups if SCALE in group.names for name in group.names} - {SCALE}
        return tuple(name for name in self.problem.names if name in tied)

    def joint_samples(self) -> JointSamples:
        """The samples, drawn together, for `uncertain` of `erosion.stream`, `erosion.erosion_map` and `erosion.advise`.

        It has the parameters of an impact, and "cutting_fraction" if that was fitted: a map takes it, a stream does
        not. "scale" and the errors belong to the measurements and are left out, and so is what is tied to the scale.
        Values are in SI.

        Raises:
            SamplingError: where no such parameter is left, or impacts fail all over the bounds.
        """
        names = [name for name in self.problem.names if name not in (SCALE, *OF_ERROR, *self.tied_to_scale)]
        if not names:
            raise SamplingError("The fit has no samples: it decides no parameter of an impact.")
        columns = {name: self.samples[name].values for name in names}
        tested = self.problem.tested.ranges
        return JointSamples(columns, f"the fit to {self.data.source}", tested=tested)

    def dataset(self, values: Mapping[str, Any]) -> xr.Dataset:
        """Samples by name, of the shape (chains, draws), with their units."""
        known, (chains, draws) = sampled_quantities(self.problem), next(iter(values.values())).shape
        columns = {name: (("chain", "draw"), column, known[name].attributes())
                   for name, column in values.items()}  # fmt: skip
        return xr.Dataset(columns, {"chain": range(chains), "draw": range(draws)})

    @property
    def described(self) -> dict[str, Any]:
        """Attributes of the samples in a file."""
        problem = self.problem
        fraction = {} if FRACTION in problem.names else {FRACTION: problem.cutting_fraction}
        return {
            "inference_library": "erosion",
            "inference_library_version": __version__,
            "model": model_name(problem.model),
            SOURCE: model_source(problem.model) or "",
            EQUATIONS: plug_in_digest(problem.model),
            "case": dump_case(problem.p),
            "unit_system": problem.p.shown_in,
            "own_parameters": own_in_words(problem.model, but=problem.names, system="si"),
            **fraction,
            "data": self.data.source,
            "seed": self.predictor.seed,
            "converged": int(self.converged),
            TESTED: json.dumps(problem.tested.ranges),
            TIED: json.dumps(self.tied_to_scale),
        }

    @property
    def sample_stats(self) -> xr.Dataset | None:
        """Numbers of each sample; None without any."""
        return None

    def to_datatree(self) -> xr.DataTree:
        """Everything in ArviZ's layout: the groups posterior, sample_stats, observed_data and constant_data."""
        # The rows as predictions read them: a robust loss has errors of its own.
        data, known = self.predictor.data, sampled_quantities(self.problem)
        observed: dict[str, Any] = {"erosion": ("row", data.erosion, data.quantity.attributes())}
        if data.uncertainty is not None:
            observed["uncertainty"] = ("row", data.uncertainty, {"units": data.erosion_unit})
        if data.speeds is not None:
            observed["speeds"] = ("row", data.speeds, {"long_name": "which speed's error it shares"})
        if data.parts is not None:
            observed["parts"] = (("row", "part"), data.parts, {"long_name": "absolute and relative part"})
        constant = {name: ("row", values, known[name].attributes()) for name, values in data.conditions.items()}
        if data.lines is not None:
            constant[LINE] = ("row", data.lines, {"long_name": f"line of {data.source}"})
        groups = {
            "posterior": self.samples.assign_attrs(self.described),
            "observed_data": xr.Dataset(observed),
            "constant_data": xr.Dataset(constant),
            **prediction_groups(self.predictor),
        }
        return xr.DataTree.from_dict(
            groups if self.sample_stats is None else groups | {"sample_stats": self.sample_stats}
        )

    def save(self, path: str | Path, findings: Sequence[Finding] | None = None) -> Path:
        """Write `to_datatree` to a netCDF file, whole or not at all.

        Args:
            path: ends in .nc.
            findings: for whoever uses the file; those of the fit without them.

        Raises:
            ValueError: for a suffix other than .nc.
            OSError: where the file cannot be written.
        """
        path = check_path("path", path)
        if path.suffix != ".nc":
            raise ValueError(f"Argument `path` must end in .nc, but is {path}.")
        require_writable(path)
        tree = self.to_datatree()
        samples = tree["posterior"].attrs
        samples[FINDINGS] = to_attribute(self.doubts if findings is None else findings)
        samples[SOURCE] = with_paths(samples[SOURCE], functools.partial(seen_from, path))
        if self.data.path is not None:
            samples[DATA_FILE] = seen_from(path, str(self.data.path))
        moved = with_paths(self.typed, functools.partial(seen_from, path))
        samples[READING] = json.dumps(moved)
        # HDF5 then sees numbers that were damaged; it keeps no checksum of what has no axes.
        checked = {
            group.path: {name: {"fletcher32": True} for name, values in group.data_vars.items() if values.ndim}
            for group in tree.subtree
        }
        with memoryview(tree.to_netcdf(None, engine="h5netcdf", encoding=checked)) as content:
            write_whole(path, content)
        return path

    @property
    def doubts(self) -> Sequence[Finding]:
        """The findings but for those on the samples, which whoever reads a file is told."""
        return self.findings


def require_fits(argument: str, fits: Any) -> Sequence[Fit]:
    """A list of one fit or more.

    Raises:
        TypeError: for anything else, such as a ranking.
    """
    if not isinstance(fits, Sequence) or not fits or not all(isinstance(fit, Fit) for fit in fits):
        raise TypeError(
            f"Argument `{argument}` must be a fit, or where several count a list of fits; of a ranking `ranking.best` "
            f"or `ranking.fits`."
        )
    return fits
