"""Questions 1 to 8: the linearized model, whose solution is known exactly."""

import dataclasses

import numpy as np

from erosion.parameters import (
    PER_MASS_SCALES,
    Dimension,
    Parameters,
    readable_scale,
)
from erosion.plotting.curves import plot_end_times, plot_optimum
from erosion.plotting.motion import plot_half_angle, plot_histories, plot_path, plot_removal_rate, plot_sketch
from erosion.plotting.style import new_axes, new_figure
from erosion.report.case import (
    LINEARIZED,
    Answer,
    ReportCase,
    best_angle_over_k,
    family_numbers,
    followed,
    panel,
)

NEEDS_OF_BEST = (("optimum", LINEARIZED),)
NEEDS = tuple((kind, LINEARIZED) for kind in ("families", "optimum", "hits", "impact_and_optimum", "sensitivities"))

_STATE: tuple[tuple[str, str, Dimension], ...] = (
    ("x", "x", "length"),
    ("y", "y", "length"),
    ("vx", "ẋ", "speed"),
    ("vy", "ẏ", "speed"),
)


def turn_if_free(p: Parameters) -> float | None:
    """How far the body would turn [rad] if the force could turn it; None where that cut cannot be followed."""
    cut = followed(p)
    return None if cut is None else float(np.abs(cut.phi - np.pi / 2).max())


def solutions(case: ReportCase) -> Answer:
    """x(t) and y(t) as formulas and with numbers; Figures 7 and 8."""
    p, motion = case.p, case.trajectory
    along, down = float(p.v0 * np.cos(p.alpha)), float(p.v0 * np.sin(p.alpha))
    exact = case.closed.state(motion.t, p)
    differences = {
        name: float(np.abs(getattr(motion, name) - np.asarray(getattr(exact, name))).max()) for name, _, _ in _STATE
    }
    numbers = {
        "omega": case.omega,
        "stiffness": float(p.stiffness),
        "vx_0": along,
        "vy_0": down,
        "x_slope": along - down / float(p.k),
        "x_amplitude": down / (float(p.k) * case.omega),
        "y_amplitude": down / case.omega,
        "vx_amplitude": down / float(p.k),
        "x_end": float(motion.x[-1]),
        "y_end": float(motion.y[-1]),
        "vx_end": float(motion.vx[-1]),
        "vy_end": float(motion.vy[-1]),
        "largest_value": {name: float(np.abs(getattr(motion, name)).max()) for name, _, _ in _STATE},
        "largest_difference": differences,
        "turn_if_free": turn_if_free(p),
    }
    sketch = panel(plot_sketch, case.alpha, float(p.k), height=3.2)
    figures = {"sketch": sketch}
    if case.ended_by != "no-cut":
        histories, (tip_path, ax) = new_figure(5.6, 4.5), new_axes(5.6, 3.4)
        plot_histories(histories, motion, case.closed)
        plot_path(motion, ax=ax)
        figures |= {"figure-7-histories": histories, "figure-8-path": tip_path}
    return Answer(numbers, figures, {"checks": _STATE, "shown_length": _shown_length(case)})


def _shown_length(case: ReportCase) -> float | None:
    """The size that chooses a readable unit of lengths; None for the inch, in which the scenario has its figures."""
    return None if case.units == "inch-pound" else float(np.abs(case.trajectory.y).max())


def end_of_cut(case: ReportCase) -> Answer:
    """t_c as the smaller of two candidates; Figure 9."""
    times = {name: float(time) for name, time in case.closed.end_times(case.p).items()}
    end = case.closed.state(case.t_c, case.p)
    numbers = {
        "t_c": case.t_c,
        "ended_by": case.ended_by,
        "candidates": {name: time if np.isfinite(time) else None for name, time in times.items()},
        "cusp": case.cusp,
        "t_c_numerical": case.trajectory.t_c,
        "ended_by_numerical": case.trajectory.ended_by,
        "vx_end": float(end.vx),
        "coincide": max(abs(float(end.vx)), abs(float(end.y)) * case.omega) < _COINCIDE * float(case.p.v0),
        "y_end": float(end.y),
        "k_cot_alpha": float(case.p.k / np.tan(case.p.alpha)),
    }
    over_angles = case.over_angles()
    figure = panel(
        plot_end_times,
        case.angles,
        {name: np.asarray(times) for name, times in case.closed.end_times(over_angles).items()},
        np.asarray(case.closed.t_c(over_angles)),
        system=case.units,
        # The real part of the complex root of cos ωt = 1 - k cot α is π/ω wherever 1 - k cot α < -1.
        real_part=np.where(case.angles <= case.cusp, np.pi / case.omega, np.nan),
        marks={"cusp": (case.cusp, np.pi / case.omega), "case": (case.alpha, case.t_c)},
    )
    return Answer(numbers, {"figure-9-end-of-cut": figure})


_COINCIDE = 1e-7  # of v₀: at the cusp the stop is known to the root of the rounding
_PANELS = (10, 100, 1000)


def midpoint_rule(case: ReportCase, panels: int) -> float:
    """B ∫ y ẋ dt by the midpoint rule on the closed forms of question 1."""
    width = case.t_c / panels
    state = case.closed.state((np.arange(panels) + 0.5) * width, case.p)
    return float(case.p.b) * float(np.sum(np.asarray(state.y * state.vx))) * width


