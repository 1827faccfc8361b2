"""Chains of oscillators."""

from creatures import box_chain
from evo_cpg.analysis.chains import chains
from evo_cpg.control.matsuoka import CpgSettings
from evo_cpg.creature.tree import build_tree


def test_chains_follow_the_axes_longest_first():
    tree = build_tree(box_chain(5, "yz"))
    along = [(0, 2, 4, 6), (1, 3, 5, 7)]
    uncoupled = CpgSettings(pair_weight=0.0, parent_weight=0.0, child_weight=0.0)
    turned = CpgSettings(opposite=(tree.names[2],))
    for settings in (CpgSettings(), uncoupled, CpgSettings(cross_weight=0.3), turned):
        assert chains(tree, settings) == along
