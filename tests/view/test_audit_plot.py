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


def a_ledger() -> Ledger:
    shape = {name: (STEPS,) for name in Ledger._fields} | {"impulse": (3, STEPS)}
    return Ledger(**{name: np.full(shape[name], 0.01) for name in Ledger._fields})


def ways(*programs: str) -> dict[str, np.ndarray]:
    """Arcs that part, by program."""
    ahead = np.linspace(0, 1, STEPS)
    return {
        name: np.stack([ahead, 0.2 * i * ahead**2, 0 * ahead]) for i, name in enumerate(programs)
    }


def test_it_has_a_panel_of_paths_only_where_there_is_a_second_opinion(tmp_path, figures):
    """Without one the energy has the whole row, and nothing is left blank."""
    kept = [Check("half_step", "way kept at half the step", 0.97, 0.9, True, "%")]
    for paths in (ways("evo_cpg", "MuJoCo"), {}):
        path = plot_audit(a_ledger(), 1 / 240, kept, paths, "animal: audit", tmp_path / "audit.png")
        assert synthetic.read(path).shape[1] == 1600
    with_, without = ([axes.get_title() for axes in figure.axes] for figure in figures)
    energy, from_above = "Where the energy comes from and goes", "Ways of the root, from above"
    assert with_ == [energy, from_above, ""] and without == [energy, ""]
    wide = [figure.axes[0].get_position().width for figure in figures]
    assert wide[0] < 0.6 and wide[1] > 0.8


def test_all_of_mujocos_opinions_are_drawn_each_in_a_colour_of_its_own(tmp_path, figures):
    """On the ground a brain is asked for its own senses, too."""
    hard = "MuJoCo, hard contacts"
    paths = ways("evo_cpg", "MuJoCo", hard, f"{hard}, own senses")
    plot_audit(a_ledger(), 1 / 240, [], paths, "animal: audit", tmp_path / "audit.png")
    lines = figures[0].axes[1].get_lines()
    drawn = {line.get_label(): line.get_color() for line in lines if line.get_label() in paths}
    assert list(drawn) == list(paths) and len(set(drawn.values())) == 4