def removed_volume(case: ReportCase) -> Answer:
    """V by closed form, by the integrator, by the midpoint rule and from the speeds at both ends."""
    p, motion = case.p, case.trajectory
    volumes = {
        "volume": case.volume,
        "volume_numerical": motion.volume,
        "volume_from_speeds": float(p.m / (2 * p.sigma * p.psi)) * float(motion.vx[0] ** 2 - motion.vx[-1] ** 2),
    }
    midpoint = {str(panels): midpoint_rule(case, panels) for panels in _PANELS}
    errors = {name: abs(volume / case.volume - 1) if case.volume else 0.0
              for name, volume in (volumes | midpoint).items()}  # fmt: skip
    numbers = {
        **volumes,
        "volume_midpoint": midpoint,
        "relative_error": errors,
        "panels": list(_PANELS),
        "volume_scale": float(p.volume_scale),
    }
    figures = {}
    if case.ended_by != "no-cut":
        figure = panel(plot_removal_rate, motion, height=3.5, bars=_PANELS[0])
        figures = {"rate-of-removal": figure}
    fields = {
        "disagreement": max(errors["volume_numerical"], errors["volume_from_speeds"]),
        "si": readable_scale("volume", "si", case.volume),
    }
    return Answer(numbers, figures, fields)


def best_angle(case: ReportCase) -> Answer:
    """α_max by the search over all angles, checked against ½ arctan k."""
    found, exact = case.optimum(LINEARIZED), float(case.closed.alpha_max(case.p))
    best, greatest = float(found.alpha), float(found.volume)
    volume_exact = float(case.closed.volume(case.p.replace(alpha=exact)))
    far = case.per_mass.far_from_tests(greatest, case.p, of_any=True)
    numbers = {
        "alpha_max": best,
        "volume_max": greatest,
        "over_this_case": greatest / case.volume if case.volume else None,
        "force_angle": float(np.arctan(case.p.k)),
        "d2volume": float(found.d2volume),
        "alpha_max_closed_form": exact,
        "volume_max_closed_form": volume_exact,
        "alpha_difference": abs(best - exact),
        "volume_difference": abs(greatest / volume_exact - 1),
        "cusp": case.cusp,
        **case.weighed(case.volume),
        **{f"{name}_max": value for name, value in case.weighed(greatest).items()},
        "cutting_fraction": case.per_mass.cutting_fraction,
        "turns_if_free": {"here": turn_if_free(case.p), "best": turn_if_free(case.p.replace(alpha=best))},
        "far_from_tests": far and {**dataclasses.asdict(far), "over_greatest": far.amount / far.greatest},
    }
    figure, ax = new_axes(5.4, 4.0)
    plot_optimum(found, ax=ax, marks={"case": (case.alpha, case.volume)})
    half_angle = new_figure(6.4, 3.2)
    plot_half_angle(half_angle, float(case.p.k))
    figures = {
        "half-angle": half_angle,
        "volume-over-angle": figure,
    }
    return Answer(numbers, figures, {"far": far, "per_kilogramme": PER_MASS_SCALES})


def speeds(case: ReportCase) -> Answer:
    """V(α) for several speeds: α_max is constant and V ∝ v₀². The reason holds for questions 5 to 8."""
    family = case.families(LINEARIZED)["v0"]
    numbers = family_numbers(case, family, LINEARIZED) | {"departure_from_square": family.departure(2)}
    return Answer(numbers, {"speeds": family.figure(case.units)}, {"family": family})


def sizes_and_masses(case: ReportCase) -> Answer:
    """R is absent from the equations; V ∝ m."""
    masses, sizes = (case.families(LINEARIZED)[name] for name in ("m", "r"))
    difference = float((np.ptp(sizes.volumes, axis=0) / float(case.p.volume_scale)).max())
    numbers = {
        "m": family_numbers(case, masses, LINEARIZED) | {"departure_from_proportion": masses.departure(1)},
        "r": family_numbers(case, sizes, LINEARIZED) | {"largest_difference": difference},
    }
    return Answer(numbers, {"masses": masses.figure(case.units)}, {"masses": masses})


def materials(case: ReportCase) -> Answer:
    """All metals of Table 2 and the case's own σ; V ∝ 1/σ."""
    family = case.families(LINEARIZED)["sigma"]
    numbers = family_numbers(case, family, LINEARIZED) | {"departure_from_inverse": family.departure(-1)}
    return Answer(numbers, {"materials": family.figure(case.units)}, {"family": family})


def guesses(case: ReportCase) -> Answer:
    """Of the guessed parameters ψ does not matter; k does: α_max = ½ arctan k."""
    contacts, ratios = (case.families(LINEARIZED)[name] for name in ("psi", "k"))
    k = float(case.p.k)
    differences = np.abs(ratios.alpha - np.arctan(ratios.values) / 2)
    of_ratios = family_numbers(case, ratios, LINEARIZED)
    law = {
        "largest_difference_from_law": float(differences.max()),
        "sensitivity_by_law": k / (1 + k**2) / 2,
        "move_for_a_tenth": of_ratios["sensitivity"] / 10,
    }
    numbers = {
        "psi": family_numbers(case, contacts, LINEARIZED) | {"departure_from_inverse": contacts.departure(-1)},
        "k": of_ratios | law,
    }
    figures = {
        "contact-heights": contacts.figure(case.units),
        "force-ratios": ratios.figure(case.units),
        "best-angle-over-k": best_angle_over_k(ratios, case.units, "computed", "½ arctan k", 3.7),
    }
    return Answer(numbers, figures, {"contacts": contacts, "ratios": ratios})
