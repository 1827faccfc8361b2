"""The picture of an audit, with MuJoCo's opinion and without."""

import numpy as np
import pytest
import synthetic
from matplotlib.figure import Figure

from evo_cpg.analysis.energy import Ledger
from evo_cpg.analysis.verdict import Check
from evo_cpg.view.audit_plot import plot_audit

STEPS = 240


@pytest.fixture
def figures(monkeypatch) -> list[Figure]:
    """The figures that are saved."""
    saved, save = [], Figure.savefig

    def keep(figure: Figure, *arguments, **settings):
        saved.append(figure)
        return save(figure, *arguments, **settings)

    monkeypatch.setattr(Figure, "savefig", keep)
    return saved


def test_it_has_a_panel_of_paths_only_where_there_is_a_second_opinion(tmp_path, figures):
    """Without one the energy has the whole row, and nothing is left blank."""
    shape = {name: (STEPS,) for name in Ledger._fields} | {"impulse": (3, STEPS)}
    ledger = Ledger(**{name: np.full(shape[name], 0.01) for name in Ledger._fields})
    kept = [Check("half_step", "way kept at half the step", 0.97, 0.9, True, "%")]
    way = np.stack([np.linspace(0, 1, STEPS), np.zeros(STEPS), np.zeros(STEPS)])
    for paths in ({"evo_cpg": way, "MuJoCo": 0.9 * way}, {}):
        path = plot_audit(ledger, 1 / 240, kept, paths, "animal: audit", tmp_path / "audit.png")
        assert synthetic.read(path).shape[1] == 1600
    with_, without = ([axes.get_title() for axes in figure.axes] for figure in figures)
    energy, from_above = "Where the energy comes from and goes", "Same commands, from above"
    assert with_ == [energy, from_above, ""] and without == [energy, ""]
    wide = [figure.axes[0].get_position().width for figure in figures]
    assert wide[0] < 0.6 and wide[1] > 0.8
