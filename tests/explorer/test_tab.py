"""A tab without a browser: which answers it asks for, and when."""

import asyncio
import dataclasses
import threading

import pytest
from nicegui.testing import user_simulation

from erosion.explorer.computed import AT_ONCE, KINDS, LATER, AnswerKind, Answers, Stage, Work
from erosion.explorer.server import offer
from erosion.explorer.state import PageCase, PageState
from erosion.explorer.tab import Tab
from erosion.parameters.parameters import TABLE_1

K = 3.0
"""Of the moved case."""


class OneWaits(Answers):
    """Answers that all fail at once, but one kind waits until the tab has asked for the moved case."""

    def __init__(self, stage: Stage) -> None:
        self.stage, self.asked = stage, threading.Event()
        self.begun, self.computed = threading.Event(), threading.Event()
        super().__init__({}, {kind: AnswerKind(self._answer(kind)) for kind in KINDS})

    def start(self, stage: Stage, state: PageState) -> dict[str, Work]:
        work = super().start(stage, state)
        if stage == self.stage and state.case.parameters().k == K:
            self.asked.set()
        return work

    def _answer(self, kind: str):
        def answer(_: Answers, __: str, case: PageCase) -> None:
            if kind == self.stage.kinds[0]:
                (self.computed if case.parameters().k == K else self.begun).set()
                self.asked.wait(60)
            raise ValueError

        return answer


@pytest.mark.parametrize("stage", [AT_ONCE[0], LATER[0]], ids=["curve", "best"])
def test_the_newest_case_is_computed_when_an_earlier_one_is_done(stage: Stage) -> None:
    """The work on the earlier case ends while the tab waits for it."""
    answers = OneWaits(stage)
    service = dataclasses.replace(offer(TABLE_1), answers=answers)
    start = dataclasses.replace(service.start, models=("linearized",), shown="linearized")

    async def drive() -> None:
        async with user_simulation(lambda: None) as user:
            await user.open("/")
            with user:
                tab = Tab(service, start)
                answers.start(stage, start)  # as another tab does
                assert await asyncio.to_thread(answers.begun.wait, 60)
                tab.state = dataclasses.replace(start, case=start.case.replace(k=K))
                tab.begin()
            assert await asyncio.to_thread(answers.computed.wait, 10)

    asyncio.run(drive())
