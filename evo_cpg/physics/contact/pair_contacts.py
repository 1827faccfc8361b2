"""Contacts between bodies of one creature in a step: the common interface of two classes.

Few pairs are unrolled (`evo_cpg.physics.contact.few_pairs`), many are looped over
(`evo_cpg.physics.contact.many_pairs`). `evo_cpg.physics.contact.pairs` has the contact model. Both
classes have these members:

| `PairContacts` | |
|---|---|
| ``bias`` | determines the velocity-product acceleration of the points along their normals |
| ``with_bias(bias)`` | the contacts with another bias |
| ``bias_at(qdd)`` | ``bias`` for the joint rates after a step with joint accelerations ``qdd`` |
| ``at(qdd, sums)`` | the `PairForces` at joint accelerations, ``sums`` included if known |
| ``change(qdd)`` | the change of velocities that ``PairForces.power`` takes |
| ``touches(qdd)`` | where any pair pushes |
| ``drifts(qdd, bias)`` | where another bias would move a touching pair by over `LARGEST_DRIFT` |
| ``parting(rates)`` | the separation velocities of points at joint rates, ``J rates``, m/s |

| `PairForces` | |
|---|---|
| ``sums`` | what an evaluation found, so that it need not be repeated |
| ``force``, ``load`` | force of every point, and their sum, N |
| ``torque`` | joint torques of the forces, ``J^T f``, N m |
| ``power(change)`` | power of the forces, W |
| ``newton()`` | linearized torques at zero joint acceleration, and ``h J^T K J`` |

``find_pair_contacts`` computes the bias at the joint rates at the start of the step. ``bias_at``
computes it at the rates after the step, and ``with_bias`` replaces it. Few pairs store the
acceleration itself, ``(p, *n)``, m/s^2. Many pairs store the joint accelerations that lead from the
rates at the start to the rates of the bias, ``(d, *n)``, rad/s^2.
"""

from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.contact.few_pairs import FewPairContacts, FewPairForces
from evo_cpg.physics.contact.many_pairs import ManyPairContacts, ManyPairForces
from evo_cpg.physics.contact.pairs import Pairs
from evo_cpg.physics.tree.kinematics import Kinematics

PairContacts = FewPairContacts | ManyPairContacts
PairForces = FewPairForces | ManyPairForces


def find_pair_contacts(
    tree: Tree, pairs: Pairs, kin: Kinematics, qd: Float[Array, "d *n"], h: float
) -> PairContacts:
    """Find the nearest points of all pairs, and their separation velocities.

    Args:
        tree: the creature.
        pairs: pairs of the creature's bodies.
        kin: kinematics at the start of the step.
        qd: joint rates at the start of the step, rad/s.
        h: step, s.
    """
    find = ManyPairContacts if pairs.looped else FewPairContacts.find
    return find(tree, pairs, kin, qd, h)
