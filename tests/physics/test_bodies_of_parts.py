"""Bodies of several shapes, without a shape, and with mass and inertia in numbers."""

import copy
import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from creatures import in_water, mujocos_accelerations, quick_jit, random_state, slope
from evo_cpg.creature.creature import Creature, lowest_height
from evo_cpg.creature.limbs import limbs
from evo_cpg.creature.self_collision import SelfCollision, colliding_pairs
from evo_cpg.creature.slender import slender_chains
from evo_cpg.creature.surface import outer_surfaces
from evo_cpg.creature.tree import Tree, build_tree, spatial_inertia
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.schema.creature import CreatureConfig
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.step.equations import body_equations, central_inertia
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.water.force_law import weight

GRAVITY = 9.81
SPHERE = {"shape": {"type": "sphere", "radius": 0.06}, "at": [0.1, 0.02, 0.08], "material": "light"}
BOX = {
    "shape": {"type": "box", "size": [0.1, 0.2, 0.05]},
    "at": [-0.1, 0.05, 0.1],
    "rotation_deg": [10, 20, 30],
    "color": "#ff0000",
}
ANIMAL = {
    "name": "parts",
    "materials": {"firm": {"density": 1000.0}, "light": {"density": 400.0}},
    "bodies": [
        {
            "name": "torso",
            "shape": {"type": "cylinder", "radius": 0.1, "length": 0.3},
            "material": "firm",
            "parts": [SPHERE, BOX],
        },
        {
            "name": "leg_{side}",
            "shape": {"type": "capsule", "radius": 0.03, "length": 0.2},
            "material": "firm",
            "mirror": "y",
            "joint": {
                "parent": "torso",
                "at": [0, 0.12, -0.1],
                "child_at": [0.13, 0, 0],
                "rotation_deg": [0, 70, 20],
                "axes": ["y", "x"],
            },
            "parts": [{"shape": {"type": "sphere", "radius": 0.04}, "at": [-0.14, 0.02, 0]}],
        },
        {
            "name": "tip_{side}",
            "shape": None,
            "material": "firm",
            "mass": 0.1,
            "inertia": [1e-4, 2e-4, 1.5e-4, 1e-5, 0, 0],
            "joint": {
                "parent": "leg_{side}",
                "at": [-0.14, 0, 0],
                "child_at": [0.02, 0, 0],
                "axes": ["z"],
            },
        },
    ],
}


def built(changes: dict | None = None) -> Creature:
    """Return the animal, with other keys of its torso."""
    given = copy.deepcopy(ANIMAL)
    given["bodies"][0] |= changes or {}
    return CreatureConfig.model_validate(given).build()


