"""Changes on a line of descent, in words."""

import numpy as np
import pytest

from evo_cpg.analysis.descent import changes, matched
from evo_cpg.evolution.strategy import Births
from evo_cpg.training.family import extend_family, line_of
from plans import hand_plan, paired

SIDE, TAIL = (0.0, 0.1, 0.0), {"label": 7, "place": (-0.2, 0, 0)}
PAIR = paired(3, SIDE)


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ([{}, TAIL], [{}, TAIL], []),
        ([{}, TAIL], [{}, TAIL, *PAIR], ["side limbs grew"]),
        ([{}, *PAIR], [{}], ["side limbs lost"]),
        ([{}, TAIL], [{}, TAIL, TAIL | {"parent": 1}], ["rear limb grew 1 part"]),
        ([{}, TAIL], [{"half": (0.24, 0.1, 0.1)}, TAIL], ["trunk longer by 20%"]),
        ([{}, TAIL], [{"half": (0.4, 0.2, 0.2)}, TAIL | {"place": (-0.4, 0, 0)}],
         ["trunk larger by 100%"]),
        ([{}, *PAIR], [{}, *paired(3, SIDE, axes=(0, 1, 1))], ["side limbs with more joint axes"]),
        ([{}, *PAIR], [{}, *paired(3, (0.1, 0.1, 0))], ["side limbs moved forward"]),
        ([{}, TAIL], [{}, TAIL | {"control": [[0, 0.4, 0, 0, 0]] * 3}],
         ["rear limb with a new rhythm"]),
        ([{}, TAIL], [{}, TAIL | {"control": [[-0.4, 0, 0, 0, 0]] * 3}],
         ["rear limb with weaker strokes"]),
        ([{}, TAIL], [{}, TAIL | {"label": 8, "half": (0.3, 0.15, 0.15)}],
         ["rear limb larger by 50%"]),
    ],
)  # fmt: skip
def test_changes_are_told_in_words(before, after, told):
    found = changes(hand_plan(*before), hand_plan(*after))
    assert [words for _, words in found] == told


def test_parts_keep_their_identity_when_limbs_grow():
    """A new limb of the same node comes first, so numbers of copies change."""
    new = paired(3, (0.15, 0.1, 0))
    before, after = hand_plan({}, *PAIR, TAIL), hand_plan({}, *new, TAIL, *PAIR)
    np.testing.assert_array_equal(matched(before, after), [0, -1, -1, 3, 1, 2])


def test_a_line_follows_first_parents(tmp_path):
    """Individual 1 is copied, kept, and crossed with individual 0."""
    births = [([1, 0], [-1, -1], [1, 1]), ([0, 1], [-1, -1], [0, 1]), ([0, 0], [1, -1], [2, 1])]
    for number, origins in enumerate(births):
        origin = (np.array([each], np.int32) for each in origins)
        genome = np.full((1, 1, 2), 10 * number + np.arange(2), np.uint8)
        extend_family(tmp_path, np.array([[1.0, 2.0]]) + number, Births(*origin, genome))
    extend_family(tmp_path, np.array([[9.0, 8.0]]), Births(*np.zeros((3, 1, 2), int), genome))
    line = line_of(tmp_path, 3, 0)
    assert [(one.generation, one.index, one.kind) for one in line] == [
        (0, 1, 0),
        (1, 0, 1),
        (3, 0, 2),
    ]
    assert [float(one.record["fitness"]) for one in line] == [2.0, 2.0, 9.0]
    assert line[2].second == 1 and line[2].other["genome"][0] == 21 and line[1].other is None
    assert line_of(tmp_path, 4, 0) is None
