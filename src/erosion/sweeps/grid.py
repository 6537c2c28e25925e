"""Grids of impacts: the models, the values of the parameters, the blocks, and the results of each impact.

A grid can be cut into blocks, which are grids themselves. The numbers do not depend on the
cuts, because the engine computes every impact on its own.
"""

import abc
import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.arguments import check_order, check_share, real_numbers, refuse, unit_of_labels
from erosion.impacts import (
    QUARTER_TURN,
    TURNED,
    alpha_max,
    count_turned,
    end_names,
    finding_of_turned,
    identity,
    impact,
    numbers_in_words,
    provenance,
    pushed_forward,
    turn_of,
)
from erosion.models import (
    BUILT_IN,
    CuttingModel,
    load_model,
    model_digest,
    model_name,
    own_in_words,
    own_quantities,
    quantities,
    require_loadable,
    require_one_impact,
    with_values,
)
from erosion.output import briefly
from erosion.parameters import (
    QUANTITIES,
    RESULTS,
    InSI,
    Parameters,
    Quantity,
    System,
    about,
    ascii_unit,
    derivative_unit,
    require_concrete,
    require_parameters,
    si_numbers,
    validate,
)
from erosion.results import Finding, to_attribute
from erosion.tables.headings import factor

Region = tuple[slice, ...]
"""The place of a block in its grid: one slice for each dimension."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AnyGrid(abc.ABC):
    """A grid of impacts, or of lanes of any problem, computed and stored block by block.

    Args:
        axes: by name, the values along each axis, shape (n,).
    """

    axes: Mapping[str, np.ndarray]

    @functools.cached_property
    def outside_of_range(self) -> tuple[Finding, ...]:
        """Findings on what lies outside of what a model is made for."""
        return ()

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions."""
        return tuple(self.axes)

    @property
    def labels(self) -> dict[str, np.ndarray]:
        """The values along each dimension, by name."""
        return dict(self.axes)

    @property
    def lengths(self) -> dict[str, int]:
        """Length of each dimension, by name."""
        return {dim: len(self.labels[dim]) for dim in self.dims}

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each dimension."""
        return tuple(self.lengths.values())

    @functools.cached_property
    @abc.abstractmethod
    def identity(self) -> dict[str, str]:
        """In words, what the numbers depend on."""

    @abc.abstractmethod
    def __getitem__(self, region: Region) -> "AnyGrid":
        """The block of a region."""

    @abc.abstractmethod
    def variables(self) -> "Mapping[str, Variable]":
        """The arrays; `ended_by` comes last, and its code 0 means that nothing is computed."""

    @abc.abstractmethod
    def solve(self) -> dict[str, np.ndarray]:
        """Compute all of it, by name."""

    @abc.abstractmethod
    def frame(self) -> xr.Dataset:
        """Coordinates and attributes."""

    def labelled(self, values: Mapping[str, Any]) -> xr.Dataset:
        """Arrays of the variables' dimensions as a Dataset."""
        arrays = {name: (its.dims, values[name], dict(its.attributes)) for name, its in self.variables().items()}
        return self.frame().assign(arrays)

    def require_portable(self) -> None:  # noqa: B027 (a problem needs no other)
        """Refuse what the workers of a cluster cannot load; a problem travels to them as it is."""


