"""Tendons in YAML: copies by placeholders, bad input, keys of sweeps, traced numbers."""

import numpy as np
import pytest

from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import load_config
from evo_cpg.io.numbers import number_at, number_keys, with_numbers
from tiny_run import CONFIG, TINY

NONE = "creature.bodies.1.joint.actuator=null"
# The beginning of a tendon, with its joints.
SPAN, FIRST, GAIN = "{name: a, joints: {%s}", "segment1.x: 1", "actuator: {gain: 1}"


def loaded(*tendons: str):
    """Return the tiny swimmer without motors in its joints, with some tendons."""
    return load_config(CONFIG, [*TINY, NONE, f"creature.tendons=[{', '.join(tendons)}]"])


def built(*tendons: str):
    return build_experiment(loaded(*tendons), CONFIG).simulation


def test_placeholders_stand_for_all_joints_or_make_a_tendon_each():
    tree = built(
        "{name: whole, joints: {'segment{i}.z': 1}}",
        "{name: 'pull{i}', joints: {'segment{i}.z': 1, 'segment{i}.y': -0.5}, actuator: {gain: 2}}",
    ).world.tree
    tendons = tree.tendons
    assert tendons.names == ("whole", "pull1", "pull2")
    assert [tree.dof_names[dof] for dof in tendons.dofs] == [
        "segment1.z",
        "segment2.z",
        *("segment1.z", "segment1.y"),
        *("segment2.z", "segment2.y"),
    ]
    np.testing.assert_array_equal(tendons.coefficients, [1, 1, 1, -0.5, 1, -0.5])
    gains = dict(zip(tree.dof_names, tree.of_commands("servo_gain"), strict=True))
    assert {name for name, gain in gains.items() if gain == 2} == {"segment1.z", "segment2.z"}
    assert sum(gains.values()) == 4


def test_motors_of_tendons_command_their_own_kind():
    """The second tendon finds the first joint taken, and follows the command of the next one."""
    simulation = built(
        "{name: a, joints: {segment1.x: 1}, actuator: {type: torque, gear: 3}}",
        "{name: b, joints: {segment1.x: 1, segment2.x: 1}, limits: [-1, 2],"
        " actuator: {gain: 1, stiffness: 4}}",
    )
    tree, brain = simulation.world.tree, simulation.controller
    first, second = (tree.dof_names.index(f"segment{i}.x") for i in (1, 2))
    assert tree.tendons.channels == (first, second)
    assert np.flatnonzero(tree.torque_driven).tolist() == [first]
    assert brain.gear[first] == 3 and brain.gear[second] == 0
    assert brain.rate_gain[first] == 0 and tree.of_commands("upper")[second] == 2


@pytest.mark.parametrize(
    ("tendon", "words"),
    [
        (f"{SPAN % 'segment1.w: 1'}}}", "0.joints.*did you mean 'segment1.[xyz]'"),
        (f"{SPAN % 'segment1: 1'}}}", "'segment1' .* axis"),
        (f"{SPAN % 'segment1.x: 0'}}}", "'segment1.x' .* 0"),
        (f"{SPAN % ''}}}", "tendons.0.joints"),
        (f"{SPAN % FIRST}, rest: [2, 1]}}", "rest: 2"),
        (f"{SPAN % FIRST}, limits: [1, 1]}}", "limits: 1"),
        ("{name: 'a{j}', joints: {segment1.x: 1}}", "'a{j}'"),
        (f"{SPAN % FIRST}, actuator: {{type: muscle, area: 1}}}}", "tendons.0.actuator"),
        (f"{SPAN % FIRST}}}, {SPAN % 'segment2.x: 1'}}}", "tendons.1.name.*'a'"),
        (
            f"{SPAN % FIRST}, {GAIN}}}, {{name: b, joints: {{segment1.x: 2}}, {GAIN}}}",
            "tendons.1.actuator",
        ),
    ],
)
def test_wrong_tendons_are_refused_with_their_key(tendon, words):
    with pytest.raises(ConfigError, match=words):
        built(tendon)


def test_a_tendon_spans_no_ball():
    ball = "creature.bodies.1.joint.axes=ball", "creature.bodies.1.joint.limits_deg=null"
    given = "creature.tendons=[{name: a, joints: {segment1.ball_x: 1}}]"
    config = load_config(CONFIG, [*TINY, NONE, *ball, given])
    with pytest.raises(ConfigError, match=r"tendons\.0\.joints.*ball joint"):
        build_experiment(config, CONFIG)


def test_a_key_reaches_the_coefficient_of_a_joint():
    """Names of joint axes have a dot of their own."""
    config = loaded("{name: a, joints: {segment1.x: 1, segment2.x: -1}}")
    key = "creature.tendons.0.joints.segment2.x"
    assert key in number_keys(config)
    changed = with_numbers(config, {key: 0.25}, CONFIG)
    assert number_at(changed, key) == 0.25
    given = "creature.tendons=[{name: a, joints: {segment1.x: 1}}]", f"{key[:-10]}segment1.x=3"
    config = load_config(CONFIG, [*TINY, NONE, *given])
    assert number_at(config, "creature.tendons.0.joints.segment1.x") == 3
