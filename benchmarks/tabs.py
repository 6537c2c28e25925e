"""The explorer under the load of a room: `python -m benchmarks.tabs [--tabs 50] [--events 500] [--minutes 10]`.

Tabs without a browser speak to the server as its page does: each drags a slider, reads every answer, and acknowledges
it. Every two seconds one tab is closed and another opened, and one GET is made without JavaScript. Prints the server's
resident memory each minute; it fails where memory grows in the second half, or where a tab gets no answer. Linux only.
"""

import argparse
import asyncio
import contextlib
import itertools
import json
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path

import aiohttp
import socketio
from socketio.exceptions import SocketIOError

GROWTH = 1.1  # of the memory at the end over that after half of the time
_SLIDERS = ("alpha", "k", "v0")


class Tab:
    """One page that is open: its sliders, and how many answers it has had."""

    def __init__(self, address: str, number: int) -> None:
        self.address, self.number = address, number
        self.client, self.answers = "", 0
        self.sliders: dict[str, tuple[int, str]] = {}
        self.socket = socketio.AsyncClient(reconnection=False)
        self.socket.on("*", self._hear)

    async def open(self, session: aiohttp.ClientSession) -> None:
        """Get the page, and connect as its script does."""
        async with session.get(self.address) as answer:
            page = await answer.text()
        found = re.search(r"'client_id': '([^']+)'", page)
        assert found is not None, f"no page: {page[:200]}"
        self.client = found.group(1)
        names = f"client_id={self.client}&next_message_id=0&implicit_handshake=true"
        await self.socket.connect(
            f"{self.address}?{names}&document_id=d{self.number}&tab_id=t{self.number}",
            socketio_path="/_nicegui_ws/socket.io",
            transports=["websocket"],
            headers={"Origin": self.address},
        )

    async def _hear(self, event: str, message: dict) -> None:
        if event == "update":
            for number, element in message.items():
                name = element.get("props", {}).get("id") if isinstance(element, dict) else None
                if name in _SLIDERS:
                    listener = next(one["listener_id"] for one in element["events"] if one["type"] == "slide")
                    self.sliders[name] = int(number), listener
        self.answers += event == "run_javascript"
        if "_id" in message:
            acknowledged = {"client_id": self.client, "next_message_id": message["_id"] + 1}
            with contextlib.suppress(SocketIOError):  # it is closed meanwhile
                await self.socket.emit("ack", acknowledged)

    async def drag(self, position: float) -> bool:
        """Move one of the sliders; whether the page is ready for it."""
        if not (self.sliders and self.socket.connected):
            return False
        name = _SLIDERS[int(1e6 * position) % len(self.sliders)]
        element, listener = self.sliders[name]
        # α runs over degrees, the others over a logarithm from -1 to 1.
        value = 0.25 + 89 * position if name == "alpha" else 2 * position - 1
        message = {"id": element, "client_id": self.client, "listener_id": listener, "args": [json.dumps(value)]}
        await self.socket.emit("event", message)
        return True

    async def close(self) -> None:
        """Leave, as a closed tab does."""
        with contextlib.suppress(SocketIOError):
            await self.socket.disconnect()


class Room:
    """Many tabs of one server."""

    def __init__(self, address: str, tabs: int, events: float) -> None:
        self.address, self.count, self.rate = address, tabs, events
        self.numbers = itertools.count()
        self.tabs: list[Tab] = []
        self.sent = self.closed = self.answers = self.silent = 0
        self.waits: list[float] = []

    async def hold(self, seconds: float) -> None:
        """Drag, close, open and get for so long."""
        until = time.monotonic() + seconds
        async with aiohttp.ClientSession() as session:
            while len(self.tabs) < self.count:
                await self._open(session)
            dragging = asyncio.create_task(self._drag(until))
            while time.monotonic() < until:
                await asyncio.sleep(2)
                begun = time.monotonic()
                async with session.get(self.address) as answer:
                    await answer.read()
                self.waits.append(time.monotonic() - begun)
                self.silent += not self.tabs[0].answers
                await self._close(self.tabs.pop(0))
                await self._open(session)
            await dragging

    async def leave(self) -> None:
        """Close all tabs."""
        while self.tabs:
            await self._close(self.tabs.pop())

    async def _open(self, session: aiohttp.ClientSession) -> None:
        tab = Tab(self.address, next(self.numbers))
        await tab.open(session)
        self.tabs.append(tab)

    async def _close(self, tab: Tab) -> None:
        self.answers += tab.answers
        self.closed += 1
        await tab.close()

    async def _drag(self, until: float) -> None:
        begun = time.monotonic()
        for i in itertools.count():
            if (now := time.monotonic()) >= until:
                return
            if (early := begun + i / self.rate - now) > 0:
                await asyncio.sleep(early)
            self.sent += await self.tabs[i % len(self.tabs)].drag((0.618034 * i) % 1)


async def run(tabs: int, events: float, minutes: int) -> bool:
    """Start a server, hold the load, print; whether memory was held and every tab had answers."""
    command = [sys.executable, "-m", "erosion", "explore", "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        address = server.stdout.readline().split()[-1].rstrip("/")
        room, memory = Room(address, tabs, events), [_resident(server.pid)]
        print(f"before: {memory[0]:,.0f} MB")
        try:
            for minute in range(1, minutes + 1):
                sent, begun = room.sent, time.monotonic()
                await room.hold(60)
                memory.append(_resident(server.pid))
                rate = (room.sent - sent) / (time.monotonic() - begun)
                wait = 1000 * statistics.median(room.waits)
                print(f"after {minute} min: {memory[-1]:,.0f} MB, {rate:.0f} events/s, a GET {wait:.0f} ms", flush=True)
            await room.leave()
            await asyncio.sleep(5)
            end = _resident(server.pid)
        finally:
            server.terminate()
    print(f"all closed: {end:,.0f} MB")
    print(f"{room.sent:,} events, {room.answers:,} answers, {room.closed} tabs opened and closed, {room.silent} silent")
    return memory[-1] <= GROWTH * memory[(minutes + 1) // 2] and not room.silent


def main() -> int:
    """Hold the load; 1 where memory grows, or where a tab gets no answer."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tabs", description=__doc__)
    parser.add_argument("--tabs", type=int, default=50)
    parser.add_argument("--events", type=float, default=500.0, help="a second, of all tabs together")
    parser.add_argument("--minutes", type=int, default=10)
    arguments = parser.parse_args()
    return 0 if asyncio.run(run(arguments.tabs, arguments.events, arguments.minutes)) else 1


def _resident(pid: int) -> float:
    """Resident memory of a process [MB]."""
    status = Path(f"/proc/{pid}/status").read_text()
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    assert found is not None
    return int(found.group(1)) * 1024 / 1e6


if __name__ == "__main__":
    sys.exit(main())
