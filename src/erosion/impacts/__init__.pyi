"""What other folders use of this one, and where each name is defined."""

from erosion.impacts.batch import end_names as end_names
from erosion.impacts.batch import impact as impact
from erosion.impacts.batch import Impact as Impact
from erosion.impacts.batch import OTHER_ENDS as OTHER_ENDS
from erosion.impacts.batch import pair_derivatives as pair_derivatives
from erosion.impacts.maxima import Jump as Jump
from erosion.impacts.optimum import alpha_max as alpha_max
from erosion.impacts.optimum import ASIDE as ASIDE
from erosion.impacts.optimum import MEASURES as MEASURES
from erosion.impacts.optimum import Optimum as Optimum
from erosion.impacts.trajectory import path as path
from erosion.impacts.trajectory import simulate as simulate
from erosion.impacts.trajectory import SimulationError as SimulationError
from erosion.impacts.trajectory import Trajectory as Trajectory
from erosion.impacts.trajectory import TurnWarning as TurnWarning
from erosion.impacts.dataset_files import code_version as code_version
from erosion.impacts.dataset_files import IDENTITY as IDENTITY
from erosion.impacts.dataset_files import identity as identity
from erosion.impacts.dataset_files import model_in_words as model_in_words
from erosion.impacts.dataset_files import numbers_in_words as numbers_in_words
from erosion.impacts.dataset_files import provenance as provenance
from erosion.impacts.dataset_files import read_netcdf as read_netcdf
from erosion.impacts.dataset_files import require_code as require_code
from erosion.impacts.dataset_files import require_same as require_same
from erosion.impacts.dataset_files import StoreError as StoreError
from erosion.impacts.dataset_files import write_netcdf as write_netcdf
