"""`verify`: every model through every check, two at a time."""

import warnings
from collections.abc import Sequence
from pathlib import Path

from erosion.arguments import Progress, no_progress
from erosion.interrupts import unawaited_threads
from erosion.models import available_models, load_model, model_name
from erosion.models.base import CuttingModel
from erosion.ode.precision import require_xla
from erosion.trajectory.trajectory import TurnWarning
from erosion.verification.checks import Subject
from erosion.verification.reference_solutions import EQUATIONS_OF, has_heyoka
from erosion.verification.result import Check, Verification

_THREADS = 2  # more would wait for Python's lock, which compiling seldom releases


def verify(
    models: Sequence[CuttingModel | str | Path] | CuttingModel | str | Path | None = None,
    *,
    progress: Progress = no_progress,
) -> Verification:
    """Check models on this machine against closed forms, identities, and independent solutions.

    Registered models are also compared with their equations typed a second time, solved by scipy
    and, where it is installed, by heyoka; other models with their own equations, solved by scipy.

    Args:
        models: a model or several, names or paths; every registered model without it.
        progress: called with the name of a model that is done, how many models are done, and how many there are.

    Returns:
        For each model and check the worst relative error and its bound; `passed` if all are within.

    Raises:
        ModelError: for a name that is unknown or a file that cannot be used.
    """
    require_xla()
    checks: list[Check] = []
    if models is None:
        available = available_models()
        models = [name for name, info in available.items() if info.error is None]
        checks += [Check(name, "engines", float("inf"), info.error) for name, info in available.items() if info.error]
    elif isinstance(models, (CuttingModel, str, Path)):
        models = [models]
    subjects = [_subject(model) for model in models]
    done = 0

    def examined(subject: Subject) -> list[Check]:
        nonlocal done
        checks = _examine(subject)
        done += 1
        progress(subject.name, done, len(subjects))
        return checks

    # Filters are the process's, not the thread's.
    with warnings.catch_warnings(), unawaited_threads(_THREADS) as pool:
        warnings.simplefilter("ignore", TurnWarning)  # only numbers count here
        for of_model in pool.map(examined, subjects):
            checks += of_model
    return Verification(tuple(checks), () if has_heyoka() else ("heyoka",))


def _subject(model: CuttingModel | str | Path) -> Subject:
    loaded = load_model(model)
    name = model_name(loaded) if isinstance(model, CuttingModel) else str(model)
    return Subject(name, loaded, registered=name in EQUATIONS_OF)


def _examine(subject: Subject) -> list[Check]:
    checks: list[Check] = []
    name = "closed form"
    try:
        for name, errors in subject.checks().items():
            checks.append(Check(subject.name, name, *subject.worst(errors())))
    # A plug-in's own code may raise anything. A model that fails in one check would fail in the others too.
    except Exception as error:  # noqa: BLE001
        checks.append(Check(subject.name, name, float("inf"), " ".join(str(error).split()) or type(error).__name__))
    return checks
