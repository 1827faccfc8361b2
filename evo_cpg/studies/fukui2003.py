"""Chapter 4 of Fukui 2003: distances of the three walkers, and the loss of lineages.

Under noise, all elites of a generation may fall over by chance. A good lineage is then lost, and
the best distance of the next generations falls.

Choices that the thesis leaves open are varied, one at a time. They are the strength of the
dashpots, the time for each posture and the length of the legs. Others are the rule that combines
two restitutions, and whether a mutated gene is flipped or redrawn.
"""

import dataclasses
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy import stats

from evo_cpg.control.postures import one_posture
from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.observers import States
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.studies.parts import audit_part, pictures_part
from evo_cpg.studies.study import Part, Runs, Study, Table, beside, in_order, middle
from evo_cpg.studies.workshop import Workshop
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials

TORSO = 0.6  # m
# Indices of the leg boxes among the bodies of Model 1: upper and lower boxes alternate.
_LEGS = range(1, 9)
# A generation has fallen if its best distance is more than this fraction below the highest best
# distance of the run so far.
COLLAPSE = 0.25
HELD_ANGLE = 170.0  # degrees, one of the two allowed angles closest to straight down

MODELS = {"model1": "Model 1", "model2": "Model 2", "model3": "Model 3"}
_NOISE = ("noise.joint_angle_deg=1", "noise.tilt_deg=1", "noise.push=0.02")
_SHORT = ("evolution.generations=250",)
# Weights that configs/hexapod.yaml had before the first of these runs.
_WALK = (
    "task.type=walk",
    "task.tilt_weight=20",
    "task.bounce_weight=20",
    "task.airborne_weight=10",
)
_RANDOM = "evolution={type: random, generations: 500, population: 15}"
# Number of runs of every setting but the three models, whose eight runs are the main result. The
# long runs are three.
_FEW, _LONG = 5, 3


def _springs(factor: float) -> tuple[str, ...]:
    """Return overrides that scale springs, dampers and torque limits of Model 1 by a factor."""
    strength = {"stiffness": 150, "gain": 3, "torque_limit": 40}
    return tuple(
        f"creature.bodies.{leg}.joint.actuator.{key}={value * factor:g}"
        for leg in _LEGS
        for key, value in strength.items()
    )


def _legs(length: float) -> tuple[str, ...]:
    """Return overrides that set the length of the leg boxes of Model 1, m."""
    changes = []
    for leg in _LEGS:
        body = f"creature.bodies.{leg}"
        changes += [f"{body}.shape.size.2={length}", f"{body}.joint.child_at.2={length / 2}"]
        if leg % 2 == 0:
            changes.append(f"{body}.joint.at.2={-length / 2}")
    return tuple(changes)


def _model1(*overrides: str, count: int = _FEW) -> Runs:
    return Runs("fukui2003_model1", overrides, count)


RUNS = {
    **{model: Runs(f"fukui2003_{model}") for model in MODELS},
    "long": _model1("evolution.generations=2000", count=_LONG),
    "long_noise": _model1(*_NOISE, "evolution.generations=2000", count=_LONG),
    "single": _model1(*_NOISE, "seed=100", count=2),
    **{f"random{n}": Runs(f"fukui2003_model{n}", (_RANDOM,), _FEW) for n in (1, 2, 3)},
    **{f"walk{n}": Runs(f"fukui2003_model{n}", (*_WALK, *_SHORT), _FEW) for n in (1, 2, 3)},
    "noise_7": _model1(*_NOISE, *_SHORT),
    "noise_5": _model1(*_NOISE, *_SHORT, "evolution.elites=5"),
    "noise_copies": _model1(*_NOISE, *_SHORT, "evolution.best_copies=3"),
    "noise_trials": _model1(*_NOISE, *_SHORT, "simulation.trials=3"),
    **{f"robust{n}": Runs(f"fukui2003_model{n}_robust", (), _FEW) for n in (1, 2, 3)},
    "springs_half": _model1(*_springs(0.5)),
    "springs_double": _model1(*_springs(2.0)),
    "period": _model1("controller.period=0.3"),
    "flip": _model1("evolution.mutation=flip"),
    "restitution_average": _model1("world.ground.restitution_rule=average"),
    "restitution_min": _model1("world.ground.restitution_rule=min"),
    "legs_short": _model1(*_legs(0.18)),
    "legs_long": _model1(*_legs(0.30)),
}
_NOISES = {
    "model1": "without noise (500 generations)",
    "noise_7": "noise, 7 kept and 8 replaced",
    "noise_5": "noise, 5 kept and 10 replaced",
    "noise_copies": "noise, 7 kept and 3 copies of the best",
    "noise_trials": "noise, 7 kept, mean of 3 trials (three times the work)",
}


