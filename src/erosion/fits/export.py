"""A fit, or a model and its case, in the forms of CFD codes; a fit also as a case file."""

import dataclasses
import functools
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from erosion.arguments import refuse
from erosion.cfd.export_files import AngleTable, ParticleErosion, angle_table, coefficients
from erosion.cfd.exports import ExportedParticle, Reach, commented, particle_of, share_in_words
from erosion.fits.calibration import Calibration
from erosion.fits.fit_files import with_unit
from erosion.models import CuttingModel, model_name, model_source, own_parameters
from erosion.models.correlated import per_mass_of
from erosion.models.equations import plug_in_digest
from erosion.output import seen_from, sentences
from erosion.parameters import (
    Parameters,
    PerMass,
    dump_case,
    dump_model,
    dump_per_mass,
    exact_text,
    toml_string,
    with_paths,
)
from erosion.results import Finding
from erosion.version import __version__

_POINTS = 20
_Exported = Calibration | CuttingModel | str | Path


def to_openfoam(
    model: _Exported,
    p: Parameters | None = None,
    *,
    v0: Any = None,
    d: Any = None,
    particle_density: float | None = None,
    cutting_fraction: float = 1.0,
    patches: Sequence[str] = (),
) -> ParticleErosion:
    """The coefficients p and K with which Finnie's curve comes nearest to the model's.

    ψ is kept as the case has it; only p ψ counts. Curves of `finnie` with β = ½ and no spin, and of `linearized`
    (with K = 3k), are of Finnie's shape exactly.

        print(erosion.to_openfoam("finnie", p).text())

    Args:
        model: a model, its name, or the path of its file; or a calibration, which has a case of its own.
        p: the case, all scalars; its `alpha` is not used.
        v0: speeds over which the coefficients must hold, shape (n,) [m/s]; without it what is lost at half and
            at twice the case's is said.
        d: diameters over which they must hold, shape (n,) [m], or texts with units.
        particle_density: of the particles in the code [kg/m³]; without it the case's particle has the diameter 2 r.
        cutting_fraction: the share of the particles that cut, see `PerMass`; a calibration has its own.
        patches: that erode, for the entry.

    Raises:
        ExportError: where the curve is not of Finnie's shape (the best coefficients are off by more than 15 % of its
            maximum, or K is without limit), or as far off at one of the speeds and diameters that are given.
        ValueError: for parameters that are arrays or out of range, or speeds and diameters that are not positive.
    """
    particle, comment, case = _particle(model, p, particle_density, cutting_fraction)
    return dataclasses.replace(coefficients(particle, Reach.of(particle, case, v0, d), comment), patches=tuple(patches))


def to_fluent(
    model: _Exported,
    p: Parameters | None = None,
    *,
    points: int = _POINTS,
    v0: Any = None,
    d: Any = None,
    particle_density: float | None = None,
    cutting_fraction: float = 1.0,
    density: float | None = None,
) -> AngleTable:
    """The model's curve as Fluent's angle function, with the velocity exponent and the diameter function that fit best.

        print(erosion.to_fluent("rotating", p).text())

    Args:
        model: a model, its name, or the path of its file; or a calibration, which has a case of its own.
        p: the case, all scalars; its `alpha` is not used.
        points: of the table; each is added where the table's error is greatest.
        v0: speeds over which the form must hold, shape (n,) [m/s], or texts with units. The exponent is fitted
            over them; without them from half to twice the case's, and what is lost there is said.
        d: diameters over which it must hold, shape (n,) [m], or texts with units.
        particle_density: of the particles in the code [kg/m³]; without it the case's particle has the diameter 2 r.
        cutting_fraction: the share of the particles that cut, see `PerMass`; a calibration has its own.
        density: of the target [kg/m³], for C as a number; a correlation has its own.

    Raises:
        ExportError: where the form is off by more than 15 % of the maximum at one of the speeds and diameters that
            are given.
        ValueError: for fewer than 2 points or more than Fluent takes; else as `to_openfoam`.
    """
    particle, comment, case = _particle(model, p, particle_density, cutting_fraction)
    target = per_mass_of(particle.model, PerMass(density)).density
    return angle_table(particle, Reach.of(particle, case, v0, d), comment, points, target)


def _particle(
    model: _Exported, p: Parameters | None, particle_density: float | None, cutting_fraction: float
) -> tuple[ExportedParticle, str, Parameters]:
    """The particle that is exported, the comment on where it comes from, and its case."""
    if isinstance(model, Calibration):
        refuse(
            "Argument ",
            (p is not None, "`p` must be left out for a calibration, which has a case of its own."),
            (cutting_fraction != 1, "`cutting_fraction` must be left out for a calibration, which has its own."),
        )
        case = exported_case(model)
        particle = particle_of(model.model, case, particle_density)
        particle = dataclasses.replace(particle, cutting_fraction=model.cutting_fraction)
        return particle, _comment(model), case
    if p is None:
        raise TypeError("Argument `p` must be Parameters, but is left out.")
    particle = particle_of(model, p, particle_density, cutting_fraction)
    return particle, particle.origin(), p