def block_shape(
    lengths: Mapping[str, int], chunks: Mapping[str, int] | None, least: int, usual: int
) -> tuple[int, ...]:
    """The shape of blocks: the last dimensions whole, up to `usual` impacts.

    Args:
        lengths: of the dimensions of the grid.
        chunks: lengths of blocks by dimension, from the user; other dimensions stay whole. None: choose.
        least: impacts that a block must have, if the grid has as many.
        usual: impacts that a block should have.

    Raises:
        ValueError: for an unknown dimension, a length that is no positive number, or blocks
            that are too small.
    """
    # Each model compiles to a program of its own, so a block has one model.
    longest = {dim: 1 if dim == "model" else n for dim, n in lengths.items()}
    if chunks is None:
        room, block = usual, {}
        for dim in reversed(list(longest)):
            pieces = math.ceil(longest[dim] / max(room, 1))
            block[dim] = math.ceil(longest[dim] / pieces)
            room //= block[dim]
        return tuple(block[dim] for dim in longest)
    if not isinstance(chunks, Mapping):
        raise TypeError(f"Argument `chunks` must give lengths by dimension, but is {briefly(chunks)}.")
    for dim, length in chunks.items():
        refuse(
            "Argument `chunks` must ",
            (dim not in longest, f"name dimensions ({', '.join(longest)}), but has {briefly(dim)}."),
            (not isinstance(length, int) or isinstance(length, bool) or length < 1,
             f"give positive whole numbers, but has {dim}={length!r}."),
        )  # fmt: skip
    shape = tuple(min(chunks.get(dim, longest[dim]), longest[dim]) for dim in longest)
    if math.prod(shape) < min(least, math.prod(longest.values())):
        raise ValueError(
            f"Argument `chunks` must make blocks of at least {least:,} impacts, but makes blocks of "
            f"{math.prod(shape):,}."
        )
    return shape


def regions(shape: Sequence[int], block: Sequence[int]) -> Iterator[Region]:
    """The regions of all blocks, in the order of memory."""
    cuts = [
        [slice(begin, min(begin + step, n)) for begin in range(0, n, step)]
        for n, step in zip(shape, block, strict=True)
    ]
    return itertools.product(*cuts)


Model = CuttingModel | str | Path
PAIR = "pair"
"""The dimension of paired axes."""

_ENDS = ("not-computed", "no-cut", "rebound", "stop", "failed", "unfinished")
KINDS = ("not-computed", "interior", "jump", "boundary", "kink", "plateau", "none", "unresolved", "limit")
"""Meanings of the codes 0, 1, … in `alpha_max_kind`; see `Optimum.kind`."""


@dataclasses.dataclass(frozen=True)
class Variable:
    """An array of a sweep: its dimensions, and its attributes in the words of the CF conventions."""

    dims: tuple[str, ...]
    attributes: Mapping[str, Any]

    @property
    def empty(self) -> Any:
        """The value of what is not computed yet: NaN, or the code of "not-computed"."""
        return np.int8(0) if "flag_values" in self.attributes else np.nan


def flags(meanings: Sequence[str], **names: str) -> dict[str, Any]:
    """Attributes of codes 0, 1, … with these meanings."""
    values = np.arange(len(meanings), dtype=np.int8)
    return {**names, "flag_values": values, "flag_meanings": " ".join(meanings)}


