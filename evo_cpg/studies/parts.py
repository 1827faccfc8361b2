"""Parts that several studies share: audits of champions, stills, and champions near a light."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from evo_cpg.control.brain_cpg import silent_genes
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.studies.study import Part, Table, beside, middle, percent, tabled
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop

# Head of the column for each check, which shows the fraction of the displacement that is kept.
_KEPT = {
    "pose": "in other poses or draws",
    "half_step": "at half the step",
    "quarter_step": "at a quarter",
    "friction": "friction 10 % off",
    "drag": "drag 10 % off",
}


def audit_part(title: str, shown: Mapping[str, str], *, medians: bool = False) -> Part:
    """Return a part that audits the champions of runs.

    Args:
        title: title of the part.
        shown: names of the runs, by their names in tables.
        medians: add a table of medians and ranges.
    """

    def report(workshop: "Workshop") -> list[Table]:
        rows = {called: audited(workshop, name) for called, name in shown.items()}
        if not medians:
            return [audit_table("", rows)]
        return [kept_table("Medians and ranges:", rows), audit_table("Every champion:", rows)]

    return Part(title, tuple(shown.values()), report)


def audited(workshop: "Workshop", name: str, best: int | None = None) -> list[dict[str, Any]]:
    """Return a row for the audit of each champion of a run, or only of the first if quick.

    Args:
        workshop: maker of the study.
        name: name of the run.
        best: number of the fittest champions to audit, or None for all in order of seeds.
    """

    def measure() -> list[dict[str, Any]]:
        from evo_cpg.api.audit import audits
        from evo_cpg.io.run import open_run

        member = workshop.member(name)
        champions = workshop.champions(name)
        if best:
            champions = sorted(champions, key=lambda each: -each.fitness)[:best]
        champions = champions[: 1 if workshop.quick else None]
        config, source = member.config, member.source
        if member.experiment.simulation.has_own_bodies:
            run = open_run(member.folder.path)
            own = [run.of_body(champion) for champion in champions]
            made = [
                audits(one.experiment, [one.champion], config.audit.limits(), one.config, source)[0]
                for one in own
            ]
        else:
            made = audits(member.experiment, champions, config.audit.limits(), config, source)
        return [
            {
                "seed": member.experiment.seed + champion.run,
                "passed": done.verdict.passed,
                "reasons": done.verdict.reasons,
                "measured": {
                    key: value if np.isfinite(value) else None
                    for key, value in done.measured.items()
                },
                "opinions": [
                    {"program": one.program, "way": one.displacement, "upright": one.upright}
                    for one in done.opinions
                ],
            }
            for champion, done in zip(champions, made, strict=True)
        ]

    return workshop.kept(f"audit_{name}", [name], measure)


def audit_table(title: str, rows: dict[str, list[dict[str, Any]]]) -> Table:
    """Return a table with a row for each champion.

    Args:
        title: title above the table.
        rows: rows from `audited`, by the name of their runs in the table.
    """
    every = [row for found in rows.values() for row in found]
    keys = [key for key in _KEPT if any(key in row["measured"] for row in every)]
    # The first opinion is our own.
    others = [{one["program"]: one["way"] for one in row["opinions"][1:]} for row in every]
    programs = list(dict.fromkeys(program for goes in others for program in goes))
    lines = []
    names = [name for name, found in rows.items() for _ in found]
    for name, row, goes in zip(names, every, others, strict=True):
        measured = row["measured"]
        displacement = measured.get("way")
        line = {"": name, "seed": str(row["seed"])}
        line["displacement, m"] = "" if displacement is None else f"{displacement:.2f}"
        for key in keys:
            kept = measured.get(key)
            line[_KEPT[key]] = "" if kept is None else percent(kept)
        for program in programs:
            displacement = goes.get(program)
            words = "" if displacement is None else f"{displacement:.2f}"
            line[f"{program}: over ground, m"] = words
        line["passes"] = "yes" if row["passed"] else "no: " + "; ".join(row["reasons"])
        lines.append(line)
    return tabled(lines, title)


def kept_table(title: str, rows: dict[str, list[dict[str, Any]]]) -> Table:
    """Return a table with a row for each run: medians and ranges of its champions.

    The column for MuJoCo shows its last opinion, which is closest to our own simulation.
    """
    lines = []
    for name, found in rows.items():
        measured = {
            key: [row["measured"][key] for row in found if row["measured"].get(key) is not None]
            for key in ("way", *_KEPT)
        }
        fractions = {head: measured[key] for key, head in _KEPT.items()}
        fractions["in MuJoCo"] = [
            row["opinions"][-1]["way"] / row["opinions"][0]["way"]
            for row in found
            if len(row["opinions"]) > 1
        ]
        line = {"": name, "displacement, m": middle(measured["way"])}
        for head, values in fractions.items():
            line[head] = f"{middle(100 * np.array(values), 0)} %" if values else ""
        line["pass"] = f"{sum(row['passed'] for row in found)} of {len(found)}"
        lines.append(line)
    return tabled(lines, title)


# Size of each moment, pixels, and number of moments from the start of a trial to its end.
_SIZE, _MOMENTS = (480, 270), 3


def pictures_part(title: str, *shown: Mapping[str, str]) -> Part:
    """Return a part that draws the best champions of runs.

    Args:
        title: title of the part.
        shown: names of the runs by their captions, for each picture. The first picture is named
            after the part. Each further picture is named after its first run.
    """

    def report(workshop: "Workshop") -> list[Table]:
        names = ["", *(next(iter(runs.values())) for runs in shown[1:])]
        return [stills(workshop, *each) for each in zip(shown, names, strict=True)]

    return Part(title, tuple(name for runs in shown for name in runs.values()), report)


def stills(workshop: "Workshop", shown: Mapping[str, str], picture: str = "") -> Table:
    """Draw the best champion of each run in a row, and return a table of the champions.

    Args:
        workshop: maker of the study, with the runs.
        shown: names of the runs, by their captions in the picture.
        picture: name of the picture within the part, or empty for the part's own name.
    """
    from evo_cpg.training.evaluate import compile_replay
    from evo_cpg.view.film import Film, side_by_side
    from evo_cpg.view.scene import panel_of

    rows, panels = [], []
    for title, name in shown.items():
        experiment, champion = workshop.member(name).experiment, workshop.checkpoint(name).champion
        if champion is None:
            rows.append({"": title, "seed": "no champion"})
            continue
        recording = compile_replay(experiment, workshop.devices)(champion).recording
        panels.append(panel_of(experiment, recording, title))
        instants = np.linspace(recording.time[0], recording.time[-1], _MOMENTS)
        first, last = recording.distance[[0, -1]]
        lit = np.isfinite(recording.goal).all()
        rows.append(
            {
                "": title,
                "seed": str(experiment.seed + champion.run),
                "generation": str(champion.generation),
                "fitness": f"{champion.worth:.3f}",
                "distance": f"{first:.2f} to {last:.2f} m to the light" if lit else f"{last:.2f} m",
                "moments, s": ", ".join(f"{t - recording.time[0]:.1f}" for t in instants),
            }
        )
    if panels:
        path = workshop.picture(picture)
        side_by_side(panels, path, Film(_SIZE, sheet=(_MOMENTS, 1), columns=1))
    return tabled(rows)


# "Near the light": less than this fraction of the initial distance is left.
NEAR = 0.1


def light_tables(
    workshop: "Workshop", evolved: str, random: str | None = None, *more: Mapping[str, str]
) -> list[Table]:
    """Return a table with a row for each champion, then medians.

    With random search, there is also a row for an animal whose brain gives the spinal cord no
    drive. Its fitness uses the scales of the first run.

    Args:
        workshop: maker of the study, with the runs.
        evolved: name of the evolved runs.
        random: name of the runs of random search, if any.
        more: further rows.
    """
    rows, fitness = [], {}
    for title, name in (("evolved", evolved), ("random search", random)):
        if name is None:
            continue
        found, near = workshop.champions(name), workshop.column(name, "best_distance") < NEAR
        seed = workshop.member(name).experiment.seed
        for champion in found:
            under = near[:, champion.run]
            rows.append(
                {
                    "": title,
                    "seed": str(seed + champion.run),
                    "fitness": f"{champion.worth:.3f}",
                    **_terms(champion.terms),
                    "under 10 % after generation": str(under.argmax()) if under.any() else "never",
                }
            )
            title = ""
        fitness[name] = [champion.worth for champion in found]
        left = [100 * champion.terms["distance"] for champion in found]
        cells = {"fitness": middle(fitness[name], 3), "distance left": f"{middle(left, 1)} %"}
        rows.append({"": "median (range)"} | cells)
    if random is not None:
        words = beside(fitness, random)[evolved]
        rows.append({"": "evolution beats random search", "fitness": words})
        simulation = workshop.member(evolved).experiment.simulation
        silent = silent_genes(simulation.controller)[:, None]
        terms = {key: x.mean() for key, x in evaluate(simulation, silent).items()}
        scales = {key: jnp.asarray(x) for key, x in workshop.champions(evolved)[0].scales.items()}
        worth = simulation.task.fitness({key: jnp.asarray(x) for key, x in terms.items()}, scales)
        cells = {"": "no drive from the brain", "fitness": f"{float(worth):.3f}"}
        rows.append(cells | _terms(terms))
    return [tabled([*rows, *more])]


def _terms(terms: Mapping[str, float]) -> dict[str, str]:
    """Return the cells for terms of the task."""
    return {
        "distance left": percent(terms["distance"]),
        "light seen": f"{terms['light']:.2f}",
        "energy (J)": f"{terms['energy']:.0f}",
    }


def evaluate(simulation: Simulation, genes: np.ndarray) -> dict[str, np.ndarray]:
    """Evaluate animals ``(genes, n)`` in each situation without noise.

    Returns:
        Terms of the task by name, shape ``(n, situations)``. They are NaN for diverged animals.
    """
    simulation = dataclasses.replace(simulation, noise=Noise())
    count = len(simulation.situations)
    numbers = np.tile(np.arange(count), genes.shape[1]) if count > 1 else None
    outcome = compile_trials(simulation, population_mesh())(genes, None, numbers, count)
    return {
        key: np.where(outcome.alive, x, np.nan).reshape(-1, count)
        for key, x in outcome.terms.items()
    }
