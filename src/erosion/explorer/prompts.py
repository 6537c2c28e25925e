"""Questions 4 to 8 as predictions: the reader chooses, then the page shows the answer."""

import math
from collections.abc import Callable
from typing import NamedTuple

from nicegui import ui

from erosion.explorer.state import PageCase


class Prompt(NamedTuple):
    """A question about the linearized model.

    Args:
        number: of the scenario's question.
        question: in one sentence.
        choices: of the reader.
        right: the index of the right one.
        reason: why, with `{alpha}` and `{doubled}` for the best angles at k and at 2 k.
        sketch: draws the reason for a force ratio k, as SVG.
    """

    number: str
    question: str
    choices: tuple[str, ...]
    right: int
    reason: str
    sketch: Callable[[float], str] = lambda _: ""


def half_angle(k: float) -> str:
    """The directions of motion and force at the best angle, and the angles between them and the surface."""
    theta = math.atan(k)

    def towards(angle: float, length: float) -> str:
        return f"{-length * math.cos(angle):.2f} {-length * math.sin(angle):.2f}"

    def arc(begin: float, end: float, radius: float) -> str:
        return f'<path d="M{towards(begin, radius)} A{radius} {radius} 0 0 1 {towards(end, radius)}" />'

    def label(text: str, angle: float) -> str:
        x, y = towards(angle, 104).split()
        return f'<text x="{x}" y="{y}" text-anchor="middle">{text}</text>'

    return f"""<svg class="half-angle" viewBox="-140 -112 190 126" role="img" aria-label="The motion halves the angle
      between surface and force."><defs><marker id="tip" viewBox="0 0 6 6" refX="5" refY="3" markerWidth="5"
      markerHeight="5" orient="auto"><path d="M0 0 L6 3 L0 6 z" fill="context-stroke" /></marker></defs>
      <path class="target" d="M-140 0 H50 V14 H-140 z" /><path class="surface" d="M-140 0 H50" />
      <path class="velocity" d="M{towards(theta / 2, 100)} L0 0" marker-end="url(#tip)" />
      <path class="force" d="M0 0 L{towards(theta, 90)}" marker-end="url(#tip)" />
      {arc(0, theta / 2, 40)}{arc(theta / 2, theta, 44)}
      {label(f"motion, α = {math.degrees(theta / 2):.4g}°", theta / 2)}
      {label(f"force, {math.degrees(theta):.4g}°", theta)}</svg>"""


_ANGLE = ("It becomes flatter.", "It stays.", "It becomes steeper.")
PROMPTS = (
    Prompt(
        "4",
        "At which angle does the particle remove most?",
        ("The steeper, the more.", "At half the angle between surface and force.", "The flatter, the more."),
        1,
        "The depth grows as sin α, the mean forward speed falls as sin(θ − α), with tan θ = k for the force. Their "
        "product is greatest at α = θ/2 = ½ arctan k, here {alpha:.4g}°. Drag the angle over V(α).",
        half_angle,
    ),
    Prompt(
        "5",
        "The particle flies twice as fast. What happens to the best angle?",
        _ANGLE,
        1,
        "The speed scales lengths, and no time: four times as much is removed at every angle. Change v₀ and see.",
    ),
    Prompt(
        "6",
        "The particle is twice as heavy. What happens to the best angle?",
        _ANGLE,
        1,
        "The mass stands before the whole curve: twice as much is removed at every angle. The size is in no equation.",
    ),
    Prompt(
        "7",
        "The metal is half as strong. What happens to the best angle?",
        _ANGLE,
        1,
        "The flow stress divides the volume: twice as much is removed at every angle. Choose other targets.",
    ),
    Prompt(
        "8",
        "The force ratio k is twice as large. What happens to the best angle?",
        _ANGLE,
        2,
        "k is the direction of the force. The best angle goes from {alpha:.4g}° to {doubled:.4g}°, and less is removed "
        "there.",
    ),
)


def prompts(case: Callable[[], PageCase], reveal: Callable[[], None], *, opened: bool) -> None:
    """The elements of all questions, one of which is seen.

    Args:
        case: the case that the page shows.
        reveal: shows the best angles; it is called when all questions are answered, or when the reader asks for them.
        opened: whether the questions are seen at first.
    """
    left = set(PROMPTS)

    def answered(prompt: Prompt) -> None:
        left.discard(prompt)
        if not left:
            reveal()

    with ui.expansion("Predict first: questions 4 to 8 for the linearized model", value=opened).classes("prompts"):
        with ui.element("div").classes("prompts-bar"):
            with ui.tabs().props("dense no-caps") as tabs:
                for prompt in PROMPTS:
                    ui.tab(prompt.number, f"Question {prompt.number}")
            ui.button("Show the best angles", on_click=reveal).props("dense no-caps outline").classes("reveal")
        with ui.tab_panels(tabs, value=PROMPTS[0].number).props("keep-alive"):
            for prompt in PROMPTS:
                with ui.tab_panel(prompt.number).classes("prompt"):
                    _ask(prompt, case, answered)


def _ask(prompt: Prompt, case: Callable[[], PageCase], answered: Callable[[Prompt], None]) -> None:
    ui.label(prompt.question).classes("prompt-question")
    choice = ui.radio(list(prompt.choices)).props("inline dense")
    answer = ui.label().classes("prompt-answer").props("role=status")
    drawing = ui.html("", sanitize=False)

    def reveal() -> None:
        k = float(case().parameters().k)
        best, doubled = (math.degrees(math.atan(ratio) / 2) for ratio in (k, 2 * k))
        verdict = "Yes." if choice.value == prompt.choices[prompt.right] else f"No: {prompt.choices[prompt.right]}"
        answer.set_text(f"{verdict} {prompt.reason.format(alpha=best, doubled=doubled)}")
        drawing.set_content(prompt.sketch(k))
        answered(prompt)

    choice.on_value_change(reveal)
