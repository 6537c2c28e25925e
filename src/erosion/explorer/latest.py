"""A worker for which only the latest item matters."""

from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class LatestWins(Generic[T]):
    """Works on one item at a time, and lets only the newest item wait.

    Args:
        work: works on an item. It may look at `waiting` and stop early.
        start: starts a coroutine on the event loop.
    """

    def __init__(self, work: Callable[[T], Awaitable[None]], start: Callable[[Awaitable[None]], object]) -> None:
        self._work, self._start = work, start
        self._next: list[T] = []
        self._busy = False

    @property
    def waiting(self) -> bool:
        """Whether a newer item waits."""
        return bool(self._next)

    def offer(self, item: T) -> None:
        """Work on this item next; it replaces an item that waits."""
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