def numbers_of(tree: Tree, body: int) -> dict:
    """Return the keys that give a body its mass and inertia in numbers."""
    tensor = central_inertia(tree)[:, :, body]
    return {
        "mass": float(tree.mass[body]),
        "centre_of_mass": (tree.com - tree.centre)[:, body].tolist(),
        "inertia": [
            float(tensor[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        ],
    }


def test_parts_are_one_body_with_the_merged_inertia():
    """The tree is that of a body with these numbers, and parts without mass make no difference."""
    tree = build_tree(built())
    assert tree.names[:3] == ("torso", "torso/2", "torso/3") and tree.owners[:3] == (0, 0, 0)
    numbers = numbers_of(tree, 0)
    for changes in (numbers, {"parts": [], **numbers}):
        other = build_tree(built(changes))
        order = [tree.names.index(name) for name in other.names]
        for name in ("mass", "com", "inertia"):
            np.testing.assert_allclose(
                getattr(other, name), getattr(tree, name)[..., order], rtol=1e-12, atol=1e-15
            )


@pytest.mark.slow
def test_parts_accelerate_as_bodies_of_several_geoms_in_mujoco():
    """Compare with MuJoCo's bodies of several geoms, and with our export, to 1e-9."""
    creature = built()
    tree = build_tree(creature)
    root = mjcf_model(creature, GRAVITY)
    plain = copy.deepcopy(root)
    # MuJoCo's usual form: the geoms of a body in one element.
    for body in list(plain.iter("body")):
        for part in body.findall("body"):
            if "/" in part.get("name", ""):
                geom = part.find("geom")
                assert geom is not None
                outer = body.find("geom")
                geom.set("pos", part.get("pos", "0 0 0"))
                if part.get("xyaxes"):
                    geom.set("xyaxes", part.get("xyaxes", ""))
                    geom.attrib.pop("zaxis", None)
                assert outer is not None
                body.insert(list(body).index(outer), geom)
                body.remove(part)

    @quick_jit
    def accelerations(state):
        kin = kinematics(tree, state)
        inertia, bias = body_equations(World(tree, GRAVITY), kin, 0.0)
        return jnp.concatenate(solve(tree, kin, inertia, bias, 0.0 * state.q, 0.0 * state.q))

    for seed in range(3):
        state = random_state(tree, np.random.default_rng(seed))
        ours = np.asarray(accelerations(state))
        for element in (root, plain):
            model = mujoco.MjModel.from_xml_string(mjcf_text(element))
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
            assert model.nbody == (10 if element is root else 6)
            theirs = mujocos_accelerations(model, mujoco.MjData(model), tree, state)
            assert np.abs(ours - theirs).max() < 1e-9 * np.abs(theirs).max()


@pytest.mark.slow
def test_steps_of_parts_equal_steps_of_numbers():
    """Whole steps on the ground and at the surface of water agree to rounding.

    The parts keep their places, so contact, water and buoyancy are equal. Only the mass moves.
    """
    creature = built()
    tree = build_tree(creature)
    other = built(numbers_of(tree, 0))
    found = []
    for animal in (creature, other):
        world = in_water(animal, surface=0.1, added_mass=True)
        contact = make_contact_model(animal, world.tree, Ground())
        world = dataclasses.replace(world, contact_model=contact)
        state = random_state(world.tree, np.random.default_rng(0), (2,), speed=0.2)
        state = dataclasses.replace(state, position=state.position.at[2].set(0.2))
        run = quick_jit(
            lambda s, world=world: jax.lax.fori_loop(
                0, 20, lambda _, s: step(world, s, jnp.zeros_like(s.q), 1 / 240)[0], s
            )
        )
        found.append(run(state))
    for one, same in zip(*map(jax.tree.leaves, found), strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_allclose(one, same, rtol=1e-9, atol=1e-9)


def test_water_on_parts_is_the_sum_over_shapes():
    """Three shapes that do not cover each other have the area, volume and added mass of each."""
    apart = [SPHERE | {"at": [0.0, 0.0, 0.4]}, BOX | {"at": [0.0, 0.0, -0.4]}]
    creature = built({"parts": apart})
    alone = [
        dataclasses.replace(creature, bodies=(dataclasses.replace(body, joint=None, whole=None),))
        for body in creature.bodies[:3]
    ]
    surfaces = outer_surfaces(creature, 2)
    for body, (one, surface) in enumerate(zip(alone, surfaces, strict=False)):
        own = outer_surfaces(one, 2)[0]
        np.testing.assert_allclose(surface.areas.sum(), own.areas.sum(), rtol=1e-12)
        assert {body} in [set(chain.bodies) for chain in slender_chains(creature)]
    tree = build_tree(creature)
    volume = sum(float(one.bodies[0].shape.volume) for one in alone)
    assert tree.volume[:3].sum() == pytest.approx(volume, rel=1e-12)


def test_buoyancy_acts_at_the_centre_of_volume():
    """A body whose mass is off its centre has the couple of weight and buoyancy."""
    mass, offset = 5.0, 0.02
    given = {"parts": [], "mass": mass, "centre_of_mass": [offset, 0, 0]}
    creature = built(given | {"inertia": [0.02, 0.03, 0.03, 0, 0, 0]})
    world = in_water(creature, gravity=GRAVITY)
    state = random_state(world.tree, np.random.default_rng(0), speed=0.0)
    state = dataclasses.replace(state, orientation=jnp.asarray([1.0, 0.0, 0.0, 0.0]))
    run = quick_jit(lambda state: weight(world.bodies(kinematics(world.tree, state), 0.0)))
    wrench = np.asarray(run(state))[:, 0]
    lift = 1000.0 * np.pi * 0.1**2 * 0.3 * GRAVITY
    np.testing.assert_allclose(
        wrench, [0, offset * mass * GRAVITY, 0, 0, 0, lift - mass * GRAVITY], atol=1e-12
    )


def test_a_body_without_a_shape_touches_and_wets_nothing():
    creature = built()
    tree = build_tree(creature)
    tips = {tree.names.index(name) for name in ("tip_left", "tip_right")}
    assert not tips & set(make_contact_model(creature, tree, Ground()).bodies)
    assert not tips & {i for pair in colliding_pairs(creature, tree, SelfCollision()) for i in pair}
    assert all(not len(outer_surfaces(creature, 2)[i].areas) for i in (-1, -2))
    without = dataclasses.replace(creature, bodies=creature.bodies[:-2])
    assert lowest_height(creature) == lowest_height(without)


def test_parts_of_one_body_and_of_neighbours_never_collide():
    """No pair within a rigid body, or across a joint. All legs may touch, with all their parts."""
    creature = built()
    tree = build_tree(creature)
    everything = SelfCollision(include=(("torso", "torso/2"),))
    pairs = colliding_pairs(creature, tree, everything)
    named = {(tree.names[i], tree.names[j]) for i, j in pairs}
    assert not any(one.startswith("torso") for one, _ in named)
    assert named <= {
        (one, other)
        for one in ("leg_left", "leg_left/2", "leg_right")
        for other in ("leg_right", "leg_right/2", "leg_left/2")
    }


def test_parts_belong_to_the_limb_of_their_body():
    creature = built()
    found = [{creature.bodies[i].name for i in limb.bodies} for limb in limbs(creature)]
    assert found == [
        {"leg_left", "leg_left/2", "tip_left"},
        {"leg_right", "leg_right/2", "tip_right"},
    ]


@pytest.mark.slow
def test_gradients_by_the_numbers_of_a_body_equal_finite_differences():
    """The acceleration of a body by its mass and by the place of a part."""
    state = random_state(build_tree(built()), np.random.default_rng(1))

    def rate(mass, x):
        creature = CreatureConfig.model_validate(ANIMAL)
        torso, *others = creature.bodies
        first = torso.parts[0].model_copy(update={"at": (x, 0.02, 0.08)})
        torso = torso.model_copy(update={"parts": [first, torso.parts[1]], "mass": mass})
        tree = build_tree(creature.model_copy(update={"bodies": [torso, *others]}).build())
        kin = kinematics(tree, state)
        inertia, bias = body_equations(World(tree, GRAVITY), kin, 0.0)
        return solve(tree, kin, inertia, bias, 0.0 * state.q, 0.0 * state.q)[1].sum()

    at = np.array([12.0, 0.1])
    run = quick_jit(jax.value_and_grad(rate, (0, 1)))
    with jax.numpy_rank_promotion("allow"):
        _, found = run(*at)
        for i, h in enumerate((1e-3, 1e-5)):
            difference = slope(lambda x: run(*x)[0], at, h * np.eye(2)[i])
            assert found[i] == pytest.approx(float(difference), rel=1e-5)


def test_mirrored_parts_and_numbers_are_mirror_images():
    """The inertia of the right leg is the image of the left one's in the plane y = 0."""
    given = copy.deepcopy(ANIMAL)
    given["bodies"][1] |= {
        "mass": 0.7,
        "centre_of_mass": [0.01, 0.02, 0.03],
        "inertia": [2e-3, 3e-3, 4e-3, 1e-4, 2e-4, 3e-4],
    }
    bodies = {body.name: body for body in CreatureConfig.model_validate(given).build().bodies}
    left, right = (bodies[f"leg_{side}"].inertial for side in ("left", "right"))
    assert left is not None and right is not None
    image = np.diag([1.0, -1.0, 1.0])
    np.testing.assert_array_equal(right.centre, image @ left.centre)
    np.testing.assert_array_equal(right.inertia, image @ left.inertia @ image)
    assert bodies["leg_right/2"].joint.parent_anchor == (-0.14, -0.02, 0.0)
    np.testing.assert_allclose(
        spatial_inertia(left.mass, left.centre, left.inertia)[0, 1],
        -spatial_inertia(right.mass, right.centre, right.inertia)[0, 1],
    )