# Rotation of each joint at the start, rad.
HAIR = 1e-6


class Displacements(NamedTuple):
    """Horizontal displacement of the root in a trial of each champion, m.

    Turning all joints by `HAIR` first shows the chaos of the animal. Only a larger effect of half
    the step is due to the step.

    Attributes:
        own: displacement at the time step of the evolution.
        half: displacement at half the time step.
        quarter: displacement at a quarter of the time step.
        hair: displacement at the time step of the evolution, with joints turned by `HAIR` first.
    """

    own: Float[np.ndarray, " n"]
    half: Float[np.ndarray, " n"]
    quarter: Float[np.ndarray, " n"]
    hair: Float[np.ndarray, " n"]


def displacements(simulation: Simulation, genes: Float[np.ndarray, "n g"]) -> Displacements:
    """Simulate champions and return their displacements in the first situation, without noise."""

    def displacement(times: int, turned: float = 0.0) -> np.ndarray:
        def begin(state: State) -> State:
            return dataclasses.replace(state, q=state.q + turned)

        trial = dataclasses.replace(simulation, substeps=times * simulation.substeps)
        states = jax.jit(lambda g: rollout(trial, g, observers=States(), begin=begin))(genes.T)
        place = np.asarray(states.position)
        return np.linalg.norm(place[-1, :2] - place[0, :2], axis=0)

    return Displacements(displacement(1), displacement(2), displacement(4), displacement(1, HAIR))


