"""Fit a model to measurements, rank models by what fits, and say what the data leave open."""

from erosion.fits.calibration import Calibration as Calibration
from erosion.fits.calibration import calibrate as calibrate
from erosion.fits.doubts import Profile as Profile
from erosion.fits.experiments import NextExperiment as NextExperiment
from erosion.fits.experiments import next_experiment as next_experiment
from erosion.fits.export import to_case as to_case
from erosion.fits.export import to_fluent as to_fluent
from erosion.fits.export import to_openfoam as to_openfoam
from erosion.fits.least_squares import CalibrationError as CalibrationError
from erosion.fits.measurements import MeasurementError as MeasurementError
from erosion.fits.measurements import Measurements as Measurements
from erosion.fits.measurements import read_measurements as read_measurements
from erosion.fits.posterior import ConvergenceWarning as ConvergenceWarning
from erosion.fits.posterior import Posterior as Posterior
from erosion.fits.posterior import posterior as posterior
from erosion.fits.ranking import PosteriorRanking as PosteriorRanking
from erosion.fits.ranking import Ranking as Ranking
from erosion.fits.ranking import rank_models as rank_models
from erosion.fits.ranking import rank_posteriors as rank_posteriors
from erosion.fits.tempering import SamplingError as SamplingError