@dataclasses.dataclass(frozen=True)
class SweepOutputs:
    """Results that are computed for each impact.

    Args:
        derivatives, wrt, rtol: see `erosion.impact`; `wrt` is one parameter.
        optimum: whether the best angle is computed too, over the other dimensions than "alpha".
        max_turn: the greatest turn of the body [rad] among which the best angle is searched, see `erosion.alpha_max`.
        turn: whether the turn of the body is computed too.
        at_contact: whether a model removes something beside the cut.
        own: quantities of the models' own by name, those that all models have.

    Raises:
        ValueError, TypeError: for an output that makes no sense.
    """

    derivatives: int = 0
    wrt: str = "alpha"
    rtol: float = 1e-9
    optimum: bool = False
    max_turn: float | None = QUARTER_TURN
    turn: bool = False
    at_contact: bool = False
    own: Mapping[str, Quantity] = dataclasses.field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the numbers of each impact."""
        volumes = ("volume", "volume_at_contact") if self.at_contact else ("volume",)
        turn = ("turn",) if self.turn else ()
        return (*volumes, *self.own, "t_c", *turn, *("dvolume", "d2volume")[: self.derivatives])

    def __post_init__(self) -> None:
        object.__setattr__(self, "derivatives", check_order(self.derivatives))
        for name in ("optimum", "turn"):
            if not isinstance(getattr(self, name), bool):
                raise TypeError(f"Argument `{name}` must be true or false, but is {briefly(getattr(self, name))}.")
        object.__setattr__(self, "rtol", check_share("rtol", self.rtol))


@dataclasses.dataclass(frozen=True)
class Named:
    """A model that any process finds by its name or path, and its digest when the grid was made; None of a built-in."""

    name: str | Path
    digest: str | None


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Grid(AnyGrid):
    """A rectangle of impacts; `axes` are parameters of the case or every model's own.

    Args:
        models: the label of each model, and the model, or its name and digest.
        compared: whether "model" is a dimension (else there is one model).
        p: the case, all scalars; the axes replace some of its values.
        paired: names of the axes that go together along the dimension "pair".
        ends: meanings of the codes 0, 1, … in `ended_by`; 0 is "not-computed".
        outputs: what is computed of each impact.
        own: values, for all models, of own parameters that are no axes.
    """

    models: "Mapping[str, CuttingModel | Named]"
    compared: bool
    p: Parameters
    paired: tuple[str, ...]
    ends: tuple[str, ...]
    outputs: SweepOutputs
    own: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def dim_of(self, axis: str) -> str:
        """The dimension along which the values of an axis lie."""
        return PAIR if axis in self.paired else axis

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions: "model", then the axes in their order."""
        return tuple(dict.fromkeys(map(self.dim_of, self.labels)))

    @property
    def labels(self) -> dict[str, np.ndarray]:
        """The values along each dimension, and of paired axes."""
        # Python strings: numpy's fixed-length ones have no specification in Zarr.
        models = {"model": np.array(list(self.models), dtype=object)} if self.compared else {}
        return {**models, **self.axes}

    @property
    def lengths(self) -> dict[str, int]:
        """Length of each dimension, by name."""
        return {self.dim_of(name): len(values) for name, values in self.labels.items()}

    def require_portable(self) -> None:
        """Refuse models that the workers of a cluster cannot load.

        Raises:
            ValueError: see `require_loadable`.
        """
        for label, model in self.models.items():
            require_loadable(model, f", {label}; `--set` and axes change its own parameters")

    def __getitem__(self, region: Region) -> "Grid":
        """The block of this region."""
        along = dict(zip(self.dims, region, strict=True))
        labels = list(self.models)[along.get("model", slice(None))]
        # Blocks along α share their optimum; the first of them computes it.
        optimum = self.outputs.optimum and along.get("alpha", slice(None)).start in (0, None)
        return dataclasses.replace(
            self,
            models={label: self.models[label] for label in labels},
            axes={name: values[along[self.dim_of(name)]] for name, values in self.axes.items()},
            outputs=dataclasses.replace(self.outputs, optimum=optimum),
        )

    def loaded(self) -> dict[str, CuttingModel]:
        """The models by label, with the values of `own`."""
        return {label: _loaded(model).replace(**self.own) for label, model in self.models.items()}

    @functools.cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Symbols and meanings of the parameters of case and models, by name."""
        return quantities(next(iter(self.loaded().values())))

    def impacts(self, model: CuttingModel, but: str = "") -> tuple[CuttingModel, Parameters]:
        """A model and its case with all axes `but` one, as values that broadcast to the shape of their dimensions."""
        dims = [dim for dim in self.dims if dim not in ("model", but)]
        values = {
            name: values.reshape([-1 if dim == self.dim_of(name) else 1 for dim in dims])
            for name, values in self.axes.items()
            if self.dim_of(name) in dims
        }
        return with_values(model, self.p, values)

    @functools.cached_property
    def outside_of_range(self) -> tuple[Finding, ...]:
        """Findings on the impacts that lie outside of what a model is made for."""
        impacts = [self.impacts(model) for model in self.loaded().values()]
        return tuple(said for model, p in impacts if (said := model.outside_of_range(p)) is not None)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Forces of the wrong sign, impacts outside of a model's range, and those that turn the body too far."""
        names = {name if self.compared else "": model for name, model in self.loaded().items()}
        pushed = (Finding("pushed_forward", name) for name, model in names.items()
                  if pushed_forward(*self.impacts(model)))  # fmt: skip
        turned = (finding_of_turned(count_turned(*self.impacts(model)), name) for name, model in names.items())
        return (*pushed, *self.outside_of_range, *(finding for finding in turned if finding is not None))

    def variables(self) -> dict[str, Variable]:
        """The arrays of impacts, and of best angles; `ended_by` comes last."""
        known = {**self.outputs.own, **RESULTS}
        variables = {
            name: Variable(self.dims, known[name].attributes() | self._derivative_attributes(name))
            for name in self.outputs.names
        }
        if self.outputs.optimum:
            dims = tuple(dim for dim in self.dims if dim != "alpha")
            codes = {"alpha_max_kind": flags(KINDS, long_name="what makes the angle the best"),
                     "alpha_max_ended_by": flags(self.ends, long_name="how the cut ends at that angle")}  # fmt: skip
            numbers = {name: RESULTS[name].attributes() for name in ("alpha_max", "volume_max")}
            variables |= {name: Variable(dims, attributes) for name, attributes in (numbers | codes).items()}
        return variables | {"ended_by": Variable(self.dims, flags(self.ends, long_name="how the cut ended"))}

    def solve(self) -> dict[str, np.ndarray]:
        """Compute every impact: arrays of the variables' dimensions, words as codes."""
        by_model = [self._of_model(model) for model in self.loaded().values()]
        return {
            name: np.stack([values[name] for values in by_model]).reshape([self.lengths[dim] for dim in variable.dims])
            for name, variable in self.variables().items()
        }

    def _of_model(self, model: CuttingModel) -> dict[str, np.ndarray]:
        """The variables of one model."""
        outputs = self.outputs
        hits = impact(*self.impacts(model), derivatives=outputs.derivatives, wrt=outputs.wrt, rtol=outputs.rtol)
        own = {name: hits.quantities[name] for name in outputs.own}
        own |= {"turn": turn_of(*self.impacts(model))} if outputs.turn else {}
        values = {name: own[name] if name in own else getattr(hits, name) for name in outputs.names}
        values["ended_by"] = _codes(hits.ended_by, self.ends)
        if outputs.optimum:
            best = alpha_max(*self.impacts(model, but="alpha"), max_turn=outputs.max_turn)
            values |= {"alpha_max": best.alpha, "volume_max": best.volume, "alpha_max_kind": _codes(best.kind, KINDS),
                       "alpha_max_ended_by": _codes(best.ended_by, self.ends)}  # fmt: skip
        return {name: np.asarray(array) for name, array in values.items()}

    @functools.cached_property
    def identity(self) -> dict[str, str]:
        """In words, what the numbers of this sweep depend on, as it was before anything was computed."""
        return identity(
            # Among several models the name is a label of the result; a single one may be renamed, or its file moved.
            {label if self.compared else "sweep": model for label, model in self.loaded().items()},
            self.p,
            axes=numbers_in_words({"their order": self.dims, **self.axes}),
            derivatives=f"{self.outputs.derivatives} by {self.outputs.wrt}",
            turn=repr(self.outputs.turn),
            optimum=f"{self.outputs.optimum}, to a turn of {self.outputs.max_turn}",
            tolerance=repr(self.outputs.rtol),
        )

    def frame(self) -> xr.Dataset:
        """Coordinates with units, and provenance."""
        coordinates: dict[str, Any] = {}
        if self.compared:
            coordinates["model"] = ("model", self.labels["model"], {"long_name": "model"})
        for name, values in self.axes.items():
            coordinates[name] = (self.dim_of(name), values, self.quantities[name].attributes())
        own = {label: own_in_words(model, but=self.axes) for label, model in self.loaded().items()}
        own = {label: f"{label}: {words}" if self.compared else words for label, words in own.items() if words}
        said = {
            "model": "" if self.compared else next(iter(self.models)),
            "own_parameters": "; ".join(own.values()),
            "derivatives_with_respect_to": self.outputs.wrt if self.outputs.derivatives else "",
            "findings": to_attribute(self.findings),
        }
        attributes = provenance("a sweep", self.p, **{name: words for name, words in said.items() if words})
        return xr.Dataset(coords=coordinates, attrs=attributes)

    def _derivative_attributes(self, name: str) -> dict[str, str]:
        """Names and unit of a derivative that is not by α; empty for other results."""
        if self.outputs.wrt == "alpha" or name not in ("dvolume", "d2volume"):
            return {}
        by, order = self.quantities[self.outputs.wrt], 1 if name == "dvolume" else 2
        power = "" if order == 1 else "²"
        return {
            "long_name": f"derivative of the volume by {by.symbol} ({by.meaning})" + (", twice" if order == 2 else ""),
            "symbol": f"d{power}V/d{by.symbol}{power}",
            "units": ascii_unit(derivative_unit("volume", (by.dimension,) * order, "si")),
        }