def to_case(
    calibration: Calibration,
    path: str = "fitted.toml",
    *,
    particle: str | None = None,
    target: str | None = None,
    findings: Sequence[Finding] | None = None,
    samples: str | Path | None = None,
) -> str:
    """The text of a case file, which `load_case` reads: the estimates in place, at a speed of the data.

    The model and its own parameters are the file's usual ones for all verbs. What is doubtful, what was tested and the
    file of samples are in the table [advise], which `erosion advise` reads.

    Args:
        calibration: the fit.
        path: the file's, for the command in its comment, and where the paths in it begin.
        particle: its name and size, where the case has it by name.
        target: its name, where the case has it by name.
        findings: for whoever uses the file; those of the fit without them.
        samples: the file that `Fit.save` writes, for advice by predictions of the fit.

    Raises:
        ValueError: for a model without a name or a file, which no verb could load again.
    """
    best_angle = f"The best angle of this fit: {command('optimum', path)}"
    comment = "\n".join([*_origin(calibration), *calibration.warnings, best_angle])
    text = "".join(mark if mark.isprintable() or mark == "\n" else " " for mark in comment)
    case = dump_case(exported_case(calibration), calibration.title)
    named = "".join(f"{name} = {toml_string(_in_file(value, path))}\n"
                    for name, value in (("particle", particle), ("target", target)) if value is not None)  # fmt: skip
    density = calibration.problem.density
    weighed = dump_per_mass(PerMass(density, calibration.cutting_fraction))
    said = calibration.findings if findings is None else findings
    advice = _for_advice(calibration, said, path, samples)
    return commented(text, "#") + case + named + weighed + _model(calibration, path) + advice


def _in_file(text: str, path: str) -> str:
    """A text with its path, if it has one, as the file at `path` gives it."""
    return with_paths(text, functools.partial(seen_from, Path(path)))


def _model(calibration: Calibration, path: str) -> str:
    """The lines of a case file that name the model and its own parameters."""
    source = model_source(calibration.model)
    if source is None:
        raise ValueError(
            f"Argument `calibration` must have a model that a file can name, but {model_name(calibration.model)} was "
            "made in a program: put it into a file (…/model.py), and fit that file's model."
        )
    own = {name: exact_text(float(parameter.value), parameter.quantity.dimension, calibration.p.shown_in)
           for name, parameter in own_parameters(calibration.model).items()}  # fmt: skip
    return dump_model(_in_file(source, path), own)


def _for_advice(calibration: Calibration, findings: Sequence[Finding], path: str, samples: str | Path | None) -> str:
    """The table [advise] of a case file."""
    of_scale = "The tests had units of their own, so the size of the wear is that of the case."
    rows = "" if calibration.data.path is None else seen_from(Path(path), str(calibration.data.path))
    typed = with_paths(calibration.typed, functools.partial(seen_from, Path(path)))
    said = [of_scale] * calibration.data.free_scale + [finding.text for finding in findings]
    kept = "" if samples is None else seen_from(Path(path), str(samples))
    equations = plug_in_digest(calibration.model)
    lines = sentences(
        (bool(said), f"warning = {toml_string(' '.join(said))}"),
        (rows, f"data = {toml_string(rows)}"),
        (bool(typed), f"reading = {_inline_table(typed)}"),
        (kept, f"uncertain = {toml_string(kept)}"),
        (True, f"tested = {calibration.problem.tested.dump()}"),
        (equations, f'equations = "{equations}"  # of {model_name(calibration.model)}, as it was'),
    )
    return "\n".join(["", "[advise]", *lines, ""])


def _inline_table(texts: Mapping[str, Any]) -> str:
    """Texts, and tables of texts, as TOML has them in one line."""
    entries = [f"{name} = {_inline_table(value) if isinstance(value, Mapping) else toml_string(value)}"
               for name, value in texts.items()]  # fmt: skip
    return f"{{ {', '.join(entries)} }}"


def command(*words: str) -> str:
    """A command of the program as it is typed into a shell."""
    return shlex.join(("erosion", *words))


def options_in_words(options: Mapping[str, Any]) -> list[str]:
    """The words of a command for options by name; None stands for one that is not given.

    The value of an option that is given for each parameter is a mapping: {"prior": {"psi": "uniform(0.01, 0.2)"}}.
    """
    words = []
    for name, value in options.items():
        texts = [f"{of}={text}" for of, text in value.items()] if isinstance(value, Mapping) else [value]
        words += [word for text in texts if text is not None for word in (f"--{name}", str(text))]
    return words


def exported_case(calibration: Calibration) -> Parameters:
    """The fitted case at the speed and the mass of most rows, see `Measurements.usual`."""
    return dataclasses.replace(calibration.p, **calibration.data.usual)


def _comment(calibration: Calibration) -> str:
    """Model, data, estimates, speed and warnings."""
    share = calibration.cutting_fraction
    return "\n".join([
        *_origin(calibration),
        *sentences((share != 1, share_in_words(share))),
        *calibration.warnings,
        *sentences((calibration.data.free_scale,
                    "The data was known up to a factor: the curve's height is the case's, not measured.")),
    ])  # fmt: skip


def _origin(calibration: Calibration) -> list[str]:
    """Model, data, estimates and speed."""
    p, data = exported_case(calibration), calibration.data
    return [
        f"erosion {__version__}: {model_name(calibration.model)}, fitted to {len(data)} rows of {data.source}",
        ", ".join(
            f"{name} = {with_unit(calibration.estimates[name], quantity, p.shown_in)}"
            for name, quantity in calibration.quantities.items()
        )
        + f", at v0 = {float(p.v0):.6g} m/s",
    ]
