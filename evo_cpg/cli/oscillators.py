"""What a user should know of a config's oscillators before they evolve: a line for each matter."""

from pathlib import Path

from evo_cpg.cli.errors import warn
from evo_cpg.control.couplings import uncoupled
from evo_cpg.control.rest import resting
from evo_cpg.simulation.simulation import Simulation


def warn_of_oscillators(path: Path, simulation: Simulation) -> None:
    """Say which oscillators are coupled to nothing or come to rest, and which keys change that.

    Args:
        path: the configuration.
        simulation: that it describes.
    """
    for line in _matters(simulation):
        warn(f"{path}: {line}")


def _matters(simulation: Simulation) -> list[str]:
    oscillators, tree = simulation.controller.rhythm_generator, simulation.world.tree
    if oscillators is None:
        return []
    cpg, network, rate_gain = oscillators
    # Others move nothing, whether they swing or not.
    driven = (tree.servo_gain > 0) | (tree.servo_stiffness > 0)
    driven = driven & (rate_gain != 0)
    gains = cpg.min_adaptation_gain, cpg.max_adaptation_gain
    alone = [i for i in uncoupled(network.matrix) if driven[i]]
    still = [i for i in resting(network, cpg.max_tonic_input, *gains) if driven[i]]
    drive = cpg.max_tonic_input + cpg.sensory_feedback
    least = 1 + network.rise_time / network.adaptation_time
    if drive <= 0:
        total = "controller.cpg.max_tonic_input + sensory_feedback"
        cure = f"{total} is {drive:g}; it must be positive"
    else:
        cure = (
            f"a pair alone swings where controller.cpg.pair_weight ({cpg.pair_weight:.3g}) is more "
            f"than {least:.3g} (constants: {cpg.constants}) and less than 1 + the adaptation gain "
            f"({gains[0]:g} to {gains[1]:g})"
        )
    couple = "controller.cpg.couplings and rings couple them"
    rest = "at rest under a constant drive"
    matters = (
        ("coupled to no other oscillator", couple, [i for i in alone if i not in still]),
        (
            f"coupled to no other oscillator, and {rest}",
            f"{couple}; {cure}",
            [i for i in alone if i in still],
        ),
        (rest, cure, [i for i in still if i not in alone]),
    )
    return [
        f"{what}: {', '.join(tree.dof_names[i] for i in who)}; {change}"
        for what, change, who in matters
        if who
    ]
