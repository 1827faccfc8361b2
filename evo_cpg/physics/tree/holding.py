"""The wrench that holds a root still: an animal that is towed, or fixed in a flume.

A held root has no acceleration. The wrench on it follows from the accelerations of all bodies, as
in inverse dynamics:

    f = sum_i X_i^T (I_i a_i + p_i),

with the inertias I + h D and the bias wrenches p of the step (`evo_cpg.physics.step.equations`). X
moves a wrench to the root's centre. The wrench includes the reaction to the implicit drag, so the
momentum of the step balances to rounding.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.tree import root
from evo_cpg.physics.tree.articulated import Accelerations
from evo_cpg.physics.tree.generalized import body_accelerations, generalized_force
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.tree.spatial_algebra import Inertia, Wrench, inertial_wrench, plus


def holding_wrench(
    tree: Tree, kin: Kinematics, inertia: Inertia, bias: Wrench, found: Accelerations
) -> Float[Array, "6 *n"]:
    """Return the moment (N m) and force (N) on the root that give a step its accelerations.

    Both are in world axes. The moment is about the root's centre.

    Args:
        tree: the creature.
        kin: present kinematics of the creature.
        inertia: ``I + h D`` of every body.
        bias: ``V x* I V - f + I A0`` of every body.
        found: accelerations that `evo_cpg.physics.tree.articulated.solve` returns for a held root.
    """
    accelerations = body_accelerations(tree, kin, jnp.concatenate(found))
    total = plus(inertial_wrench(inertia, accelerations), bias)
    return root.root_part(generalized_force(tree, kin, total))
