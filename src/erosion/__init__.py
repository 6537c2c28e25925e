"""How a rigid particle cuts a ductile surface, and at which angle it removes most.

The public names load on first use, so that `erosion --help` need not wait for JAX.
Importing the package turns JAX's 64-bit mode on (before JAX is loaded, if it is not yet).
"""

import gc
import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

from erosion.version import __version__ as __version__

if TYPE_CHECKING:
    from erosion import correlations as correlations
    from erosion import distributions as distributions
    from erosion import models as models
    from erosion.calibration import Calibration as Calibration
    from erosion.calibration import CalibrationError as CalibrationError
    from erosion.calibration import MeasurementError as MeasurementError
    from erosion.calibration import Measurements as Measurements
    from erosion.calibration import Ranking as Ranking
    from erosion.calibration import calibrate as calibrate
    from erosion.calibration import rank_models as rank_models
    from erosion.calibration import read_measurements as read_measurements
    from erosion.calibration import to_fluent as to_fluent
    from erosion.calibration import to_openfoam as to_openfoam
    from erosion.correlations import CORRELATIONS as CORRELATIONS
    from erosion.correlations import Correlation as Correlation
    from erosion.engine.impact import Impact as Impact
    from erosion.engine.impact import impact as impact
    from erosion.engine.volume import volume as volume
    from erosion.models import ModelError as ModelError
    from erosion.models import available_models as available_models
    from erosion.models import load_model as load_model
    from erosion.models.base import ClosedForm as ClosedForm
    from erosion.models.base import CuttingModel as CuttingModel
    from erosion.models.base import Scales as Scales
    from erosion.models.base import State as State
    from erosion.models.base import Tip as Tip
    from erosion.models.own_parameters import own_parameter as own_parameter
    from erosion.models.trigonometry import sincos as sincos
    from erosion.optimum.alpha_max import Optimum as Optimum
    from erosion.optimum.alpha_max import alpha_max as alpha_max
    from erosion.optimum.alpha_max import alpha_min as alpha_min
    from erosion.parameters.case_files import CaseError as CaseError
    from erosion.parameters.case_files import dump_case as dump_case
    from erosion.parameters.case_files import load_case as load_case
    from erosion.parameters.parameters import MATERIALS as MATERIALS
    from erosion.parameters.parameters import TABLE_1 as TABLE_1
    from erosion.parameters.parameters import Parameters as Parameters
    from erosion.parameters.parameters import validate as validate
    from erosion.storage.identity import StoreError as StoreError
    from erosion.streams.result import Stream as Stream
    from erosion.streams.stream import StreamInterrupted as StreamInterrupted
    from erosion.streams.stream import stream as stream
    from erosion.sweeps.studies import compare as compare
    from erosion.sweeps.studies import regimes as regimes
    from erosion.sweeps.sweep import SweepInterrupted as SweepInterrupted
    from erosion.sweeps.sweep import sweep as sweep
    from erosion.trajectory.simulate import simulate as simulate
    from erosion.trajectory.trajectory import SimulationError as SimulationError
    from erosion.trajectory.trajectory import Trajectory as Trajectory
    from erosion.trajectory.trajectory import TurnWarning as TurnWarning
    from erosion.verification import Verification as Verification
    from erosion.verification import verify as verify

_HOMES = {
    "calibration": (
        "Calibration",
        "CalibrationError",
        "MeasurementError",
        "Measurements",
        "Ranking",
        "calibrate",
        "rank_models",
        "read_measurements",
        "to_fluent",
        "to_openfoam",
    ),
    "parameters.case_files": ("CaseError", "dump_case", "load_case"),
    "correlations": ("CORRELATIONS", "Correlation"),
    "engine.impact": ("Impact", "impact"),
    "engine.volume": ("volume",),
    "models.base": ("ClosedForm", "CuttingModel", "Scales", "State", "Tip"),
    "models": ("ModelError", "available_models", "load_model"),
    "optimum.alpha_max": ("Optimum", "alpha_max", "alpha_min"),
    "models.own_parameters": ("own_parameter",),
    "parameters.parameters": ("MATERIALS", "TABLE_1", "Parameters", "validate"),
    "storage.identity": ("StoreError",),
    "streams.result": ("Stream",),
    "streams.stream": ("StreamInterrupted", "stream"),
    "sweeps.studies": ("compare", "regimes"),
    "sweeps.sweep": ("SweepInterrupted", "sweep"),
    "trajectory.simulate": ("simulate",),
    "trajectory.trajectory": ("SimulationError", "Trajectory", "TurnWarning"),
    "models.trigonometry": ("sincos",),
    "verification": ("Verification", "verify"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

_MODULES = ("correlations", "distributions", "models")

__all__ = ["__version__", *_MODULES, *_HOME_OF]  # pyright: ignore[reportUnsupportedDunderAll]


def _turn_float64_on() -> None:
    # An explicit JAX_ENABLE_X64=0 is left alone: the first computation says what to do.
    if "JAX_ENABLE_X64" in os.environ:
        return
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        os.environ["JAX_ENABLE_X64"] = "1"


_turn_float64_on()


def _imported(module: str) -> Any:
    # An import makes very many objects, none of them garbage: to look for it takes a third of the time.
    was_on = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(f"erosion.{module}")
    finally:
        if was_on:
            gc.enable()


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return _imported(name)
    if name in _HOME_OF:
        value = getattr(_imported(_HOME_OF[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'erosion' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