def kept(own: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    """Return the median fraction of the displacement that champions keep, each at most 1."""
    return float(np.median(np.minimum(other / own, 1.0)))


def models(workshop: Workshop) -> list[Table]:
    """Compare the distances of the three models."""
    from evo_cpg.view.search_plots import generations_figure

    best = {title: _ends(workshop, model) for model, title in MODELS.items()}
    against = beside(best, MODELS["model2"])
    rows = [
        [name, in_order(ends), f"{np.median(ends):.2f}", f"{np.median(ends) / TORSO:.1f}",
         against[name]]
        for name, ends in best.items()
    ]  # fmt: skip
    head = ["", "best of each run, m (sorted)", "median, m", "torso lengths", "beats Model 2"]
    # The test needs values that differ.
    differ = len({value for ends in best.values() for value in ends}) > 1
    p = float(stats.kruskal(*best.values()).pvalue) if differ else 1.0
    rows.append(["all three equal (Kruskal-Wallis)", "", "", "", f"p = {p:.2g}"])
    curves = {title: workshop.column(model, _BEST) for model, title in MODELS.items()}
    workshop.draw(generations_figure(curves, _LABEL, single_runs=True))
    return [Table("", head, rows)]


def single(workshop: Workshop) -> list[Table]:
    """Show two single runs of Model 1 with noise, as in Fig. 4-5 and 4-6."""
    from evo_cpg.view.search_plots import generations_figure

    best, first = workshop.column("single", _BEST), workshop.member("single").experiment.seed
    curves = {f"seed {first + run}": best[:, run : run + 1] for run in range(best.shape[1])}
    workshop.draw(generations_figure(curves, _LABEL))
    rows = []
    for name, own in curves.items():
        falls, fraction, highest = _falls(own)
        deepest = float(np.nanmin(own[len(own) // 10 :] / highest[len(own) // 10 :]))
        cells = f"{np.nanmax(own):.2f}", f"{own[-1, 0]:.2f}", f"{falls[0]}"
        rows.append([name, *cells, f"{100 * fraction:.0f} %", f"{100 * deepest:.0f} %"])
    head = ["", "best ever, m", "best of the last generation, m", "falls", "generations fallen",
            "lowest, relative to the highest before"]  # fmt: skip
    return [Table("", head, rows)]


def halving(workshop: Workshop) -> list[Table]:
    """Compare the displacements of the champions at smaller time steps."""

    def measure() -> dict[str, list[list[float]]]:
        found = {}
        for model in MODELS:
            genes = np.stack([each.genes for each in workshop.champions(model)]).astype(np.float32)
            gone = displacements(workshop.member(model).experiment.simulation, genes)
            found[model] = [each.tolist() for each in gone]
        return found

    rows = []
    for model, gone in workshop.kept("halving", tuple(MODELS), measure).items():
        own, half, quarter, hair = (np.array(each, float) for each in gone)
        fractions = f"{100 * kept(own, half):.0f}", f"{100 * kept(own, hair):.0f}"
        rows.append([MODELS[model], *(middle(each) for each in (own, half, quarter)), *fractions])
    head = ["", "at its own step (1/240 s), m", "at half the step, m", "at a quarter, m",
            "kept at half (median), %", "kept with turned joints, %"]  # fmt: skip
    return [Table("", head, rows)]


def random(workshop: Workshop) -> list[Table]:
    """Compare the models with random search and with an animal that holds one posture."""

    def measure() -> dict[str, float]:
        found = {}
        for model in MODELS:
            simulation = workshop.member(model).experiment.simulation
            posture = one_posture(simulation.controller, HELD_ANGLE)[:, None]
            run = compile_trials(simulation, population_mesh())
            found[model] = float(run(posture).terms["distance"][0])
        return found

    held = workshop.kept("held", tuple(MODELS), measure)
    rows = []
    for model, title in MODELS.items():
        name = f"random{model[-1]}"
        own, drawn = _ends(workshop, model), _ends(workshop, name)
        words = beside({"evolved": own, "random": drawn}, "random")["evolved"]
        middling = float(np.nanmedian(workshop.column(name, "median")))
        cells = middle(own), middle(drawn), words, f"{middling:.2f}", f"{held[model]:.2f}"
        rows.append([title, *cells])
    head = ["", "evolved, m", "random search with equal evaluations, m",
            "evolution beats random search", "median random agent, m",
            "fixed posture (170 degrees), m"]  # fmt: skip
    return [Table("", head, rows)]


def walk(workshop: Workshop) -> list[Table]:
    """Compare champions evolved for distance with champions evolved to walk (section 4.3)."""
    from evo_cpg.view.search_plots import champions_figure

    rows, dots = [], {}
    for n in (1, 2, 3):
        found = {
            "run": _measured(workshop, f"walk{n}", f"model{n}"),
            "walk": _measured(workshop, f"walk{n}", f"walk{n}"),
        }
        for aim, terms in found.items():
            name = f"Model {n}, evolved to {aim}"
            cells = in_order(terms["distance"]), in_order(terms["tilt"]), middle(terms["score"], 1)
            rows.append([name, *cells])
            dots[name] = terms["tilt"], terms["distance"]
    labels = "mean tilt of the torso: 0 upright, 1 on its side, 2 on its back", "distance (m)"
    workshop.draw(champions_figure(dots, labels))
    head = [
        "",
        "distance, m (sorted)",
        "tilt (0 upright, 1 on its side, 2 on its back), sorted",
        "walk score",
    ]
    return [Table("", head, rows)]


def lineages(
    workshop: Workshop, names: dict[str, str], first: str, single_runs: bool = False
) -> list[Table]:
    """Compare the loss of lineages: the best distances ever and at the end, and the falls.

    Args:
        workshop: maker of the study.
        names: title of each setting, by the name of its runs.
        first: name of the runs that the others are compared with.
        single_runs: whether to draw a thin line for each run, too.
    """
    from evo_cpg.view.search_plots import generations_figure

    best = {name: workshop.column(name, _BEST) for name in names}
    shortest = min(map(len, best.values()))
    curves = {title: best[name][:shortest] for name, title in names.items()}
    workshop.draw(generations_figure(curves, _LABEL, single_runs=single_runs))
    ever = {name: np.nanmax(own, 0).tolist() for name, own in best.items()}
    last = {name: own[-max(len(own) // 10, 1) :] for name, own in best.items()}
    held = {name: np.median(own, 0).tolist() for name, own in last.items()}
    tests = beside(ever, first), beside(held, first)
    rows = []
    for name, title in names.items():
        falls, fraction, _ = _falls(best[name])
        rows.append(
            [
                title,
                middle(ever[name]),
                middle(held[name]),
                f"{np.median(falls):g}",
                f"{100 * fraction:.0f} %",
                *(test[name] for test in tests),
            ]
        )
    against = f"best ever: beats {names[first]}", "last tenth: beats it"
    head = ["", "best ever, m", "best of a generation, last tenth, m", "falls per run, median",
            "generations fallen", *against]  # fmt: skip
    return [Table("", head, rows)]


def alternatives(workshop: Workshop, names: dict[str, str]) -> list[Table]:
    """Compare alternatives that the thesis leaves open with the choice made here, the first.

    Args:
        workshop: maker of the study.
        names: title of each alternative, by the name of its runs.
    """
    best = {title: _ends(workshop, name) for name, title in names.items()}
    first = next(iter(best))
    against = beside(best, first)
    rows = [[name, middle(ends), in_order(ends), against[name]] for name, ends in best.items()]
    head = ["", "median (range), m", "best of each run, m (sorted)", f"beats {first}"]
    return [Table("", head, rows)]


_LABEL, _BEST = "best distance in 20 s (m)", "best_distance"


def _ends(workshop: Workshop, name: str) -> list[float]:
    """Return the final distances of the runs, m."""
    return [champion.terms["distance"] for champion in workshop.champions(name)]


def _falls(best: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Return the falls of each run, the fraction of fallen generations, and the highest so far."""
    highest = np.maximum.accumulate(np.nan_to_num(best), 0)
    fallen = best < (1 - COLLAPSE) * highest
    return (np.diff(fallen.astype(int), axis=0) == 1).sum(0), float(fallen.mean()), highest


def _measured(workshop: Workshop, world: str, name: str) -> dict[str, list[float]]:
    """Evaluate the champions of the runs ``name`` in the simulation of the runs ``world``.

    Returns:
        Distance, m, tilt and score of each champion. They are 0 for a champion that diverged.
    """

    def measure() -> dict[str, list[float]]:
        simulation = workshop.member(world).experiment.simulation
        genes = np.stack([each.genes for each in workshop.champions(name)], axis=1)
        outcome = compile_trials(simulation, population_mesh())(genes)
        terms = {key: np.where(outcome.alive, x, np.nan) for key, x in outcome.terms.items()}
        score = simulation.task.fitness(jax.tree.map(jax.numpy.asarray, terms), {})
        measured = {"distance": terms["distance"], "tilt": terms["tilt"], "score": score}
        return {key: np.nan_to_num(np.asarray(x, float)).tolist() for key, x in measured.items()}

    return workshop.kept(f"{name}_in_{world}", [name], measure)


# Titles of the settings of parts, by the names of their runs.
_LONG_NAMES = {"long": "without noise", "long_noise": "noise, 7 kept"}
_CHOICES = {
    "springs": (
        "strength of the dashpots",
        {"model1": "150 N m/rad, 3 N m s/rad, 40 N m", "springs_half": "half of all three",
         "springs_double": "twice all three"},
    ),
    "period": ("0.3 or 1/3 s for each posture", {"model1": "1/3 s", "period": "0.3 s"}),
    "mutation": ("genes flipped or redrawn", {"model1": "redrawn", "flip": "flipped"}),
    "restitution": (
        "combination of the restitutions of animal and floor",
        {"model1": "product", "restitution_average": "mean", "restitution_min": "smaller one"},
    ),
    "sizes": (
        "length of the leg boxes",
        {"model1": "0.24 m", "legs_short": "0.18 m", "legs_long": "0.30 m"},
    ),
}  # fmt: skip

STUDY = Study(
    "fukui2003",
    "Fukui 2003: the walkers",
    RUNS,
    {
        "models": Part("distances of the three models", tuple(MODELS), models),
        "long": Part("Model 1 for 2000 generations (Fig. 4-2)", tuple(_LONG_NAMES),
                     partial(lineages, names=_LONG_NAMES, first="long", single_runs=True)),
        "single": Part("two single runs of Model 1 (Fig. 4-5, 4-6)", ("single",), single),
        "halving": Part("champions at smaller time steps", tuple(MODELS), halving),
        "robust": audit_part(
            "audit of champions evolved with noise",
            {f"Model {n}": f"robust{n}" for n in (1, 2, 3)},
            medians=True,
        ),
        "random": Part(
            "comparison with random search", (*MODELS, "random1", "random2", "random3"), random
        ),
        "walk": Part("fitness that includes posture", (*MODELS, "walk1", "walk2", "walk3"), walk),
        "noise": Part("noise and the loss of lineages", tuple(_NOISES),
                      partial(lineages, names=_NOISES, first="noise_7")),
        "pictures": pictures_part(
            "moments of the best champions",
            {"Model 1": "model1", "Model 2": "model2", "Model 3": "model3",
             "Model 2, to walk": "walk2"},
        ),
        **{
            name: Part(title, tuple(names), partial(alternatives, names=names))
            for name, (title, names) in _CHOICES.items()
        },
    },
)  # fmt: skip
