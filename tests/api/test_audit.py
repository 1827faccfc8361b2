"""An audit flags one planted exploit for each check, and passes honest animals."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import evo_cpg.physics.step.step
from benchmarks.mujoco_model import mujoco_model
from creatures import STRUCTURES, hinge, quick_jit, random_creature, random_state
from evo_cpg.analysis.energy import ledger, mechanical_energy
from evo_cpg.analysis.excursions import excursions
from evo_cpg.analysis.second_opinion import Opinion
from evo_cpg.analysis.verdict import Verdict
from evo_cpg.api.audit import compile_steps, draws_of
from evo_cpg.api.audit_checks import (
    AuditedTrial,
    books,
    carried_by_flow,
    displacement_checks,
    opinion_checks,
)
from evo_cpg.creature.creature import Actuator, Body, Creature, LightSensor, Material
from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.creature.shapes import Box, Ellipsoid
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models.mujoco_state import load_state
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.contact.pairs import make_pairs
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.physics.step.world import World
from evo_cpg.physics.water.water import Current, Water
from evo_cpg.simulation.limits import Limits
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.observers import EachPhysicsStep
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.sensors import place_sensors
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.snapshot import Snapshot
from evo_cpg.simulation.tasks import Distance
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.conditions import Variation, Varied, compile_variation, limp
from trials import SineController, experiment

# Gains of 5 % a step, and a push of 2 cm/s.
_MORE, _PUSH = 1.05, 0.02


def champion(energy: float = 1.0) -> Champion:
    terms = {"energy": energy, "distance": 0.9, "light": 0.1}
    return Champion(np.array([2.0, 1.5], np.float32), 0.0, 0, terms, {"energy": 1.0})


def failed(found, **limits) -> set[str]:
    """Return the keys of the failed checks."""
    made, trials = found
    checks = books(made, champion(), trials, Limits(**limits))
    return {check.key for check in checks if check.passed is False}


def walker(slope=0.0, height=0.0, light=None, short=False):
    """Return a row of three boxes on a plane. A wave drives the outer boxes, which may overlap.

    In a short row, the outer boxes touch in the middle of the third box.
    """
    flesh = Material(500.0, 0.0, 0.6, 0.6)
    motor = Actuator(2.0, 5.0)

    def segment(name, parent):
        behind = 0.11 if not short else 0.1 if parent == "head" else 0.0
        ahead = 0.11 if not short else 0.1 if name == "b" else 0.0
        joint = hinge(parent, (-behind, 0, 0), (ahead, 0, 0), "z", 3.0, actuator=motor)
        return Body(name, Box((0.2, 0.1, 0.1)), flesh, joint)

    bodies = Body("head", Box((0.2, 0.1, 0.1)), flesh), segment("a", "head"), segment("b", "a")
    eye = LightSensor("head", (0.1, 0, 0), (1.0, 0, 0), 2 * np.pi)
    creature = Creature("row", bodies, (eye,))
    tree = build_tree(creature)
    normal = np.sin(slope), 0.0, np.cos(slope)
    floor = Ground(0.0, 0.6, 0.6, floor=Plane(normal))
    base = experiment(steps=40)
    simulation = dataclasses.replace(
        base.simulation,
        world=World(tree, 9.81, contact_model=make_contact_model(creature, tree, floor)),
        sensors=place_sensors(creature, tree),
        controller=SineController(),
        task=Distance(),
        substeps=4,
        situations=(Situation((0.0, 0.0, 0.05 + height), light=light),),
    )
    return base._replace(creature=creature, simulation=simulation)


@pytest.fixture(scope="module")
def honest():
    """Return a row that crawls on level ground, under a light."""
    made = walker(light=(2.0, 0.0, 0.5))
    return made, compile_steps(made)(champion())


@pytest.fixture(scope="module")
def swimming():
    """Return the two-body swimmer of `trials`, in water."""
    made = experiment(steps=60)
    return made, compile_steps(made)(champion())


def test_energy_equals_mujocos():
    """Kinetic and potential energy of bodies, rotors and springs agree, up to a constant."""
    with jax.enable_x64(True):
        rng = np.random.default_rng(3)
        creature = random_creature(rng, STRUCTURES[2], axes_seed=2)
        tree = build_tree(creature)
        model = mujoco_model(creature)
        model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        data, states = mujoco.MjData(model), random_state(tree, rng, (4,))
        theirs = []
        for n in range(4):
            load_state(model, data, tree, jax.tree.map(lambda x, n=n: x[..., n], states))
            mujoco.mj_forward(model, data)
            theirs.append(data.energy.sum())
        world = World(tree, 9.81)
        ours = quick_jit(lambda s: mechanical_energy(Snapshot(world, 1.0, s)))(states)
    np.testing.assert_allclose(np.diff(ours), np.diff(theirs), rtol=1e-9)


@pytest.mark.slow
def test_unaccounted_energy_vanishes_with_the_step(swimming):
    """A quarter of the step reduces the unaccounted energy by a factor of 3 or more, in float64."""
    made, _ = swimming
    errors = []
    for times in (1, 4):
        own = made.simulation
        simulation = dataclasses.replace(own, substeps=times * own.substeps)
        with jax.enable_x64(True):
            genes = jnp.asarray(champion().genes, jnp.float64)[:, None]
            steps = jax.device_get(
                quick_jit(
                    lambda g, simulation=simulation: rollout(
                        simulation, g, observers=EachPhysicsStep()
                    )
                )(genes)
            )
        found = ledger(simulation.world, steps, simulation.step_length)
        assert found.effort > 0.01
        errors.append(np.abs(np.cumsum(found.left_over)).max() / found.effort)
    assert errors[1] < errors[0] / 3 < 0.02


@pytest.mark.slow
def test_honest_animals_pass(honest, swimming):
    assert failed(honest) == set()
    assert failed(swimming) == set()


@pytest.mark.slow
def test_energies_are_relative_to_the_motors_work(honest):
    made, (trial,) = honest
    checks = {check.key: check for check in books(made, champion(), (trial,), Limits())}
    rate = (trial.steps.before.qd + trial.steps.after.qd) / 2
    spent = np.abs((trial.steps.torque * rate).sum(0)).sum() * made.simulation.step_length
    lifted = trial.ledger.push_out.sum()
    assert checks["push_out_energy"].measured == pytest.approx(lifted / spent, rel=1e-4)
    # Each stretch is a quarter of a second.
    gain = np.maximum(np.add.reduceat(trial.ledger.left_over, [0, 60, 120]), 0.0).sum()
    assert checks["simulator_energy"].measured == pytest.approx(gain / spent, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("cheat", ["energy", "momentum"])
def test_a_solver_that_adds_energy_or_momentum_is_flagged(monkeypatch, cheat):
    """Two wrong solvers: one lets velocities grow by 5 % a step, one pushes without a force."""
    right = evo_cpg.physics.step.step.integrate

    def wrong(tree, state, root, qdd, h):
        new = right(tree, state, root, qdd, h)
        if cheat == "energy":
            return dataclasses.replace(new, velocity=_MORE * new.velocity, qd=_MORE * new.qd)
        return dataclasses.replace(new, velocity=new.velocity.at[3].add(_PUSH))

    monkeypatch.setattr(evo_cpg.physics.step.step, "integrate", wrong)
    made = experiment(steps=60)
    assert f"simulator_{cheat}" in failed((made, compile_steps(made)(champion())))


@pytest.fixture(scope="module")
def buried():
    """Return a row that starts in the ground. Its light also lies in the ground."""
    made = walker(height=-0.05, light=(2.0, 0.0, -0.5))
    return made, compile_steps(made)(champion())


@pytest.mark.slow
def test_a_start_in_the_ground_is_flagged(buried):
    """The push-out lifts the animal: depth, and energy that no motor spent."""
    assert {"penetration", "push_out_energy"} <= failed(buried, push_out_energy=0.01)


@pytest.mark.slow
def test_the_push_out_does_not_lift_a_standing_animal():
    """The contact force of a resting point balances its weight, so the point does not move."""
    made = walker()
    still = champion()._replace(genes=np.zeros(2, np.float32))
    (trial,) = compile_steps(made)(still)
    weight = 9.81 * made.creature.mass
    assert trial.steps.contact_force[2].sum(0).mean() == pytest.approx(weight, rel=0.05)
    # The total lift is less than a hundredth of a millimetre.
    assert 0.0 <= trial.ledger.push_out.sum() < 1e-5 * weight


@pytest.mark.parametrize("source", ["limbs", "limits"])
@pytest.mark.slow
def test_a_constraint_that_adds_energy_is_flagged(honest, source):
    made, (trial,) = honest
    (key,) = {"limbs": ["limb_energy"], "limits": ["limit_energy"]}[source]
    assert not {"limb_energy", "limit_energy"} & failed(honest)
    for share in (0.1, -0.1):
        work = np.zeros_like(trial.ledger.motors)
        work[:2] = 0.5 * share * trial.ledger.effort
        given = trial._replace(ledger=trial.ledger._replace(**{source: work}))
        assert (key in failed((made, (given,)))) == (share > 0)


def test_limits_scale_with_the_animals_length():
    large, small, given = Limits().of_length(1.0), Limits().of_length(0.03), Limits(speed=3.0)
    assert (large.penetration, large.overlap) == (0.01, 0.01)
    assert (small.penetration, small.overlap) == pytest.approx((6e-4, 6e-4))
    # A cockroach runs 50 of its lengths a second.
    assert large.speed == pytest.approx(19.8, abs=0.05)
    assert 50 < small.speed < 150
    assert given.of_length(1.0).speed == 3.0


def checks_of(made, own, pose, limp_way, carried=0.0):
    """Return checks of displacements in other poses and with limp motors, one for each draw."""
    kept = {
        key: (Variation("", (simulation,), len(part)), Varied(part, part, np.isfinite(part), {}))
        for key, simulation, part in (
            ("pose", made.simulation, np.array(pose)),
            ("limp_way", limp(made.simulation), np.array(limp_way)),
        )
    }
    checks = displacement_checks(own, kept, Limits(), made.creature, carried)
    return {check.key: check for check in checks}


@pytest.mark.parametrize(
    ("own", "limp_way", "carried", "share"),
    [
        (3.0, 0.6, 0.0, 0.2),
        # A limp animal lags behind the water.
        (6.0, 0.9, 3.0, 0.0),
        (6.0, 3.6, 3.0, 0.2),
        # An animal that only drifts goes as far without motors.
        (3.0, 2.9, 3.0, 1.0),
        # The animal swims against the current.
        (1.0, -2.0, -3.0, 0.0),
        (1.0, 1.0, -3.0, 0.25),
    ],
)
def test_the_limp_motor_check_subtracts_the_current(swimming, own, limp_way, carried, share):
    found = checks_of(swimming[0], own, [own], [limp_way], carried)
    assert found["limp_way"].measured == pytest.approx(share)


def test_an_animal_that_stays_in_fresh_draws_keeps_no_displacement(swimming):
    found = checks_of(swimming[0], 3.0, [0.0, 0.0], [0.0, 0.0])
    assert found["pose"].measured == found["limp_way"].measured == 0.0


@pytest.mark.parametrize(("surface", "carried"), [(None, -0.5), (1.0, -0.5), (-1.0, 0.0)])
def test_the_current_carries_an_animal_by_speed_times_duration(swimming, surface, carried):
    """The current carries an animal away from its light. Above the water it carries nothing."""
    made, (trial,) = swimming
    flow = carried / made.simulation.duration or -1.0
    water = Water(1000.0, surface, (Current((flow, 0.0, 0.0)),))
    world = dataclasses.replace(made.simulation.world, water=water)
    place = tuple(trial.steps.before.position[:, 0] + [9.0, 0.0, 0.0])
    situation = made.simulation.situations[0]._replace(light=place)
    simulation = dataclasses.replace(made.simulation, world=world, situations=(situation,))
    made = made._replace(simulation=simulation)
    assert carried_by_flow(made, (trial,)) == pytest.approx(carried, abs=1e-6)


def opinion(end, upright=1.0, program="evo_cpg") -> Opinion:
    """Return an outcome whose root ends at a place of the x-y plane."""
    path = np.array([(0.0, 0.0, 0.0), (*end, 0.0)]).T
    return Opinion(program, path, upright, 0.0, np.zeros((1, 1)), np.zeros(1, bool))


SOFT, HARD = "MuJoCo", "MuJoCo, hard contacts"
OWN = opinion((2.0, 0.0))
LIGHT = {"light": (4.0, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("others", "diverged", "changed", "confirmed", "words"),
    [
        ([opinion((1.42, 0), program=SOFT), opinion((0.26, 0), 0.3, HARD)], [], {}, True,
         f"{SOFT} 71 %; {HARD} (upright 30 % of the time) 13 %"),
        ([opinion((0.9, 0), program=SOFT), opinion((0.26, 0), program=HARD)], [], {}, False,
         f"not confirmed, because no second opinion keeps half of its displacement: {SOFT} 45 %; "
         f"{HARD} 13 %"),
        # One in which the animal diverges keeps nothing.
        ([opinion((0.9, 0), program=SOFT)], [HARD], {}, False, f"{HARD} diverged; {SOFT} 45 %"),
        ([], [SOFT, HARD], {}, False, f"{SOFT} diverged; {HARD} diverged"),
        ([opinion((np.nan, 0), program=SOFT)], [], {}, False, f"{SOFT} diverged"),
        # Backwards. The direction counts if the task or a light sets it.
        ([opinion((-2.0, 0), program=SOFT)], [], {"heading": "any"}, True, f"{SOFT} 100 %"),
        ([opinion((-2.0, 0), program=SOFT)], [], {"heading": "forward"}, False, f"{SOFT} 0 %"),
        ([opinion((-2.0, 0), program=SOFT)], [], LIGHT, False, f"{SOFT} 0 %"),
        ([opinion((3.0, 0), program=SOFT)], [], {}, True, f"{SOFT} 100 %"),
        ([], [], {}, None, ""),
    ],
)  # fmt: skip
def test_second_opinions_confirm_a_champion(others, diverged, changed, confirmed, words):
    made = walker(light=changed.get("light"))
    task = Distance(heading=changed.get("heading", "any"))
    made = made._replace(simulation=dataclasses.replace(made.simulation, task=task))
    opinions = (OWN, *others) if others else ()
    verdict = Verdict(tuple(opinion_checks(made, opinions, diverged)))
    assert verdict.passed and verdict.confirmed is confirmed
    assert verdict.confirmation.endswith(words) and bool(words) == bool(verdict.confirmation)


def test_second_opinions_of_a_still_animal_say_nothing():
    made = walker()
    checks = opinion_checks(made, (opinion((0.01, 0)), opinion((0.0, 0), program=SOFT)), [])
    assert Verdict(tuple(checks)).confirmed is None


@pytest.mark.slow
def test_torque_above_the_limit_is_flagged(honest):
    made, trials = honest
    tree = made.simulation.world.tree
    weaker = dataclasses.replace(tree, torque_limit=0.1 * tree.torque_limit)
    simulation = eqx.tree_at(lambda s: s.world.tree, made.simulation, weaker)
    weaker = made._replace(simulation=simulation)
    assert "overload" in failed((weaker, judged(weaker, trials)))


def judged(made, trials) -> tuple[AuditedTrial, ...]:
    """Return the trials, with excursions computed in another simulation."""
    found = [(t, excursions(made.simulation, made.creature, t.steps)) for t in trials]
    return tuple(trial._replace(excursions=each) for trial, each in found)


def test_energy_above_the_cap_is_flagged(swimming):
    made, trials = swimming
    checks = {c.key: c for c in books(made, champion(energy=1.5), trials, Limits())}
    assert checks["free_energy"].passed is False
    assert checks["free_energy"].measured == pytest.approx(0.5)


@pytest.mark.slow
def test_limp_motors_slide_down_a_slope_but_not_on_level_ground():
    """Motors hardly matter on a slope of 40 degrees."""

    def kept(made) -> float:
        """Return the displacement with limp motors, as a fraction."""
        own, without = (
            compile_variation(made, Variation("", (simulation,)))(champion()).displacement[0]
            for simulation in (made.simulation, limp(made.simulation))
        )
        return without / own

    assert kept(walker(slope=0.7)) > 0.5
    assert kept(walker()) < 0.1


def bent(made, trial, angles) -> AuditedTrial:
    """Return the trial with other joint angles."""
    after = eqx.tree_at(lambda state: state.q, trial.steps.after, angles)
    (found,) = judged(made, (trial._replace(steps=trial.steps._replace(after=after)),))
    return found


def folded(made, trial):
    """Return the trial with the hindmost box turned into the foremost."""
    return (bent(made, trial, np.full_like(trial.steps.after.q, 2.9)),)


def test_overlapping_limbs_are_flagged(honest):
    """The hindmost box is inside the foremost, because no contact separates them."""
    made, (trial,) = honest
    assert trial.excursions.overlap == 0
    trials = folded(made, trial)
    assert "overlap" in failed((made, trials))
    assert set(trials[0].excursions.overlapping) == {"head", "b"}


def test_overlap_uses_ellipsoids_not_the_boxes_around_them(honest):
    """The ellipsoids are 11 mm apart, but the boxes around them overlap by 20 mm."""
    made, (trial,) = honest
    radii = {"head": 0.1, "a": 0.1, "b": 0.06}
    bodies = (
        dataclasses.replace(body, shape=Ellipsoid((radii[body.name], 0.03, 0.03)))
        for body in made.creature.bodies
    )
    rounded = made._replace(creature=dataclasses.replace(made.creature, bodies=tuple(bodies)))
    angles = np.radians(np.tile([[130.0], [110.0]], trial.steps.after.q.shape[1]))
    assert angles.shape[1] > 100
    assert bent(rounded, trial, angles).excursions.overlap == 0.0
    # In one step, the tip of the hindmost body is in the middle of the foremost, although the
    # overlap of the boxes is smaller.
    angles[:, 70] = np.radians([120.0, 150.0])
    found = bent(rounded, trial, angles).excursions
    assert found.overlap == pytest.approx(0.03 + 0.06 - (0.22 * np.sqrt(0.75) - 0.11), abs=1e-5)
    assert set(found.overlapping) == {"head", "b"}


@pytest.mark.slow
def test_limbs_that_touch_at_rest_are_checked_only_with_self_collision():
    made = walker(short=True)
    (trial,) = folded(made, *compile_steps(made)(champion()))
    checks = {check.key: check for check in books(made, champion(), (trial,), Limits())}
    left_out = "not checked, because they touch in the neutral pose: head and b"
    assert (checks["overlap"].measured, checks["overlap"].detail) == (0, left_out)
    world = made.simulation.world
    pair = SelfCollision(include=(("head", "b"),))
    world = dataclasses.replace(world, pairs=make_pairs(made.creature, world.tree, pair))
    apart = made._replace(simulation=dataclasses.replace(made.simulation, world=world))
    (trial,) = folded(apart, trial)
    checks = {check.key: check for check in books(apart, champion(), (trial,), Limits())}
    assert checks["overlap"].passed is False
    assert sorted(checks["overlap"].detail.split(" in ")) == ["b", "head"]


@pytest.mark.slow
def test_a_swimmer_above_a_floor_is_not_airborne():
    """A swimmer under water is not airborne. A swimmer above a pool is airborne."""
    made = walker(height=0.5)
    (trial,) = compile_steps(made)(champion())
    steps = trial.steps._replace(contact_force=0 * trial.steps.contact_force)
    for surface, share in ((2.0, 0.0), (-2.0, 1.0)):
        world = dataclasses.replace(made.simulation.world, water=Water(1000.0, surface))
        wet = made._replace(simulation=dataclasses.replace(made.simulation, world=world))
        (found,) = judged(wet, (trial._replace(steps=steps),))
        assert found.excursions.airborne_way == pytest.approx(share)


@pytest.mark.slow
def test_light_seen_through_the_ground_is_flagged(honest, buried):
    """One light lies in the ground, and another light above it."""
    for found, share in ((buried, 1.0), (honest, 0.0)):
        (trial,) = found[1]
        assert trial.excursions.seen_through_ground == share
        assert ("seen_through_ground" in failed(found)) == (share > 0)


def test_fast_and_airborne_gaits_are_flagged(honest):
    """The root moves at 50 m/s, in the air."""
    made, (trial,) = honest
    after = trial.steps.after
    displacement = 50 * np.arange(1, after.q.shape[1] + 1) * made.simulation.step_length
    place = after.position + displacement * np.eye(3)[0][:, None]
    velocity = after.velocity + 50 * np.eye(6)[3][:, None]
    fast = eqx.tree_at(lambda state: (state.position, state.velocity), after, (place, velocity))
    steps = trial.steps._replace(after=fast, contact_force=0 * trial.steps.contact_force)
    assert {"speed", "airborne_way"} <= failed((made, judged(made, (trial._replace(steps=steps),))))


def test_each_recorded_step_begins_where_the_previous_ended(honest, swimming):
    for _, (trial,) in (honest, swimming):
        steps = trial.steps
        for one, other in zip(
            jax.tree.leaves(steps.before), jax.tree.leaves(steps.after), strict=True
        ):
            np.testing.assert_array_equal(one[..., 1:], other[..., :-1])
        assert np.isfinite(steps.torque).all() and np.abs(steps.torque).max() > 0


@pytest.mark.slow
def test_noisy_displacements_are_means_over_equal_fresh_draws(swimming):
    """A champion was selected partly for its luck, so comparisons use fresh draws of the noise."""
    made = swimming[0]._replace(trials=2)
    noisy = dataclasses.replace(made.simulation, noise=Noise(joint_angle=0.3, push=0.3))
    made = made._replace(simulation=noisy)
    assert draws_of(noisy) == 16 and draws_of(swimming[0].simulation) == 1
    worlds = (noisy.world.with_drag(factor) for factor in (1.0, 0.5))
    sims = tuple(dataclasses.replace(noisy, world=world) for world in worlds)
    place = Variation("", sims, 16)
    drawn = compile_variation(made, place)(champion())
    again = compile_variation(made, Variation("", (noisy,), 16))(champion())
    assert len(np.unique(drawn.displacement[:16])) == 16
    np.testing.assert_allclose(drawn.displacement[:16], again.displacement, rtol=1e-3, atol=1e-5)
    means = drawn.mean_displacements(place)
    assert means == pytest.approx([drawn.displacement[:16].mean(), drawn.displacement[16:].mean()])
    # Halving the drag changes the displacement in each draw by less than the noise does.
    change = drawn.displacement[16:] - drawn.displacement[:16]
    assert np.abs(change / drawn.displacement[:16]).max() > 1e-3
    assert change.std() < 0.5 * drawn.displacement[:16].std()
    dead = drawn._replace(alive=np.zeros(32, bool))
    assert dead.mean_displacements(place).tolist() == [0.0, 0.0]


def test_changes_of_missing_water_or_ground_are_refused(honest, swimming):
    with pytest.raises(ValueError, match="no water, so drag cannot be scaled"):
        honest[0].simulation.world.with_drag(1.1)
    with pytest.raises(ValueError, match="no ground, so friction cannot be scaled"):
        swimming[0].simulation.world.with_friction(1.1)


def test_checks_that_do_not_apply_are_left_out(honest, swimming):
    """There are no ground checks without ground, and no airborne check under water."""

    def keys(found, trials):
        return {check.key for check in books(found, champion(), trials, Limits())}

    of_ground = {
        "penetration",
        "push_out_energy",
        "airborne_way",
        "slipping",
        "seen_through_ground",
    }
    made, trials = swimming
    assert not of_ground & keys(made, trials)
    # Two bodies on a hinge cannot collide, and these motors have no limit.
    assert not {"limb_energy", "overlap"} & keys(made, trials)
    walking, steps = honest
    on_land = keys(walking, steps)
    assert of_ground <= on_land and {"overlap", "overload"} <= on_land
    world = walking.simulation.world
    for surface, flies in ((None, False), (2.0, True)):
        water = dataclasses.replace(world, water=Water(1000.0, surface))
        simulation = dataclasses.replace(walking.simulation, world=water)
        wet = keys(walking._replace(simulation=simulation), steps)
        assert ("airborne_way" in wet) == flies and "penetration" in wet
    dark = walker()
    assert "seen_through_ground" not in keys(dark, steps)
