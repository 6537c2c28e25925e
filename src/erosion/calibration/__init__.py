"""Against measurement: fit a model's parameters to data, and rank models by what fits."""

from erosion.calibration.export import to_case as to_case
from erosion.calibration.export import to_fluent as to_fluent
from erosion.calibration.export import to_openfoam as to_openfoam
from erosion.calibration.fitting import calibrate as calibrate
from erosion.calibration.least_squares import CalibrationError as CalibrationError
from erosion.calibration.measurements import MeasurementError as MeasurementError
from erosion.calibration.measurements import Measurements as Measurements
from erosion.calibration.measurements import read_measurements as read_measurements
from erosion.calibration.profiles import Profile as Profile
from erosion.calibration.ranking import Ranking as Ranking
from erosion.calibration.ranking import rank_models as rank_models
from erosion.calibration.result import Calibration as Calibration