def make_grid(
    model: Model | Sequence[Model],
    p: Parameters,
    axes: Mapping[str, Any],
    outputs: SweepOutputs | None = None,
    *,
    paired: Sequence[str] = (),
    own: Mapping[str, float] | None = None,
) -> Grid:
    """A grid, with everything checked that can be known before; arguments and errors as of `sweep`.

    Bare numbers of `axes` are refused where `p.replace` refuses them, unless it is an `InSI`.
    """
    require_parameters(p)
    compared = isinstance(model, Sequence) and not isinstance(model, str)
    models = _labelled_models(model if compared else [model])
    beside = any(_loaded(source).removes_at_contact for source in models.values())
    own_of = [own_quantities(type(_loaded(source))) for source in models.values()]
    common = {name: own for name, own in own_of[0].items() if all(name in of_model for of_model in own_of)}
    outputs = dataclasses.replace(outputs or SweepOutputs(), at_contact=beside, own=common)
    for source in models.values():
        require_one_impact(_loaded(source), p, "; give it as an axis")
    parameters = _common(models, (*axes, outputs.wrt))
    known = quantities(_loaded(next(iter(models.values()))))
    known = {name: known[name] for name in parameters}
    shown_in = "si" if isinstance(axes, InSI) else p.shown_in
    arrays = {name: _axis(name, values, known, shown_in) for name, values in axes.items()}
    refuse(
        "Argument",
        (not arrays and not compared,
         "s must include an axis, such as alpha=[0.2, 0.3], or several models; there is none."),
        (not isinstance(outputs.wrt, str) or outputs.wrt not in parameters,
         f" `wrt` must name a parameter ({', '.join(parameters)}), but is {briefly(outputs.wrt)}."),
    )  # fmt: skip
    if isinstance(paired, str) or not isinstance(paired, Sequence):
        raise TypeError(f"Argument `paired` must be a list of axes, but is {briefly(paired)}.")
    lengths = {len(arrays[name]) for name in paired if name in arrays}
    refuse(
        "Argument `paired` must name ",
        (len(set(paired)) != len(paired) or any(name not in arrays for name in paired) or len(paired) == 1,
         f"two or more of the axes, but is {list(paired)}."),
        (len(lengths) > 1, f"axes of one length, but they have {sorted(lengths)}."),
    )  # fmt: skip
    events = [name for source in models.values() for name in end_names(_loaded(source))]
    events += [TURNED] * outputs.optimum
    grid = Grid(
        models=models,
        compared=compared,
        p=p,
        axes=arrays,
        paired=tuple(paired),
        ends=tuple(dict.fromkeys((*_ENDS, *events))),
        outputs=outputs,
        own=own or {},
    )
    for name in arrays:
        if name in {*grid.variables(), "model", PAIR}:
            raise ValueError(f"An axis must not be called `{name}`, as something else in a sweep is.")
        for loaded in grid.loaded().values():
            validate(with_values(loaded, p, {name: arrays[name]})[1])
    return grid


