"""The models: their classes, the parts they are made of, and the registry."""

from erosion.models.correlated import Correlated as Correlated, correlated as correlated, made_for as made_for
from erosion.models.parts import (
    CentreOfMassTip as CentreOfMassTip,
    CircularTip as CircularTip,
    ConstantRatio as ConstantRatio,
    Deformation as Deformation,
    DeformationWear as DeformationWear,
    ForceLaw as ForceLaw,
    ForceRatio as ForceRatio,
    FullTorque as FullTorque,
    HorizontalTorque as HorizontalTorque,
    NoDeformation as NoDeformation,
    NoTorque as NoTorque,
    ProportionalDeformationWear as ProportionalDeformationWear,
    SmallAngleTip as SmallAngleTip,
    TanAlpha as TanAlpha,
    TipKinematics as TipKinematics,
    Torque as Torque,
    VelocityAligned as VelocityAligned,
)
from erosion.models.registry import (
    ModelError as ModelError,
    ModelInfo as ModelInfo,
    available_models as available_models,
    called as called,
    load_model as load_model,
    model_name as model_name,
    model_source as model_source,
    usable_models as usable_models,
)
from erosion.models.rigid import (
    AsPrinted as AsPrinted,
    Finnie as Finnie,
    Linearized as Linearized,
    RigidErodent as RigidErodent,
    Rotating as Rotating,
)
