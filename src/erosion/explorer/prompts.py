"""Questions 4 to 8 as predictions: the reader chooses, then the page shows the answer."""

import math
from collections.abc import Callable
from typing import NamedTuple

from nicegui import ui

from erosion.explorer.state import PageCase


class Prompt(NamedTuple):
    """A question about the linearized model.

    Args:
        question: in one sentence.
        choices: of the reader.
        right: the index of the right one.
        reason: why, with `{alpha}` and `{doubled}` for the best angles at k and at 2 k.
    """

    question: str
    choices: tuple[str, ...]
    right: int
    reason: str


_ANGLE = ("It becomes flatter.", "It stays.", "It becomes steeper.")
PROMPTS = (
    Prompt(
        "4. At which angle does the particle remove most?",
        ("The steeper, the more.", "At half the angle between surface and force.", "The flatter, the more."),
        1,
        "The depth grows as sin α, the mean forward speed falls as sin(θ − α), with tan θ = k for the force. Their "
        "product is greatest at α = θ/2 = ½ arctan k, here {alpha:.4g}°. Drag the angle over V(α).",
    ),
    Prompt(
        "5. The particle flies twice as fast. What happens to the best angle?",
        _ANGLE,
        1,
        "The speed scales lengths, and no time: four times as much is removed at every angle. Change v₀ and see.",
    ),
    Prompt(
        "6. The particle is twice as heavy. What happens to the best angle?",
        _ANGLE,
        1,
        "The mass stands before the whole curve: twice as much is removed at every angle. The size is in no equation.",
    ),
    Prompt(
        "7. The metal is half as strong. What happens to the best angle?",
        _ANGLE,
        1,
        "The flow stress divides the volume: twice as much is removed at every angle. Choose other targets.",
    ),
    Prompt(
        "8. The force ratio k is twice as large. What happens to the best angle?",
        _ANGLE,
        2,
        "k is the direction of the force. The best angle goes from {alpha:.4g}° to {doubled:.4g}°, and less is removed "
        "there.",
    ),
)


def prompts(case: Callable[[], PageCase]) -> None:
    """The elements of all questions.

    Args:
        case: the case that the page shows.
    """
    with ui.expansion("Predict first: questions 4 to 8 for the linearized model").classes("prompts"):
        for prompt in PROMPTS:
            _ask(prompt, case)


def _ask(prompt: Prompt, case: Callable[[], PageCase]) -> None:
    with ui.element("div").classes("prompt"):
        ui.label(prompt.question).classes("prompt-question")
        choice = ui.radio(list(prompt.choices)).props("inline dense")
        answer = ui.label().classes("prompt-answer").props("role=status")

        def reveal() -> None:
            k = float(case().parameters().k)
            best, doubled = (math.degrees(math.atan(ratio) / 2) for ratio in (k, 2 * k))
            verdict = "Yes." if choice.value == prompt.choices[prompt.right] else f"No: {prompt.choices[prompt.right]}"
            answer.set_text(f"{verdict} {prompt.reason.format(alpha=best, doubled=doubled)}")

        choice.on_value_change(reveal)
