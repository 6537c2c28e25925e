"""Work of which only the latest matters."""

from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class LatestWins(Generic[T]):
    """Does one thing at a time and keeps at most one waiting: the newest.

    Args:
        work: what is done with it. It may look at `waiting` and give up early.
        start: starts a coroutine on the event loop.
    """

    def __init__(self, work: Callable[[T], Awaitable[None]], start: Callable[[Awaitable[None]], object]) -> None:
        self._work, self._start = work, start
        self._next: list[T] = []
        self._busy = False

    @property
    def waiting(self) -> bool:
        """Whether something newer waits."""
        return bool(self._next)

    def offer(self, item: T) -> None:
        """Do this, instead of whatever was waiting."""
        self._next = [item]
        if not self._busy:
            self._busy = True
            self._start(self._drain())

    async def _drain(self) -> None:
        try:
            while self._next:
                await self._work(self._next.pop())
        finally:
            self._busy = False
