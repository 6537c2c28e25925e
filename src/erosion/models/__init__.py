"""The models: their interface, the parts they are made of, their own parameters, and the registry."""

from erosion.models.base import (
    NO_CUT as NO_CUT,
    ClosedForm as ClosedForm,
    CuttingModel as CuttingModel,
    Events as Events,
    Scales as Scales,
    State as State,
    Tip as Tip,
    cuts_at_all as cuts_at_all,
    event_rates as event_rates,
    units_within as units_within,
)
from erosion.models.correlated import Correlated as Correlated, correlated as correlated, made_for as made_for
from erosion.models.equations import (
    CUT as CUT,
    Case as Case,
    equations_of as equations_of,
    model_digest as model_digest,
    whole_cut as whole_cut,
)
from erosion.models.own_parameters import (
    own_in_words as own_in_words,
    own_parameters as own_parameters,
    own_quantities as own_quantities,
    quantities as quantities,
    ranges as ranges,
    require_one_impact as require_one_impact,
    sizes as sizes,
    values as values,
    with_values as with_values,
)
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
    BUILT_IN as BUILT_IN,
    ModelError as ModelError,
    ModelInfo as ModelInfo,
    available_models as available_models,
    called as called,
    impact_to_dict as impact_to_dict,
    load_model as load_model,
    model_name as model_name,
    model_source as model_source,
    require_loadable as require_loadable,
    usable_models as usable_models,
)
from erosion.models.rigid import (
    AsPrinted as AsPrinted,
    Finnie as Finnie,
    Linearized as Linearized,
    RigidErodent as RigidErodent,
    Rotating as Rotating,
)
