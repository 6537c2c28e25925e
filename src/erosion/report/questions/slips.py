"""Where the source slips, and what its equations say when they are taken to the letter."""

from typing import Any

from markupsafe import Markup

from erosion.plotting.families import plot_family
from erosion.plotting.style import new_axes, readable_scale
from erosion.report.case import Answer, Case, Illustration
from erosion.report.text import (
    degrees,
    formula,
    join,
    math,
    note,
    number,
    paragraph,
    quantity,
    quantity_tex,
    table,
    wordy_table,
)

_MODELS = {"as-printed": "as printed", "rotating": "as corrected", "linearized": "linearized"}
NEEDS = tuple((what, model) for model in _MODELS for what in ("optimum", "hits"))


def answer(case: Case) -> Answer:
    """The slips, and the literal reading beside the corrected one."""
    numbers = _numbers(case)
    printed = numbers["as-printed"]
    falls = " and that only falls with the angle" if printed["only_falls"] else ""
    return Answer(
        key="slips",
        title="Where the source slips",
        sentence=Markup("The printed equations contradict themselves in six places. <strong>Taken to the "
                        "letter</strong> they give a volume of {} at {}{}, for the erodent is first pushed "
                        "forward.").format(
            quantity(printed["volume"], "volume", case.units), degrees(case.alpha), falls
        ),
        figures=(_figure(case),),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )  # fmt: skip


def _numbers(case: Case) -> dict[str, Any]:
    found: dict[str, Any] = {"force_at_contact": float(case.p.stiffness * case.p.r)}
    for model in _MODELS:
        hits, optimum = case.hits(model), case.optimum(model)
        found[model] = {
            "volume": float(hits.volume[-1]),
            "t_c": float(hits.t_c[-1]),
            "ended_by": str(hits.ended_by[-1]),
            "kind": str(optimum.kind),
            "alpha_max": float(optimum.alpha),
            "volume_max": float(optimum.volume),
            "only_falls": bool((hits.dvolume[:-1][hits.ended_by[:-1] != "no-cut"] < 0).all()),
        }
    return found


def _figure(case: Case) -> Illustration:
    fig, ax = new_axes(5.4, 4.0)
    plot_family(ax, [case.curve(model, label) for model, label in _MODELS.items()], units=case.units, columns=3)
    return Illustration(
        "as-printed",
        fig,
        Markup("The volume removed over the angle of attack: equations (16) to (21) as printed, as corrected, and "
               "linearized."),
        "Removed volume over the angle of attack for the printed and the corrected equations.",
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    return join(
        _slips(),
        paragraph("The third is the one that matters. The depth of the tip as printed is ", math(r"y-r\sin\varphi"),
                  ", and at first contact, where ", math("y=0"), " and ", math(r"\varphi=\pi/2"), ", that is ",
                  math("-r"), ". The force then is"),
        formula(rf"F_x(0)=-\sigma b\psi\left(0-r\right)=+\sigma b\psi r={number(numbers['force_at_contact'], 4)}"
                rf"\,\text{{{_force(case)}}}"),
        paragraph("in the direction of flight: the target pushes the erodent forward and down, before it touches "
                  "anything. With the depth ", math(r"y-r(1-\sin\varphi)"), ", which is 0 at contact, it pushes back."),
        formula(rf"V_\text{{printed}}={quantity_tex(numbers['as-printed']['volume'], 'volume', case.units, 7)},\qquad "
                rf"V_\text{{corrected}}={quantity_tex(numbers['rotating']['volume'], 'volume', case.units, 7)}"),
        _readings(case, numbers),
        note("Nothing of this touches questions 1 to 8: equations (22) to (25) are right, though not for the reason "
             "given. The model ", Markup("<code>as-printed</code>"), " takes the end of the cut and the volume from "
             "the centre of mass, as (26) does."),
    )  # fmt: skip


def _force(case: Case) -> str:
    return "lbf" if case.units == "inch-pound" else "N"


def _slips() -> Markup:
    cells = (
        ("the stop", Markup("“{}”").format(math(r"y<0,\ \dot{x}=0")),
         Markup("{} is a depth, positive while cutting").format(math("y")),
         Markup("{} while {}").format(math(r"\dot{x}=0"), math("y>0"))),
        ("(15), (20)", "opposite signs of the torque",
         Markup("{} below the centre turns the body clockwise").format(math("F_x<0")),
         Markup("that of (20): {}").format(math(r"I\ddot{\varphi}=rF_x"))),
        ("(13), (14)", Markup("depth of the tip {}").format(math(r"y-r\sin\varphi")),
         Markup("{} at first contact").format(math("-r")), math(r"y-r(1-\sin\varphi)")),
        ("(15), (20)", Markup("torque from {}").format(math("y")), "its force comes from the depth of the tip",
         "torque from the depth of the tip"),
        ("linearization", Markup("“{}”").format(math(r"\sin\varphi\approx0")),
         Markup("yet {}").format(math(r"\varphi(0)=\pi/2")),
         Markup("{}, so the depth is {}").format(math(r"\varphi\approx\varphi(0)"), math("y"))),
        ("volume", Markup("{} of the centre of mass").format(math(r"\int y\,dx")),
         "with rotation the path of the tip cuts", Markup("{}").format(math(r"\int d\,dx_\text{tip}"))),
    )  # fmt: skip
    return wordy_table("Six slips", ("where", "the source says", "the trouble", "what is built"), cells)


def _readings(case: Case, numbers: dict[str, Any]) -> Markup:
    scale = readable_scale("volume", case.units, max(numbers[model]["volume_max"] for model in _MODELS))
    rows = []
    for model, label in _MODELS.items():
        found = numbers[model]
        best = "α → 0" if found["kind"] == "boundary" and not found["alpha_max"] else degrees(found["alpha_max"])
        time = quantity(found["t_c"], "time", case.units, like=found["t_c"])
        volume, greatest = (number(found[key] / scale.size, 7) for key in ("volume", "volume_max"))
        rows.append((label, volume, time, found["ended_by"], best if found["kind"] != "none" else "–", greatest))
    head = (
        "reading",
        f"V at {degrees(case.alpha)} [{scale.unit}]",
        "t_c",
        "ends by",
        "greatest at",
        f"V there [{scale.unit}]",
    )
    return table("Three readings of one page", head, rows)
