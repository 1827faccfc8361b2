"""Teams of processes: division of trials, and exchange of results."""

import itertools
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from evo_cpg.fusion.machine_constants import LANES
from evo_cpg.training.processes import ALONE, Team
from loopback import free_port
from tiny_run import environment


def parts(count: int, processes: int, trials: int = 1) -> list[slice]:
    """Return the parts of all processes, from teams without connections."""
    teams = [Team(0, 1) for _ in range(processes)]
    for index, team in enumerate(teams):
        team.index, team.count = index, processes
    return [team.part(count, trials) for team in teams]


@pytest.mark.parametrize(
    ("count", "processes", "trials"), [(200, 4, 1), (4096, 7, 1), (100, 3, 3), (64, 4, 8)]
)
def test_parts_are_contiguous_and_differ_by_a_vector(count, processes, trials):
    found = parts(count, processes, trials)
    assert found[0].start == 0 and found[-1].stop == count
    assert all(a.stop == b.start for a, b in itertools.pairwise(found))
    sizes = [(part.stop - part.start) * trials for part in found]
    assert all(size % LANES == 0 for size in sizes[:-1])
    vectors = [math.ceil(size / LANES) for size in sizes]
    step = trials // math.gcd(LANES, trials)
    assert max(vectors) - min(vectors) <= step
    # All processes together compute as few vectors as one process alone.
    assert sum(vectors) == math.ceil(count * trials / LANES)


def test_spare_processes_repeat_the_last_individual():
    found = parts(20, 4)
    assert sum(part == slice(19, 20) for part in found) == 2
    assert slice(0, 16) in found and slice(16, 20) in found


def test_a_team_of_one_returns_its_arguments():
    genes, tree = np.ones((3, 20), np.float32), {"a": np.arange(20)}
    assert ALONE.leads
    assert ALONE.part(20) == slice(0, 20)
    assert ALONE.gather(tree, genes, 0) is tree
    assert ALONE.broadcast({"a": 3}) == {"a": np.array(3)}
    assert ALONE.exchange(b"a row", "nobody") == [b"a row"]
    ALONE.leave()


def run(code: str, count: int, compiled: Path, *arguments: object) -> list[str]:
    """Run code in several processes, and return the output of each.

    Args:
        code: code of each process. The name `team` is its team.
        count: number of processes.
        compiled: folder of compiled programs.
        arguments: values of the code's name `arguments`.
    """
    start = f"""
import json, os, signal, sys, time
import numpy as np
from evo_cpg.training import processes
from evo_cpg.training.processes import TeamError, difference, join
from evo_cpg.training.roll_call import Place

index, count, port, *arguments = sys.argv[1:]
place = Place(int(index), int(count), "localhost", int(port))
team = join(place, {{}}, 60.0)
{code}
"""
    port = free_port()
    started = [
        subprocess.Popen(
            [sys.executable, "-c", start, *map(str, (index, count, port, *arguments))],
            env=environment(compiled),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for index in range(count)
    ]
    try:
        ends = [process.communicate(timeout=150) for process in started]
    finally:
        for process in started:
            process.kill()
    assert all(process.returncode == 0 for process in started), ends
    return [out for out, _ in ends]


TALK = """
told = []
genes = np.arange(120, dtype=np.float32).reshape(3, 40)
whole = {
    "number": np.arange(40, dtype=np.float32) / 7,
    "alive": np.arange(40) % 3 == 0,
    "wide": np.arange(2 * 40 * 4, dtype=np.int32).reshape(2, -1),
}
whole["number"].view(np.uint32)[5] = 0x7FC01234  # not a number, with a message in it


def trials(share, each):
    return slice(share.start * each, share.stop * each)


for each, names in ((1, ("number", "alive")), (4, ("wide",))):
    tree = {name: whole[name] for name in names}
    part = trials(team.part(40, each), each)
    back = team.gather({n: x[..., part] for n, x in tree.items()}, genes, 3, each)
    told.append(all(back[n].tobytes() == x.tobytes() for n, x in tree.items()))
    told.append(all(back[n].dtype == x.dtype for n, x in tree.items()))

lead = {"genes": np.random.default_rng(0).random(400_000), "name": np.array("evo")}
sent = team.broadcast(lead if team.leads else {})
told.append(all(np.array_equal(sent[name], lead[name]) for name in lead))
told.append(team.broadcast({}) == {})
told.append(difference(team.exchange(b"equal", "the others")))
told.append(difference(team.exchange(b"equal" if index != "1" else b"other", "the others")))
genes[0, 0] += index == "1"
try:
    team.gather({"a": whole["number"][team.part(40)]}, genes, 4)
except TeamError as error:
    told.append(str(error))
team.leave()
print(json.dumps(told))
"""


def test_two_processes_exchange_results(tmp_path):
    for out in run(TALK, 2, tmp_path):
        told = json.loads(out)
        assert told[:6] == [True] * 6
        assert told[6:8] == ["", "process 0 unlike 1"]
        assert told[8].endswith(
            ": the population of generation 4 differs between the processes: process 0 unlike 1. "
            "Processors of different kinds may round differently, so use machines of one kind"
        )


@pytest.mark.slow
def test_four_processes_exchange_results(tmp_path):
    for out in run(TALK, 4, tmp_path):
        told = json.loads(out)
        assert told[:6] == [True] * 6
        assert told[7] == "process 0, 2, 3 unlike 1"


LATE = """
patience, late = map(float, arguments)
processes.COMPILING = 0.0
team._patience = patience
team.exchange(b"a", "a first look")
if index == "1":
    time.sleep(late)
try:
    team.exchange(b"b", "a second look")
except TeamError as error:
    print(error, flush=True)
else:
    team.leave()
    print("done")
"""


@pytest.mark.slow
def test_waiting_for_a_stuck_process_ends(tmp_path):
    lead, other = run(LATE, 2, tmp_path, 1.0, 3.0)
    words = "process 0 has waited 1 s for a second look (its own work took 0.0 s). Another process"
    assert lead.startswith(f"process 0 of 2: {words}")
    # The lead sent the reason why the team cannot continue.
    assert other.startswith(f"process 1 of 2: {words}")


@pytest.mark.slow
def test_a_late_process_is_awaited(tmp_path):
    assert run(LATE, 2, tmp_path, 120.0, 3.0) == ["done\n", "done\n"]
