"""`make durations`: measures what each test costs, and lists in `slow.txt` those that `make test` leaves out.

A test costs its call, the fixtures of its own, and its share of each fixture that others use, too: its time over the
number of these tests. What a process compiles once for several tests counts where it comes first.
"""

import time
from collections import defaultdict
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

TABLE = Path(__file__).with_name("slow.txt")
LIMIT = 0.25
"""Seconds above which a test is slow: so `make test` takes three minutes."""


class SharedFixture(NamedTuple):
    """A fixture that several tests use: its name, where it is defined, and which of its parameters."""

    name: str
    defined_in: str
    parameter: int


class Durations:
    """The plugin. Each process sends with a test's report what it measured; the first process adds up."""

    def __init__(self) -> None:
        self.set_up: list[tuple[str, str, int, float]] = []
        self.inner_seconds: list[float] = []
        self.own: dict[str, float] = defaultdict(float)
        self.shared: dict[SharedFixture, list[float]] = defaultdict(list)
        self.users: dict[SharedFixture, list[str]] = defaultdict(list)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Generator[None, object, object]:
        """Time a shared fixture without those that it asks for meanwhile."""
        self.inner_seconds.append(0.0)
        started = time.perf_counter()
        try:
            return (yield)
        finally:
            seconds = time.perf_counter() - started
            alone = seconds - self.inner_seconds.pop()
            if self.inner_seconds:
                self.inner_seconds[-1] += seconds
            if fixturedef.scope != "function":
                self.set_up.append((fixturedef.argname, fixturedef.baseid, request.param_index, alone))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Function, call: pytest.CallInfo[None]
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Add to a report which shared fixtures the test uses, and which it was the first to use."""
        report = yield
        if call.when == "setup":
            indices = item.callspec.indices if hasattr(item, "callspec") else {}
            definitions = {name: found[-1] for name, found in item._fixtureinfo.name2fixturedefs.items()}
            uses = [(name, d.baseid, indices.get(name, 0)) for name, d in definitions.items() if d.scope != "function"]
            report.user_properties = [("uses", uses), ("set_up", self.set_up)]
            self.set_up = []
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up."""
        if report.when == "teardown":
            return
        self.own[report.nodeid] += report.duration
        noted: dict[str, Any] = dict(report.user_properties) if report.when == "setup" else {}
        for shared in noted.get("uses", ()):
            self.users[SharedFixture(*shared)].append(report.nodeid)
        for *shared, seconds in noted.get("set_up", ()):
            self.shared[SharedFixture(*shared)].append(seconds)
            self.own[report.nodeid] -= seconds

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Write the table, in the first process and after a whole run."""
        if not hasattr(session.config, "workerinput") and exitstatus in (
            pytest.ExitCode.OK,
            pytest.ExitCode.TESTS_FAILED,
        ):
            write(self.seconds())

    def seconds(self) -> dict[str, float]:
        """What each test costs."""
        seconds = dict(self.own)
        for shared, times in self.shared.items():
            mean = sum(times) / len(times)
            for test in self.users[shared]:
                seconds[test] += mean / len(self.users[shared])
        return seconds


def function_of(test: str) -> str:
    """The test without its parameters."""
    return test.partition("[")[0]


def write(seconds: dict[str, float]) -> None:
    """List the slow tests by name. A function that is slow with all its parameters is one line, with the slowest."""
    tests_of: dict[str, dict[str, float]] = defaultdict(dict)
    for test, value in seconds.items():
        tests_of[function_of(test)][test] = value
    lines = []
    for function, tests in sorted(tests_of.items()):
        slow = {test: value for test, value in tests.items() if value > LIMIT}
        entries = {function: max(slow.values())} if len(slow) == len(tests) else slow
        lines += [f"{value:6.2f}  {test}\n" for test, value in sorted(entries.items())]
    TABLE.write_text("".join(lines), "utf-8")


def mark_slow(tests: Sequence[pytest.Item]) -> list[str]:
    """Mark what the table lists, and return the entries that stand for no test of these files, or of no file."""
    entries = {line.split(maxsplit=1)[1] for line in TABLE.read_text("utf-8").splitlines()}
    matched = set()
    for test in tests:
        names = entries & {test.nodeid, function_of(test.nodeid)}
        if names:
            test.add_marker(pytest.mark.slow)
            matched |= names
    files = {test.nodeid.partition("::")[0] for test in tests}
    root = TABLE.parents[1]
    file_of = {entry: entry.partition("::")[0] for entry in entries - matched}
    return sorted(entry for entry, file in file_of.items() if file in files or not (root / file).is_file())


def pytest_configure(config: pytest.Config) -> None:
    """Called by pytest, which `-p tests.durations` tells of this module."""
    config.pluginmanager.register(Durations())
