"""Test whether the fast tests notice mistakes in the code: `make test-mutants`.

Each mutant is one small change by hand: a sign, a factor, a dropped term, or swapped indices. It is
made in a copy of the repository. There the tests of the changed part run up to the first failure. A
mutant that no test notices has survived, and needs a test.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]

# Patterns of files and folders that the copy of the repository leaves out.
_LEFT_OUT = (".*", "runs", "build", "dist", "_build", "__pycache__", "*.egg-info")

# pytest's exit codes.
_PASSED, _FAILED = 0, 1


class Mutant(NamedTuple):
    """One deliberate mistake in a file of the package.

    Attributes:
        file: file in the package.
        right: text that occurs once in the file.
        wrong: replacement of this text.
        tests: files in ``tests`` that should notice, separated by spaces.
    """

    file: str
    right: str
    wrong: str
    tests: str


MUTANTS = (
    Mutant(
        "native/fuse.py",
        "jax.jvp(lambda p: replay(notes, *p), (replayed,), (changes,))[1]",
        "jax.tree.map(jnp.zeros_like, found)",
        "native/test_loops.py physics/test_gradients.py",
    ),
    Mutant("native/fuse.py", "jnp.any(goes_on(x))", "jnp.all(goes_on(x))", "native/test_loops.py"),
    Mutant(
        "creature/algebra/numerics.py",
        "jnp.asarray(x) if isinstance(x, MixedArray) else x",
        "x",
        "simulation/test_batched.py",
    ),
    Mutant(
        "view/plots.py",
        "if frequency * span < _PERIODS:",
        "if frequency < 0.0:",
        "view/test_figures.py",
    ),
    Mutant(
        "physics/water/fluid.py",
        "wrench = -jnp.concatenate([moment, force])",
        "wrench = jnp.concatenate([moment, force])",
        "physics/test_water.py",
    ),
    Mutant(
        "physics/water/fluid.py",
        "pressure = 0.5 * density",
        "pressure = density",
        "physics/test_water.py",
    ),
    Mutant(
        "physics/water/fluid.py",
        "sum_of_outer_products([patch.normal], normal_factor, speed)",
        "sum_of_outer_products([patch.normal], 2 * normal_factor, speed)",
        "physics/test_water.py physics/test_swimming.py",
    ),
    Mutant(
        "physics/water/fluid.py",
        "along = jnp.sqrt(first * first + second * second",
        "along = jnp.sqrt(first * first + first * first",
        "physics/test_water.py physics/test_implicit_step.py",
    ),
    Mutant(
        "physics/water/fluid.py",
        "speed = speed * wet_fraction(patch.normal_places, pose)",
        "speed = speed * 1.0",
        "physics/test_water_surface.py",
    ),
    Mutant(
        "physics/water/force_law.py",
        "matvec(0.5 * (derivative - jnp.swapaxes(derivative, 0, 1)), moving.velocity)",
        "matvec(0.0 * (derivative - jnp.swapaxes(derivative, 0, 1)), moving.velocity)",
        "api/test_own_force_law.py",
    ),
    Mutant(
        "physics/water/force_law.py",
        "about_origin = cross(",
        "about_origin = 0 * cross(",
        "api/test_own_force_law.py",
    ),
    Mutant(
        "physics/water/force_law.py",
        "under - tree.mass",
        "tree.mass - under",
        "physics/test_water.py physics/test_implicit_step.py",
    ),
    Mutant(
        "physics/water/force_law.py",
        "self.velocity[3:] - self.stream",
        "self.velocity[3:] + self.stream",
        "physics/test_water.py physics/test_implicit_step.py",
    ),
    Mutant(
        "physics/step/equations.py",
        "jnp.concatenate([moment, cross(w, momentum[3:])])",
        "jnp.concatenate([moment, 0 * momentum[3:]])",
        "physics/test_accelerations.py physics/test_free_motion.py",
    ),
    Mutant(
        "physics/water/fluid.py",
        "bodies.h * derivative",
        "0.5 * bodies.h * derivative",
        "physics/test_implicit_step.py",
    ),
    Mutant(
        "physics/water/added_mass.py",
        "return -gyration - matvec",
        "return gyration - matvec",
        "physics/test_added_mass.py",
    ),
    Mutant(
        "physics/water/added_mass.py",
        "linear = alpha / (2 - alpha)",
        "linear = alpha / 2",
        "physics/test_added_mass.py",
    ),
    Mutant(
        "physics/water/reactive_thrust.py",
        "force = 0.5 * carried[None]",
        "force = carried[None]",
        "physics/test_reactive_thrust.py",
    ),
    Mutant(
        "physics/water/reactive_thrust.py",
        "weights = 0.5 * bodies.h",
        "weights = bodies.h",
        "physics/test_reactive_thrust.py",
    ),
    Mutant(
        "physics/water/reactive_thrust.py",
        "chain.lengths[k] / np.sqrt(12)",
        "chain.lengths[k] / 2",
        "physics/test_sections.py",
    ),
    Mutant(
        "physics/water/lift.py",
        "- broadside * sine",
        "- 0.9 * broadside * sine",
        "physics/test_lift.py",
    ),
    Mutant("physics/water/lift.py", "own = 2.0 * c", "own = c", "physics/test_lift.py"),
    Mutant(
        "physics/water/lift.py",
        "across = other * other * first",
        "across = one * one * first",
        "physics/test_lift.py",
    ),
    Mutant(
        "physics/water/buoyancy.py",
        "return fraction, -(lever / reach)[None] * stretched",
        "return fraction, (lever / reach)[None] * stretched",
        "physics/test_water_surface.py",
    ),
    Mutant(
        "physics/tree/joint_torque.py",
        "- damping * state.qd",
        "+ damping * state.qd",
        "physics/test_accelerations.py physics/test_motors_and_joints.py",
    ),
    Mutant(
        "physics/tree/joint_torque.py",
        "return torque, h * (damping + h * stiffness)",
        "return torque, h * (damping + stiffness)",
        "physics/test_implicit_step.py physics/test_motors_and_joints.py",
    ),
    Mutant(
        "physics/tree/joint_torque.py",
        "tree.servo_gain + h * tree.servo_stiffness",
        "tree.servo_gain + 0.0 * tree.servo_stiffness",
        "physics/test_implicit_step.py physics/test_motors_and_joints.py",
    ),
    Mutant(
        "physics/step/step_problem.py",
        "state.rates + 0.5 * self.h * y",
        "state.rates",
        "physics/test_walker_contacts.py",
    ),
    Mutant(
        "physics/tree/generalized.py",
        "f, body = wrench_at_parent(f, take(kin.offset, body)), np.array(tree.parents)[body]",
        "body = np.array(tree.parents)[body]",
        "physics/test_generalized.py",
    ),
    Mutant(
        "native/ldl.py",
        "left = left[:k, :k] - scaled[:, None] * row[None]",
        "left = left[:k, :k] - row[:, None] * row[None]",
        "creature/algebra/test_ldl.py",
    ),
    Mutant(
        "physics/contact/box_separation.py",
        "gap + (far - near) * climb",
        "gap",
        "physics/test_separation.py",
    ),
    Mutant(
        "physics/contact/contact.py",
        "(dynamic + more * (1.0 / (1.0 + ratio)))",
        "(dynamic + more * (1.0 - 1.0 / (1.0 + ratio)))",
        "physics/test_contact.py",
    ),
    Mutant(
        "physics/contact/contact.py",
        "bounce = expand_dims_like(contact_model.restitution, approach) * fraction * approach",
        "bounce = expand_dims_like(contact_model.restitution, approach) * fraction * approach**2",
        "physics/test_contact.py",
    ),
    Mutant(
        "physics/contact/contact.py",
        "normal_force = stiffness * jnp.maximum(short, 0.0)",
        "normal_force = stiffness * short",
        "physics/test_contact.py physics/test_walker_contacts.py",
    ),
    Mutant(
        "physics/contact/separation.py",
        "between = ~(outside | level)",
        "between = ~level",
        "physics/test_separation.py",
    ),
    Mutant(
        "physics/contact/obstacles.py",
        "own = within(placed.at, first)",
        "own = centre",
        "physics/test_obstacles.py",
    ),
    Mutant(
        "simulation/noise.py",
        "jnp.maximum(depth, 0.0)[None]",
        "jnp.minimum(depth, 0.0)[None]",
        "simulation/test_noise.py",
    ),
    Mutant(
        "creature/surface.py",
        "apart = apart | (xp.abs(gap) < _SAME_SKIN)",
        "apart = apart & (xp.abs(gap) < _SAME_SKIN)",
        "creature/test_surface.py",
    ),
    Mutant(
        "physics/contact/contact.py",
        "jnp.where(z < 0, 1.0, -1.0)",
        "jnp.where(z < 0, -1.0, 1.0)",
        "physics/test_contact.py physics/test_terrain.py",
    ),
    Mutant(
        "physics/step/equations.py",
        "state.velocity + h * root, state.qd + h * qdd",
        "state.velocity + h * root, state.qd",
        "physics/test_free_motion.py",
    ),
    Mutant(
        "physics/tree/root.py",
        "jnp.zeros_like(w), cross(v, w)",
        "jnp.zeros_like(w), cross(w, v)",
        "physics/test_accelerations.py",
    ),
    Mutant(
        "physics/tree/state.py",
        "replace(state, velocity=velocity, qd=qd).moved(tree, h)",
        "replace(state.moved(tree, h), velocity=velocity, qd=qd)",
        "physics/test_water_surface.py physics/test_free_motion.py",
    ),
    Mutant(
        "physics/step/step.py",
        "* 0.5 * (state.qd + new_state.qd)",
        "* 0.5 * (state.qd + state.qd)",
        "physics/test_motors_and_joints.py simulation/test_transport_and_slip.py",
    ),
    Mutant(
        "control/matsuoka.py",
        "adaptation_gain[None] * adaptation\n",
        "adaptation\n",
        "control/test_matsuoka.py",
    ),
    Mutant(
        "control/matsuoka.py",
        "((firing[::-1], other), (firing, own))",
        "((firing, other), (firing, own))",
        "control/test_matsuoka.py",
    ),
    Mutant(
        "control/matsuoka.py",
        "(1 / 3) * (x1 + 2 * x2 + x3 - x)",
        "(1 / 3) * (x1 + x2 + 2 * x3 - x)",
        "control/test_matsuoka.py",
    ),
    Mutant(
        "control/matsuoka.py",
        "weights[parent, child] = side * settings.child_weight",
        "weights[parent, child] = side * settings.parent_weight",
        "control/test_matsuoka.py",
    ),
    Mutant(
        "control/brain_cpg.py",
        "- centring * self._as_angle(observation.joint_angle)",
        "+ centring * self._as_angle(observation.joint_angle)",
        "control/test_brain_cpg.py",
    ),
    Mutant(
        "control/postures.py",
        "2.0 ** np.arange(self.bits_per_joint)[::-1]",
        "2.0 ** np.arange(self.bits_per_joint)",
        "control/test_postures.py",
    ),
    Mutant(
        "evolution/operators.py",
        "jnp.argsort(-jnp.where(jnp.isnan(fitness), -jnp.inf, fitness)",
        "jnp.argsort(-jnp.where(jnp.isnan(fitness), jnp.inf, fitness)",
        "evolution/test_selection.py",
    ),
    Mutant(
        "evolution/operators.py",
        "np.maximum(parents - np.arange(count), 0.0)",
        "np.maximum(parents - 1 - np.arange(count), 0.0)",
        "evolution/test_selection.py evolution/test_generation.py",
    ),
    Mutant(
        "evolution/genetics.py",
        "np.maximum(places - (best_copies - 1), 0)",
        "np.maximum(places - best_copies, 0)",
        "evolution/test_generation.py evolution/test_bits.py",
    ),
    Mutant(
        "evolution/operators.py",
        "(pairs,), 1, max(count, 2))",
        "(pairs,), 0, max(count, 2))",
        "evolution/test_variation.py",
    ),
    Mutant(
        "evolution/operators.py",
        "left_out = jnp.floor(",
        "left_out = jnp.ceil(",
        "evolution/test_variation.py",
    ),
    Mutant(
        "evolution/operators.py",
        "number_key, (individuals,), fewest, most + 1)",
        "number_key, (individuals,), fewest, most)",
        "evolution/test_bits.py",
    ),
    Mutant(
        "evolution/operators.py",
        "place = jnp.where(taken, last[i], drawn[i])",
        "place = drawn[i]",
        "evolution/test_bits.py",
    ),
    Mutant(
        "simulation/sensors.py",
        "jnp.minimum(angle / field_of_view, 0.5)",
        "jnp.minimum(angle / (2 * field_of_view), 0.5)",
        "simulation/test_sensors.py",
    ),
    Mutant(
        "simulation/sensors.py",
        "pressing = world.water.density * world.gravity",
        "pressing = world.water.density",
        "simulation/test_sensors.py",
    ),
    Mutant(
        "simulation/sensors.py",
        "surface - own - lever.sum(0)",
        "surface - own + lever.sum(0)",
        "simulation/test_sensors.py",
    ),
    Mutant(
        "simulation/tasks.py", "final / tally.start_distance", "final", "simulation/test_trials.py"
    ),
    Mutant(
        "simulation/tasks.py",
        "last = step >= steps - min(self.final_steps, steps)",
        "last = step > steps - min(self.final_steps, steps)",
        "simulation/test_trials.py",
    ),
    Mutant(
        "simulation/tasks.py",
        "tally.tilt + 2.0 * (x * x + y * y)",
        "tally.tilt + 2.0 * (x * x)",
        "simulation/test_walk.py",
    ),
    Mutant(
        "simulation/tasks.py",
        "tally.squared_rise / steps - mean * mean",
        "tally.squared_rise / steps",
        "simulation/test_walk.py",
    ),
    Mutant("simulation/noise.py", "np.sqrt(duration)", "duration", "simulation/test_noise.py"),
    Mutant(
        "simulation/noise.py",
        "1.0 + noise.friction * draw",
        "1.0 + 0.5 * noise.friction * draw",
        "simulation/test_noise.py",
    ),
    Mutant(
        "simulation/judge.py",
        "energy <= rules.power * duration",
        "energy <= rules.power",
        "simulation/test_rules.py",
    ),
    Mutant(
        "simulation/judge.py",
        "valid &= ~deep.any(0)",
        "valid &= ~deep.all(0)",
        "simulation/test_rules.py",
    ),
    Mutant(
        "simulation/control_step.py",
        "mean + fraction * force",
        "mean + force",
        "simulation/test_transport_and_slip.py simulation/test_trials.py",
    ),
    Mutant(
        "control/brain.py",
        "jax.nn.sigmoid(activation / brain.temperature)",
        "jax.nn.sigmoid(activation)",
        "control/test_brain.py",
    ),
    Mutant(
        "control/brain.py",
        "*blocks, bias = jnp.split(table, [*cuts, count], axis=1)",
        "bias, *blocks = jnp.split(table, [1, *(1 + c for c in cuts)], axis=1)",
        "control/test_brain.py",
    ),
    Mutant(
        "control/matsuoka.py",
        "drive = tonic_input + network.constant_input",
        "drive = tonic_input",
        "control/test_matsuoka.py",
    ),
    Mutant(
        "control/matsuoka.py",
        "return extensor - flexor",
        "return extensor + flexor",
        "control/test_matsuoka.py",
    ),
    Mutant(
        "evolution/operators.py",
        "jnp.arange(count)[:, None] < cut[None]",
        "jnp.arange(count)[:, None] <= cut[None]",
        "evolution/test_variation.py",
    ),
    Mutant(
        "evolution/operators.py",
        "noise = sigma * jax.random.normal(",
        "noise = sigma**2 * jax.random.normal(",
        "evolution/test_variation.py",
    ),
    Mutant(
        "evolution/genetics.py",
        "children = children[:, 2 * pairs - self.population :]",
        "children = children[:, : self.population]",
        "evolution/test_bits.py",
    ),
    Mutant(
        "evolution/operators.py",
        "values = 1.0 - changed.get(",
        "values = 0.0 * changed.get(",
        "evolution/test_bits.py",
    ),
    Mutant(
        "physics/step/world.py",
        "mu.reshape(-1, *axes) * factor",
        "mu.reshape(-1, *axes) + 0 * factor",
        "simulation/test_noise.py api/test_audit.py",
    ),
    Mutant(
        "evolution/map_elites.py",
        "number = jnp.maximum(filled.sum(), 1)",
        "number = self.cells",
        "evolution/test_strategies.py",
    ),
    Mutant(
        "analysis/energy.py",
        "push_out = h * (local[2] * risen).sum(0)",
        "push_out = h * (local[2] * jnp.maximum(contacts.rest_velocity, 0.0)).sum(0)",
        "api/test_audit.py",
    ),
    Mutant(
        "analysis/excursions.py",
        "turns, (1.0, -1.0), strict=True",
        "turns, (1.0, 1.0), strict=True",
        "analysis/test_overlap.py",
    ),
    Mutant(
        "analysis/chains.py",
        "signs[dof] = -1.0 if",
        "signs[dof] = 1.0 if",
        "analysis/test_gait_numbers.py",
    ),
)


def main(chosen: list[int]) -> int:
    """Try mutants, print each verdict, and return the number of survivors.

    Args:
        chosen: numbers of mutants, from 0, or none for all.
    """
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*_LEFT_OUT))
        for number in chosen or range(len(MUTANTS)):
            mutant = MUTANTS[number]
            path = copy / "evo_cpg" / mutant.file
            text = path.read_text()
            path.write_text(mutated(mutant, text))
            start = time.monotonic()
            verdict = noticed(copy, mutant.tests.split())
            path.write_text(text)
            survivors += verdict.startswith("SURVIVED")
            print(
                f"{number:3d}  {verdict:<60}  {time.monotonic() - start:4.0f} s  "
                f"{mutant.file}: {mutant.wrong.strip()}",
                flush=True,
            )
    print(f"{survivors} survived")
    return survivors


def mutated(mutant: Mutant, text: str) -> str:
    """Return the file's text with the mistake.

    Raises:
        ValueError: the right text is missing, or occurs several times.
    """
    count = text.count(mutant.right)
    if count != 1:
        raise ValueError(
            f"{mutant.file} contains {mutant.right!r} {count} times, not once. Correct the mutant"
        )
    return text.replace(mutant.right, mutant.wrong)


def noticed(copy: Path, tests: list[str]) -> str:
    """Run tests on a mutant: a copy of the program with a mistake.

    Returns:
        "caught by" and the first failed test, or "SURVIVED" and the files of tests.

    Raises:
        RuntimeError: the tests could not run.
    """
    options = ["-q", "-x", "-n", "0", "-p", "no:cacheprovider", "-rfE", "--tb=no"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, *(f"tests/{name}" for name in tests)],
        cwd=copy,
        env=os.environ | {"PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
    )
    if done.returncode == _PASSED:
        return f"SURVIVED {' '.join(tests)}"
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    if done.returncode != _FAILED or not failed:
        raise RuntimeError(done.stdout + done.stderr)
    return "caught by " + failed[0].split(" - ")[0].split("::", 1)[-1]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "numbers", nargs="*", type=int, help="numbers of mutants, from 0, default: all"
    )
    sys.exit(bool(main(parser.parse_args().numbers)))
