"""A progress bar with rate and time left, on stderr where that is a terminal."""

import contextlib
import sys
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from erosion.arguments import Progress

_SLOWEST = 10  # per second; a slower rate says less than the time left


@contextlib.contextmanager
def progress_bar(title: str) -> Iterator["Progress"]:
    """Give the `progress` of any verb, shown as a bar; `title` stands there until the first call."""
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True, highlight=False)
    is_shown = sys.stderr is not None and sys.stderr.isatty()
    with Bar(*columns, console=console, transient=True, disable=not is_shown) as bar:
        task = bar.add_task(title, total=None, rate="")

        def show(work: str, done: int, total: int) -> None:
            speed = bar.tasks[0].speed or 0
            rate = f"{speed:,.0f}/s" if speed > _SLOWEST else ""
            # Without a total the bar moves to and fro: the first part is computed, or no one knows how many follow.
            bar.update(task, description=work, completed=done, total=(total or None) if done else None, rate=rate)

        yield show


_PATIENCE = 0.5  # s, after which a person wonders whether anything happens


@contextlib.contextmanager
def working(title: str) -> Iterator[None]:
    """Show on a terminal that something is done, once it takes longer than half a second."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield
        return
    is_done = threading.Event()
    thread = threading.Thread(target=_turn_wheel, args=(title, is_done), daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_done.set()
        thread.join()


def _turn_wheel(title: str, is_done: threading.Event) -> None:
    if is_done.wait(_PATIENCE):
        return
    from rich.console import Console

    with Console(stderr=True, highlight=False).status(f"{title} …"):
        is_done.wait()
