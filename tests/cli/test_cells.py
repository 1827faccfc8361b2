"""`--cell`: film and audit the elite of any cell of a map of gaits."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.analysis.energy import Ledger
from evo_cpg.analysis.verdict import Check, Verdict
from evo_cpg.api import audit
from evo_cpg.api.audit import Audit
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.run import gait_map
from evo_cpg.training.conditions import Variation, compile_variation
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.view import answer_plots, figure, film
from tiny_run import CONFIG, PAIR

MAPPED = (
    *(setting for setting in PAIR if not setting.startswith("evolution.")),
    "evolution={type: map_elites, generations: 2, population: 8, axes: [{name: speed, range: [0, "
    "0.1], cells: 3}, {name: frequency, range: [0, 9], cells: 2}]}",
)

# The only trial of an audit that does not run.
STILL = SimpleNamespace(ledger=Ledger(*[np.zeros(1)] * len(Ledger._fields)))


@pytest.fixture(scope="module")
def mapped(cli, tmp_path_factory):
    """Make a run with a map, and return a cell that has an elite."""
    run = tmp_path_factory.mktemp("mapped") / "run"
    cli.passes("train", CONFIG, *MAPPED, "--out", run)
    folder = RunFolder(run)
    found = gait_map(built(run), folder.load(), 0)
    cell = tuple(np.argwhere(np.isfinite(found.fitness))[0].tolist())
    return run, cell, found


def built(run):
    return build_experiment(load_config(run / "config.yaml"), run / "config.yaml")


@pytest.mark.slow
def test_a_film_is_captioned_with_its_cell(cli, mapped, monkeypatch):
    run, cell, found = mapped
    shown = []
    monkeypatch.setattr(film, "side_by_side", lambda *given, **_: shown.extend(given[0]) or "made")
    name = ",".join(map(str, cell))
    cli.passes("render", run, "--cell", name)
    place = np.ravel_multi_index(cell, found.fitness.shape)
    speed, frequency = found.archive.descriptors[:, place]
    assert shown[-1].title == f"iwadate2010_swimmer, cell {name}"
    assert shown[-1].note == f"speed {speed:.3g} m/s, frequency {frequency:.3g} Hz"
    assert cli("render", run)[0] == 0
    assert (shown[-1].title, shown[-1].note) == ("iwadate2010_swimmer", "")


@pytest.mark.slow
def test_cell_selects_the_elite_to_audit(cli, mapped, monkeypatch):
    run, cell, found = mapped
    name = ",".join(map(str, cell))
    audited = []

    def audits(experiment, champions, *_):
        audited.extend(champions)
        check = Check("half_step", "way kept: half the step", 0.5, 0.9, True, "%")
        return [Audit(champions[0], Verdict((check,)), (STILL,), 0.01, missing="a test")]

    monkeypatch.setattr(audit, "audits", audits)
    monkeypatch.setattr(answer_plots, "audit_figure", lambda *_: None)
    monkeypatch.setattr(figure, "save_figure", lambda _, path: path)
    code, out, err = cli("audit", run, "--cell", name)
    assert code == 3 and f"the elite of cell {name} does not pass its audit" in out, err
    place = np.ravel_multi_index(cell, found.fitness.shape)
    np.testing.assert_array_equal(audited[0].genes, found.archive.genes[:, place])
    assert not evo.audit(run, cell=name).passed
    kept = json.loads((run / f"audit_cell_{'_'.join(map(str, cell))}.json").read_text())
    assert kept["fitness"] == audited[0].fitness and kept["passed"] is False
    assert not (run / "audit.json").exists()
    complaint = cli.refuses("audit", run, "--cell", "9,9")
    assert "there is no cell 9,9. Allowed: speed 0 to 2" in complaint


@pytest.mark.slow
def test_an_elite_is_audited_with_all_its_terms(mapped):
    """The map keeps only the terms of its axes. The check `free_energy` needs another term."""
    run = mapped[0]
    experiment, folder = built(run), RunFolder(run)
    checkpoint = folder.load()
    assert checkpoint is not None and checkpoint.champion is not None
    champion = checkpoint.champion
    outcome = compile_variation(experiment, Variation("", (experiment.simulation,)))(champion)
    only = {name: champion.terms[name] for name in ("speed", "frequency")}
    whole = audit.with_all_terms(champion._replace(terms=only), outcome)
    assert set(whole.terms) == set(champion.terms) > set(only)
    assert whole.terms == pytest.approx(champion.terms, rel=1e-5)
