"""Teams of processes: how work is shared out, and what processes tell each other."""

import itertools
import json
import math
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from evo_cpg.fusion.jax_internals import lost_process
from evo_cpg.fusion.machine_constants import LANES
from evo_cpg.training.processes import ALONE, Team
from evo_cpg.training.watchdog import finish_within
from loopback import free_port
from tiny_run import environment


def parts(count: int, processes: int, trials: int = 1) -> list[slice]:
    """Of all processes; the class asks JAX for its devices only where there are several."""
    teams = [Team(0, 1) for _ in range(processes)]
    for index, team in enumerate(teams):
        team.index, team.count = index, processes
    return [team.share(count, trials) for team in teams]


@pytest.mark.parametrize(
    ("count", "processes", "trials"), [(200, 4, 1), (4096, 7, 1), (100, 3, 3), (64, 4, 8)]
)
def test_parts_follow_each_other_and_differ_by_a_vector(count, processes, trials):
    found = parts(count, processes, trials)
    assert found[0].start == 0 and found[-1].stop == count
    assert all(a.stop == b.start for a, b in itertools.pairwise(found))
    sizes = [(part.stop - part.start) * trials for part in found]
    assert all(size % LANES == 0 for size in sizes[:-1])
    vectors = [math.ceil(size / LANES) for size in sizes]
    step = trials // math.gcd(LANES, trials)
    assert max(vectors) - min(vectors) <= step
    # No process computes a vector that one process alone would not.
    assert sum(vectors) == math.ceil(count * trials / LANES)


def test_where_there_are_too_few_the_others_try_the_last_again():
    found = parts(20, 4)
    assert sum(part == slice(19, 20) for part in found) == 2
    assert slice(0, 16) in found and slice(16, 20) in found


def test_a_lone_process_gets_back_what_it_gives():
    genes, tree = np.ones((3, 20), np.float32), {"a": np.arange(20)}
    assert ALONE.leads
    assert ALONE.share(20) == slice(0, 20)
    assert ALONE.gather(tree, genes, 0) is tree
    assert ALONE.broadcast({"a": 3}) == {"a": np.array(3)}
    ALONE.agree("anything", b"at all")
    ALONE.leave()


def test_work_is_given_up_and_errors_come_through():
    assert finish_within(5.0, lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        finish_within(5.0, lambda: 1 // 0)
    start = time.monotonic()
    with pytest.raises(TimeoutError, match=r"not done after 0\.1 s"):
        finish_within(0.1, lambda: time.sleep(1.0))
    assert time.monotonic() - start < 0.9


@pytest.mark.parametrize(
    ("logged", "words"),
    [
        (
            "F1 client.h:80] Terminating process because the JAX distributed service detected "
            "fatal errors. absl::Status: UNAVAILABLE: The following tasks are unhealthy (stopped "
            "sending heartbeats):\n2\n5\nThe tasks have crashed.",
            "process 2, 5 is dead or stopped: no heartbeat",
        ),
        (
            "JAX distributed service: DEADLINE_EXCEEDED\n\nRPC: /xla.CoordinationService/Heartbeat",
            "process 0, the lead, does not answer",
        ),
        ("JAX distributed service: Socket closed", "process 0, the lead, is gone"),
        ("JAX distributed service: absl::Status: ODD: words\nmore", "JAX says ODD: words"),
        ("JAX distributed service", "JAX has ended the processes"),
        ("Check failed: something else", None),
    ],
)
def test_what_jax_logs_in_our_words(logged, words):
    assert lost_process(logged) == words


def run(code: str, count: int, compiled: Path, *arguments: object, lost: bool = False) -> list[str]:
    """What each of several processes prints, to which the team is known as `team`.

    Args:
        code: of each.
        count: of the processes.
        compiled: where they keep what they compile.
        arguments: that the code knows under this name.
        lost: whether one may end otherwise than well: JAX ends those that lose another one.
    """
    start = f"""
import json, os, sys, time
import jax
import numpy as np
from evo_cpg.training import processes
from evo_cpg.training.processes import Disagreement, TeamError, join
from evo_cpg.training.roll_call import Place, call_roll

index, count, port, *arguments = sys.argv[1:]
jax.config.update("jax_num_cpu_devices", 2)
place = Place(int(index), int(count), "localhost", int(port))
team = join(place, call_roll(place, {{}}, 60.0))
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
    if not lost:
        assert all(process.returncode == 0 for process in started), ends
    return ["".join(x for x in out.splitlines(True) if "[Gloo]" not in x) for out, _ in ends]


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
    part = trials(team.share(40, each), each)
    back = team.gather({n: x[..., part] for n, x in tree.items()}, genes, 3, each)
    told.append(all(back[n].tobytes() == x.tobytes() for n, x in tree.items()))
    told.append(all(back[n].dtype == x.dtype for n, x in tree.items()))

lead = {"genes": np.random.default_rng(0).random(400_000), "name": np.array("evo")}
sent = team.broadcast(lead if team.leads else None)
told.append(all(np.array_equal(sent[name], lead[name]) for name in lead))
told.append(team.broadcast({} if team.leads else None) == {})
team.agree("a thing", b"equal")
try:
    team.agree("a thing", b"equal" if index != "1" else b"other")
except Disagreement as error:
    told.append(str(error))
genes[0, 0] += index == "1"
try:
    team.gather({"a": whole["number"][team.share(40)]}, genes, 4)
except TeamError as error:
    told.append(str(error))
told.append(team.sent)
team.leave()
print(json.dumps(told))
"""


def test_two_processes_tell_each_other(tmp_path):
    for out in run(TALK, 2, tmp_path):
        told = json.loads(out)
        assert told[:6] == [True] * 6
        assert told[6] == "a thing differs between the processes: process 0 unlike 1"
        assert told[7].startswith(
            "the population of generation 4 differs between the processes: process 0 unlike 1; "
            "processors of different kinds may round differently"
        )
        # 24 individuals are the larger part; of each 4 bytes, and 8 of the digest.
        assert told[8] == 24 * 4 + 8


@pytest.mark.slow
def test_four_processes_tell_each_other(tmp_path):
    for out in run(TALK, 4, tmp_path):
        told = json.loads(out)
        assert told[:6] == [True] * 6
        assert told[6] == "a thing differs between the processes: process 0, 2, 3 unlike 1"


LATE = """
patience, late = map(float, arguments)
processes.COMPILING = 0.0
team._patience = patience
team._together(team._copy, np.zeros(100, np.uint8), "a first look")
if index == "1":
    time.sleep(late)
try:
    team._together(team._copy, np.zeros(100, np.uint8), "a second look")
except TeamError as error:
    print(error, flush=True)
else:
    team.leave()
    print("done")
sys.stdout.flush()
os._exit(0)
"""


def test_who_is_stuck_but_alive_is_not_waited_for(tmp_path):
    lead, _ = run(LATE, 2, tmp_path, 1.0, 6.0, lost=True)
    assert lead.startswith("process 0 of 2 has waited 1 s for a second look; its own took 0.0 s: ")


@pytest.mark.slow
def test_who_is_late_is_waited_for(tmp_path):
    assert run(LATE, 2, tmp_path, 120.0, 65.0) == ["done\n", "done\n"]
