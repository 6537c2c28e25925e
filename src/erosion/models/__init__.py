"""The models: their classes, the parts they are made of, and the registry."""

from erosion.models.as_printed import AsPrinted as AsPrinted
from erosion.models.finnie import Finnie as Finnie
from erosion.models.forces import ConstantRatio as ConstantRatio
from erosion.models.forces import ForceLaw as ForceLaw
from erosion.models.forces import ForceRatio as ForceRatio
from erosion.models.forces import TanAlpha as TanAlpha
from erosion.models.forces import VelocityAligned as VelocityAligned
from erosion.models.linearized import Linearized as Linearized
from erosion.models.registry import ModelError as ModelError
from erosion.models.registry import ModelInfo as ModelInfo
from erosion.models.registry import available_models as available_models
from erosion.models.registry import load_model as load_model
from erosion.models.registry import model_name as model_name
from erosion.models.registry import usable_models as usable_models
from erosion.models.rigid import RigidErodent as RigidErodent
from erosion.models.rotating import Rotating as Rotating
from erosion.models.tips import CentreOfMassTip as CentreOfMassTip
from erosion.models.tips import CircularTip as CircularTip
from erosion.models.tips import SmallAngleTip as SmallAngleTip
from erosion.models.tips import TipKinematics as TipKinematics
from erosion.models.torques import FullTorque as FullTorque
from erosion.models.torques import HorizontalTorque as HorizontalTorque
from erosion.models.torques import NoTorque as NoTorque
from erosion.models.torques import Torque as Torque