def _common(models: "Mapping[str, CuttingModel | Named]", wanted: Sequence[str]) -> list[str]:
    """The parameters that all models have, of the case and their own; the wanted ones must be among them."""
    names = {label: list(quantities(_loaded(model))) for label, model in models.items()}
    for name in wanted:
        lacking = [label for label, of_model in names.items() if name not in of_model]
        if 0 < len(lacking) < len(names):
            raise ValueError(f"Argument `{name}` must be a parameter of every model, but {lacking[0]} has none such.")
    first = next(iter(names.values()))
    return [name for name in first if all(name in of_model for of_model in names.values())]


def _labelled_models(models: Any) -> "dict[str, CuttingModel | Named]":
    sources = [_source(model) for model in models]
    labels = [model_name(model) if isinstance(model, CuttingModel) else str(model) for model in models]
    refuse(
        "Argument `model` must ",
        (not models, "be a model or several, but is an empty list."),
        (len(set(labels)) != len(labels), f"hold models of different names, but has {', '.join(labels)}."),
    )
    return dict(zip(labels, sources, strict=True))


def _loaded(model: "CuttingModel | Named") -> CuttingModel:
    """The model; the same object each time, because JAX compiles again for each new class.

    Raises:
        RuntimeError: where this process finds another model by that name than the sweep was begun with.
    """
    if isinstance(model, CuttingModel):
        return model
    if model not in _known:
        loaded = load_model(model.name)
        if model.digest is not None and model.digest != model_digest(loaded):
            raise RuntimeError(f"{model.name}: is another model than that which the sweep was begun with.")
        _known[model] = loaded
    return _known[model]


