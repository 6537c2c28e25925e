"""Fit a model to measurements, rank models by what fits, and say what the data leave open."""

from erosion.fits.calibration import Calibration as Calibration, calibrate as calibrate
from erosion.fits.errors import ErrorModel as ErrorModel
from erosion.fits.export import to_case as to_case, to_fluent as to_fluent, to_openfoam as to_openfoam
from erosion.fits.fit import Fit as Fit
from erosion.fits.least_squares import CalibrationError as CalibrationError
from erosion.fits.measurements import (
    MeasurementError as MeasurementError,
    Measurements as Measurements,
    read_measurements as read_measurements,
)
from erosion.fits.next_test import NextTest as NextTest, next_test as next_test
from erosion.fits.posterior import (
    ConvergenceWarning as ConvergenceWarning,
    Posterior as Posterior,
    posterior as posterior,
)
from erosion.fits.predicted import Predictions as Predictions, predict as predict
from erosion.fits.problem import FitProblem as FitProblem
from erosion.fits.profiles import Profile as Profile
from erosion.fits.ranking import (
    PosteriorRanking as PosteriorRanking,
    Ranking as Ranking,
    fit_each as fit_each,
    rank as rank,
)
from erosion.fits.residual_checks import ResidualChecks as ResidualChecks, check as check
from erosion.fits.tempering import SamplingError as SamplingError
