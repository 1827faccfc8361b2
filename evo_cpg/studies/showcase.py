"""Showcase of bodies that evolve: how many kinds of animals move fast in the end?

Each topology is shown by its fittest plan of the last generation. It moves for 15 s. Its *speed* is
the median over the last 5 s of the velocity of its centre of mass, horizontal and along the net
displacement of these seconds. It is *straight* if this displacement is at least 90 % of the sum of
the displacements in each of these seconds. Lengths are the longest extents at rest.
"""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from evo_cpg.studies.study import Part, Runs, Table, tabled

if TYPE_CHECKING:
    from evo_cpg.analysis.diversity import Topology
    from evo_cpg.io.plans import EvolvedPlans
    from evo_cpg.studies.workshop import Workshop

# Changes to a run that lasts about 20 min on two cores, and the least speed, in lengths per second.
_CASES = {
    "water": (("virtual_creatures_water", ("evolution.generations=2000",)), 0.5),
    "land": (("virtual_creatures_land", ("evolution.generations=180",)), 0.25),
}
# Duration of a trial, and of its end that counts, s.
_SECONDS, _COUNTED = 15.0, 5.0
_STRAIGHT = 0.9
# Fittest topologies that are measured, and fastest ones that are audited.
_MEASURED, _AUDITED = 48, 12


def report(workshop: "Workshop") -> list[Table]:
    """List the topologies that are fast, straight and pass the audit, in water and on land."""
    tables = []
    for name, (_, least) in _CASES.items():
        rows = workshop.kept(
            f"kinds_{name}", [name], lambda name=name, least=least: _rows(workshop, name, least)
        )
        passed = sum(row["audit"] == "passed" for row in rows)
        title = f"{name}: {passed} topologies pass the audit beyond {least:g} lengths a second"
        tables.append(tabled(rows, title.capitalize()))
    return tables


def _rows(workshop: "Workshop", name: str, least: float) -> list[dict[str, str]]:
    """Return a row for each topology that is fast and straight."""
    from evo_cpg.api.audit import audited
    from evo_cpg.api.runs import open_champion
    from evo_cpg.io.plans import plans_of

    member = workshop.member(name)
    longer = member.config.simulation.model_copy(update={"seconds": _SECONDS})
    plans = plans_of(member.config.model_copy(update={"simulation": longer}))
    kinds, genes, fitness = _kinds(plans, member.folder.path)
    speed, straight = speeds(plans, genes)
    fast = np.flatnonzero((speed >= least) & (straight >= _STRAIGHT))
    fast = fast[np.argsort(-speed[fast])][:_AUDITED]
    opened = open_champion(member.folder.path)
    one = opened.champion
    shown = [one._replace(genes=genes[:, i], fitness=float(fitness[i])) for i in fast]
    audits = audited(opened, shown) if shown else []
    return [
        {
            "topology": in_words(kinds[i]),
            "lengths a second": f"{speed[i]:.2f}",
            "straight": f"{100 * straight[i]:.0f} %",
            "audit": "passed" if done.passed else "; ".join(done.verdict.reasons),
        }
        for i, done in zip(fast, audits, strict=True)
    ]


def _kinds(
    plans: "EvolvedPlans", folder: Path
) -> "tuple[list[Topology], Float[np.ndarray, 'g n'], Float[np.ndarray, ' n']]":
    """Return the fittest topologies of a run's last generation, with their fittest plans' genes.

    The best is first. The last of the results is the fitness.
    """
    from evo_cpg.analysis.diversity import topology_of
    from evo_cpg.training.family import read_family

    found, last = {}, read_family(folder)[-1][0]
    order = np.argsort(-last["fitness"], kind="stable")
    for i, plan in zip(order, plans.kept(last["genome"][order]), strict=True):
        if np.isfinite(last["fitness"][i]):
            found.setdefault(topology_of(plan), i)
    kinds, best = [*found][:_MEASURED], last[[*found.values()][:_MEASURED]]
    return kinds, np.asarray(plans.layout.from_bytes(best["genome"].T)), best["fitness"]


def in_words(topology: "Topology") -> str:
    """Return a topology with the axes of each joint, children in brackets: ``root(yz(z), yz)``."""
    kind, children = topology
    below = f"({', '.join(map(in_words, children))})" if children else ""
    return (kind or "root") + below


def speeds(
    plans: "EvolvedPlans", genes: Float[np.ndarray, "g n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return speeds in lengths per second, and the fraction of the path that is straight.

    Args:
        plans: plans (`evo_cpg.io.plans.EvolvedPlans`) whose trials are long enough.
        genes: genomes.
    """
    from evo_cpg.simulation.recording import Recorder
    from evo_cpg.training.devices import population_mesh
    from evo_cpg.training.evaluate import compile_plan_trials

    size, found = plans.sizes[-1], plans.developed(genes)
    common = plans.inputs(size).common
    recorder = Recorder(count=None, names=("position",))
    run = compile_plan_trials(
        dataclasses.replace(common, plans=plans), size, population_mesh(), None, recorder
    )
    each = np.arange(genes.shape[1])
    controls, values = plans.given(found, each, size)
    frames = run(controls.astype(np.float32), None, None, 1, (values,))
    mass, rate = found[2].mass[:size], common.control_rate
    # Horizontal positions of the centres of mass: control steps, two components, plans.
    path = (frames["position"][:, :2] * mass).sum(2) / mass.sum(0)
    path = path[-round(_COUNTED * rate) - 1 :]
    net = path[-1] - path[0]
    far = np.maximum(np.linalg.norm(net, axis=0), 1e-9)
    along = (np.diff(path, axis=0) * net).sum(1) * rate / far
    in_seconds = np.linalg.norm(np.diff(path[:: round(rate)], axis=0), axis=1).sum(0)
    return np.median(along, 0) / found[2].length, far / np.maximum(in_seconds, 1e-9)


PART = Part("kinds of animals that move fast after 20 minutes", tuple(_CASES), report)
RUNS = {name: Runs(*given, 1) for name, (given, _) in _CASES.items()}
