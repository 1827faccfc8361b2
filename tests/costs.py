"""Costs of the tests: processor time and compilations of each test and of the whole run.

Seconds are processor time of this process, its threads and its finished child processes. They
hardly depend on the load of the machine. To compare machines, the total is also printed as a
multiple of a fixed computation that is timed in the same run. The suite has about the same multiple
on another machine.

The seconds of compiling are clock time, because JAX reports no processor time.
"""

import json
import resource
import time
from collections import Counter
from pathlib import Path

import jax
import pytest

# Property of a test's report: processor time and compilations, sent from a worker to the session.
_KEY = "costs"
# Events that JAX reports, and their names here.
_EVENTS = {
    "jaxpr_trace_duration": "tracing",
    "jaxpr_to_mlir_module_duration": "lowering",
    "backend_compile_duration": "compiling",
}
_SHOWN = 10
_MEGABYTE = 1024  # in KiB, the unit of `ru_maxrss`


class Costs:
    """Plugin that measures every test of a process. The session's process prints the sums."""

    def __init__(self, config: pytest.Config) -> None:
        self.file = config.getoption("--compilations")
        self.tests: dict[str, Counter] = {}
        self.workers: list[dict] = []
        self.current: Counter = Counter()
        jax.monitoring.register_event_duration_secs_listener(self._on_event)

    def _on_event(self, event: str, seconds: float, **_) -> None:
        name = _EVENTS.get(event.rsplit("/", 1)[-1])
        if name is not None:
            self.current[name] += seconds
            self.current["compilations"] += name == "compiling"

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        """Measure a test, including fixtures that it uses first or last."""
        self.current.clear()
        self.before = processor_seconds()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item, call):
        report = yield
        now = processor_seconds()
        report.user_properties = [
            (_KEY, dict(self.current) | {"processor": now - self.before, "phase": call.when})
        ]
        self.current.clear()
        self.before = now
        return report

    def pytest_runtest_logreport(self, report):
        for key, costs in report.user_properties:
            if key == _KEY:
                costs = {name: value for name, value in costs.items() if name != "phase"}
                self.tests.setdefault(report.nodeid, Counter()).update(costs)

    def pytest_sessionfinish(self, session):
        """Report the total costs of each worker, with importing and collecting."""
        totals = {
            "processor": processor_seconds(),
            "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MEGABYTE,
            "unit": unit(),
        }
        output = getattr(session.config, "workeroutput", None)
        if output is not None:
            output[_KEY] = totals
        elif not self.workers:
            self.workers = [totals]

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node, error):
        totals = getattr(node, "workeroutput", {}).get(_KEY)
        if totals:
            self.workers.append(totals)

    def pytest_terminal_summary(self, terminalreporter):
        if not self.tests or not self.workers:
            return
        terminalreporter.section("costs")
        for line in self.summary():
            terminalreporter.write_line(line)
        if self.file:
            lines = [json.dumps({"test": name, **costs}) for name, costs in self.tests.items()]
            Path(self.file).write_text("\n".join(lines) + "\n")

    def summary(self) -> list[str]:
        """Return lines with the most expensive tests and the total costs."""
        one = min(worker["unit"] for worker in self.workers)
        total = sum(self.tests.values(), Counter())
        most_expensive = sorted(self.tests.items(), key=lambda test: -test[1]["processor"])[:_SHOWN]
        lines = [
            f"{costs['processor']:7.1f} s {costs['compilations']:5.0f} compilations  {name}"
            for name, costs in most_expensive
        ]
        whole = sum(worker["processor"] for worker in self.workers)
        memory = " and ".join(f"{worker['memory']:.0f}" for worker in self.workers)
        return [
            *lines,
            f"{len(self.tests)} tests: {total['processor']:.0f} s of processor time, "
            f"{total['compilations']:.0f} compilations "
            f"(tracing {total['tracing']:.0f} s, lowering {total['lowering']:.0f} s, "
            f"compiling {total['compiling']:.0f} s)",
            f"with importing and collecting {whole:.0f} s: {whole / one:.0f} times a fixed "
            f"computation that takes {one:.3f} s here",
            f"largest memory of the processes: {memory} MiB",
        ]


def processor_seconds() -> float:
    """Return the processor time of this process and its finished child processes, s."""
    return sum(
        usage.ru_utime + usage.ru_stime
        for usage in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def unit() -> float:
    """Return processor seconds of a fixed computation, the minimum of three."""

    def once() -> float:
        start = time.thread_time()
        counted: Counter = Counter()
        for number in range(200_000):
            counted[number * number % 1009] += 1
        assert len(counted) == 505  # zero and the squares of a prime
        return time.thread_time() - start

    return min(once() for _ in range(3))
