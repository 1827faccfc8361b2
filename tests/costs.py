"""What the tests cost: processor time and compilations of each, and of all, at the end of a run.

Seconds are of processor time, of this process, its threads, and the processes it waited for, so
that a busy machine reads the same as a quiet one. To compare machines, they are also given as a
multiple of a fixed computation, timed in the same run: the same suite on another machine gives
about the same multiple, and a test that grew shows in it.

The seconds of compiling are those of the clock: JAX reports no others.
"""

import json
import resource
import time
from collections import Counter
from pathlib import Path

import jax
import pytest

# The name under which a test's report carries its costs from the worker to the session.
_KEY = "costs"
# What JAX reports, and how we call it.
_EVENTS = {
    "jaxpr_trace_duration": "tracing",
    "jaxpr_to_mlir_module_duration": "lowering",
    "backend_compile_duration": "compiling",
}
_SHOWN = 10
_MEGABYTE = 1024  # in what `ru_maxrss` counts, KiB


class Costs:
    """Measures every test of this process; the session's process adds them up and shows them."""

    def __init__(self, config: pytest.Config) -> None:
        self.file = config.getoption("--compilations")
        self.tests: dict[str, Counter] = {}
        self.workers: list[dict] = []
        self.current: Counter = Counter()
        jax.monitoring.register_event_duration_secs_listener(self._heard)

    def _heard(self, event: str, seconds: float, **_) -> None:
        name = _EVENTS.get(event.rsplit("/", 1)[-1])
        if name is not None:
            self.current[name] += seconds
            self.current["compilations"] += name == "compiling"

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        """Processor time of a test with the fixtures that it is the first or last to use."""
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
        """Each worker tells what all of it took, importing and collecting included."""
        told = {
            "processor": processor_seconds(),
            "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MEGABYTE,
            "unit": unit(),
        }
        output = getattr(session.config, "workeroutput", None)
        if output is not None:
            output[_KEY] = told
        elif not self.workers:
            self.workers = [told]

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node, error):
        told = getattr(node, "workeroutput", {}).get(_KEY)
        if told:
            self.workers.append(told)

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
        """The dearest tests, and what all cost."""
        one = min(worker["unit"] for worker in self.workers)
        total = sum(self.tests.values(), Counter())
        dearest = sorted(self.tests.items(), key=lambda test: -test[1]["processor"])[:_SHOWN]
        lines = [
            f"{costs['processor']:7.1f} s {costs['compilations']:5.0f} compilations  {name}"
            for name, costs in dearest
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
    """Of this process and of those that it has waited for."""
    return sum(
        usage.ru_utime + usage.ru_stime
        for usage in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def unit() -> float:
    """Processor seconds of a fixed computation, the shortest of three."""

    def once() -> float:
        start = time.thread_time()
        counted: Counter = Counter()
        for number in range(200_000):
            counted[number * number % 1009] += 1
        assert len(counted) == 505  # zero and the squares of a prime
        return time.thread_time() - start

    return min(once() for _ in range(3))