_known: "dict[Named, CuttingModel]" = {}


def _source(model: Model) -> "CuttingModel | Named":
    """A model that is given by name or path as every process finds it."""
    loaded = load_model(model)
    if isinstance(model, CuttingModel):
        return loaded
    # Another process, with another working directory, must find a model's file.
    is_file = str(model).endswith(".py")
    its_digest = None if str(model) in BUILT_IN else model_digest(loaded)
    named = Named(Path(model).absolute() if is_file else str(model), its_digest)
    _known.setdefault(named, loaded)
    return named


def _axis(name: str, values: Any, parameters: Mapping[str, Quantity], shown_in: System) -> np.ndarray:
    """The values of an axis in SI, also those of texts with units, and of an array whose labels say the unit."""
    if name not in parameters:
        raise TypeError(f"Argument `{name}` is not a parameter; they are {', '.join(parameters)}.")
    for number in values if isinstance(values, list | tuple) else [values]:
        require_concrete({name: number})
    quantity, unit = parameters[name], unit_of_labels(values)
    with about(f"Argument `{name}`"):
        is_other = unit not in ("", quantity.unit("si"))
        size = factor(unit, quantity.dimension) if is_other and not quantity.fixed else 1.0
    values = values if unit else si_numbers(name, values, quantity, shown_in)
    array = real_numbers(name, values, unit=quantity.fixed or unit) * size
    is_list = array.ndim == 1 and array.size > 0
    refuse(
        f"Argument `{name}` must be ",
        (not is_list, f"a one-dimensional list of numbers, but is {briefly(values)}."),
        # Parameters of the case are checked by `validate`.
        (is_list and name not in QUANTITIES and not np.isfinite(array).all(), f"finite, but is {briefly(values)}."),
    )
    return np.ascontiguousarray(array, np.float64)


def _codes(names: Any, meanings: Sequence[str]) -> np.ndarray:
    """Words as codes: indices into `meanings`."""
    codes = np.zeros(np.shape(names), np.int8)
    for code, name in enumerate(meanings):
        codes[np.asarray(names) == name] = code
    return codes


def in_words(codes: xr.DataArray) -> Any:
    """The words for the codes of a sweep's variable, strings of its shape."""
    return np.array(codes.attrs["flag_meanings"].split())[codes.values.astype(int)]
