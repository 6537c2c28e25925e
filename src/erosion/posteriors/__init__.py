"""What data say: the posterior of a model's parameters, its evidence, and the next experiment."""

from erosion.posteriors.evidence import PosteriorRanking as PosteriorRanking
from erosion.posteriors.evidence import rank_posteriors as rank_posteriors
from erosion.posteriors.experiments import NextExperiment as NextExperiment
from erosion.posteriors.experiments import next_experiment as next_experiment
from erosion.posteriors.posterior import posterior as posterior
from erosion.posteriors.result import ConvergenceWarning as ConvergenceWarning
from erosion.posteriors.result import Posterior as Posterior
from erosion.posteriors.tempering import SamplingError as SamplingError
