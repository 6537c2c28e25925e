"""Results of a sweep and of a comparison: tables and documents of `erosion sweep` and `erosion compare`."""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.correlations import CORRELATIONS
from erosion.impacts import BEYOND
from erosion.parameters import (
    BEYOND_TESTS,
    PER_MASS_SCALES,
    RESULTS,
    Parameters,
    PerMass,
    declare_result,
    models_far_from_tests,
)
from erosion.results import Columns, Declared, Finding, Mark, Result, System, Value, from_attribute
from erosion.sweeps.grid import in_words

LOST = ("failed", "unfinished")
"""Ends of impacts that have no result."""


@dataclasses.dataclass(frozen=True, repr=False)
class SweepSummary(Result):
    """Counts of a sweep's impacts by outcome, and their least and greatest volume.

    Args:
        dataset: of the sweep.
        p: its case.
        weights: by model, how a volume becomes erosion per mass of particles; of a single model by the key "".
        store: where it is kept.
    """

    dataset: xr.Dataset
    p: Parameters
    weights: Mapping[str, PerMass]
    store: Path

    @property
    def title(self) -> str:
        """The file."""
        return f"{self.store}: a sweep"

    @functools.cached_property
    def ends(self) -> Mapping[str, int]:
        """Counts of impacts by outcome, block by block for a sweep that is larger than memory."""
        codes = self.dataset.ended_by
        meanings = codes.attrs["flag_meanings"].split()
        counts = np.zeros(len(meanings), int)
        for block in codes.data.blocks if codes.chunks else [codes.data]:
            counts += np.bincount(np.asarray(block).ravel(), minlength=len(meanings))
        return {name: int(n) for name, n in zip(meanings, counts, strict=True) if n}

    @property
    def lost(self) -> int:
        """How many impacts have no result."""
        return sum(self.ends.get(event, 0) for event in LOST)

    @functools.cached_property
    def _erosion(self) -> tuple[dict[str, list[float]], dict[str, Any], Parameters]:
        """The least and greatest erosion per mass by name [SI], and by model the greatest volumes at each speed.

        The volumes are of a particle of mass 1; the case is theirs.
        """
        data, one = self.dataset, dataclasses.replace(self.p, m=1.0)
        per_mass = data.volume / (data["m"] if "m" in data else float(self.p.m))
        speeds, volumes, ends = data.get("v0"), dict[str, Any](), dict[str, list[float]]()
        for model, weight in self.weights.items():
            of_model = per_mass.sel(model=model) if model else per_mass
            others = [dim for dim in of_model.dims if speeds is None or dim not in speeds.dims]
            volumes[model] = of_model.max(others).values
            for end in (float(of_model.min()), float(of_model.max())):
                for name, value in weight.to_dict(end, one).items():
                    ends.setdefault(name, []).append(float(value))
        # Where only some models have a density, their ratios are not those of all.
        common = {name: values for name, values in ends.items() if len(values) == 2 * len(self.weights)}
        return common, volumes, one if speeds is None else dataclasses.replace(one, v0=speeds.values)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Those of the sweep, impacts without a result, and erosion far from tests."""
        _, volumes, at = self._erosion
        impacts = int(self.dataset.ended_by.size)
        lost = Finding("not_computed", numbers={"lost": self.lost, "impacts": impacts})
        stored = from_attribute(self.dataset.attrs.get("findings", ""))
        far = models_far_from_tests(self.weights, volumes, at)
        return (*stored, *far, *([lost] if 0 < self.lost < impacts else []))

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.p.shown_in

    def declare(self) -> list[Declared]:
        """Counts, and the least and the greatest volume and erosion."""
        sizes = {str(dim): length for dim, length in self.dataset.sizes.items()}
        volume = self.dataset.volume
        erosion, volumes, at = self._erosion
        is_beyond = any(weight.is_beyond_tests(volumes[name], at) for name, weight in self.weights.items())
        ends = (("least", volume.min()), ("greatest", volume.max()))
        return [
            Value("output", str(self.store), only="data"),
            Value("dimensions", [*sizes.values()], labels=[*sizes], only="data"),
            Value("impacts", int(volume.size), meaning=" × ".join(f"{n} {dim}" for dim, n in sizes.items())),
            Value("ended_by", [*self.ends.values()], meaning="impacts", labels=[*self.ends]),
            *(declare_result("volume", float(value), meaning=f"{end} removed volume").but(name=f"volume_{end}")
              for end, value in ends),
            *(RESULTS[name].in_si(
                f"{name}_{end}", of(values), scale=PER_MASS_SCALES[name],
                meaning=f"{end} {RESULTS[name].meaning}", marks=[Mark(is_beyond and end == "greatest", BEYOND_TESTS)],
            ) for name, values in erosion.items() for end, of in (("least", min), ("greatest", max))),
        ]  # fmt: skip


@dataclasses.dataclass(frozen=True, repr=False)
class Comparison(Result):
    """Several models at the case's angle, and at their best angles.

    Args:
        curves: what `erosion.compare` returns; the case's angle is among its angles.
        p: the case.
        weights: by model, how a volume becomes erosion per mass of particles.
    """

    lines = ("models",)

    curves: xr.Dataset
    p: Parameters
    weights: Mapping[str, PerMass]

    @functools.cached_property
    def at(self) -> xr.Dataset:
        """The numbers at the case's angle, over the models."""
        return self.curves.sel(alpha=float(self.p.alpha))

    @property
    def models(self) -> list[str]:
        """Their names."""
        return [str(name) for name in self.curves.model.values]

    @property
    def lost(self) -> list[str]:
        """The models without a result at the case's angle."""
        return [name for name, end in zip(self.models, self._words("ended_by"), strict=True) if end in LOST]

    def _words(self, name: str) -> list[str]:
        return [str(word) for word in in_words(self.at[name])]

    @property
    def title(self) -> str:
        """How many models, and the angle."""
        models = f"{len(self.models)} model{'s' * (len(self.models) > 1)}"
        return f"{models}: impacts at α = {math.degrees(float(self.p.alpha)):.6g}° and best angles"

    @property
    def conclusions(self) -> list[str]:
        """How far the best angles of the models and of the correlations lie apart."""
        # Where most is removed as α → 0, or nothing at all, there is no best angle.
        best = [alpha for alpha in self.at.alpha_max.values.tolist() if alpha > 0]
        if not best:
            return []
        of_all = [*best, *(correlation.alpha_max for correlation in CORRELATIONS.values())]
        words = f"{len(best)} models" if len(best) > 1 else "one model"
        if others := len(self.models) - len(best):
            words += f" (the other{'s' * (others > 1)} have none)"
        return [f"The best angle is {_between(best)} over {words}, and {_between(of_all)} with the correlations."]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Those of the curves, models without a result, and erosion far from tests."""
        greatest = dict(zip(self.models, self.at.volume_max.values.tolist(), strict=True))
        lost = (Finding("model_not_computed", name) for name in self.lost)
        stored = from_attribute(self.curves.attrs.get("findings", ""))
        return (*stored, *lost, *models_far_from_tests(self.weights, greatest, self.p))

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.p.shown_in

    def declare(self) -> list[Declared]:
        """A row for each model; a volume is marked where the body turns too far."""
        alpha = self.at.alpha_max.values
        turned = Mark(self.at.turned_beyond.values, BEYOND)
        has_best = [None if math.isnan(angle) else angle for angle in alpha.tolist()]
        columns = [
            Value("model", self.models),
            declare_result("volume", self.at.volume.values, marks=[turned]),
            *self._erosion("", self.at.volume.values, [turned]),
            Value("ended_by", self._words("ended_by"), "ends by"),
            Value("turned_beyond", self.at.turned_beyond.values, only="data"),
            declare_result("alpha_max", has_best, marks=[Mark(alpha == 0, "the limit as α → 0, not reached")]),
            declare_result("volume_max", self.at.volume_max.values),
            *self._erosion("_max", self.at.volume_max.values),
            Value("kind", self._words("alpha_max_kind")),
            Value("alpha_max_ended_by", self._words("alpha_max_ended_by"), "ends by"),
        ]
        return [
            Columns("models", "", columns),
            Value("statements", [*self.conclusions], dims=("statement",), only="data"),
        ]

    def _erosion(self, end: str, volumes: np.ndarray, marks: Sequence[Mark] = ()) -> list[Value]:
        """Erosion per mass of particles; a table has the one that every model has, mass per mass where it can."""
        pairs = [(self.weights[name], volume) for name, volume in zip(self.models, volumes.tolist(), strict=True)]
        numbers = [weight.to_dict(volume, self.p) for weight, volume in pairs]
        shown = "erosion_ratio" if all("erosion_ratio" in each for each in numbers) else "specific_volume"
        beyond = Mark([weight.is_beyond_tests(volume, self.p) for weight, volume in pairs], BEYOND_TESTS)
        values = []
        for name in ("specific_volume", "erosion_ratio"):
            if any(name in each for each in numbers):
                known = [float(each[name]) if name in each else None for each in numbers]
                more = {"scale": PER_MASS_SCALES[name], "symbol": f"E{end}", "marks": [*marks, beyond]}
                values.append(RESULTS[name].in_si(f"{name}{end}", known, only="" if name == shown else "data", **more))
        return values


def _between(angles: list[float]) -> str:
    low, high = (f"{math.degrees(angle):.3g}°" for angle in (min(angles), max(angles)))
    return low if low == high else f"{low} to {high}"
