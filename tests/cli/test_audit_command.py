"""`evo-cpg audit`: its output, its files and its errors."""

import dataclasses
import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from evo_cpg.analysis.verdict import KEPT, Check, Verdict, limits_from, shown
from evo_cpg.api import audit, audit_checks
from evo_cpg.api.audit import Audit
from evo_cpg.cli.ask import show_verdict
from evo_cpg.errors import UsageError
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.simulation.limits import Limits
from evo_cpg.training.checkpoint import Champion, genes_digest
from evo_cpg.training.conditions import Variation, compile_variation
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.view.run_page import origin
from pictures import ink
from tiny_run import CONFIG, PAIR


def test_one_limit_changes_and_the_others_stay():
    assert limits_from(["half_step=0.8"]) == Limits(half_step=0.8)
    assert limits_from([]) == Limits()


def test_a_verdict_has_its_reasons():
    """The checks have a least value, a largest value, no limit, and no finite value."""
    checks = (
        Check("half_step", "way kept: half the step", 0.5, 0.9, True, "%"),
        Check("penetration", "penetration", 0.002, 0.01, False, "m"),
        Check("way", "way", 3.0, unit="m"),
        Check("speed", "speed", float("nan"), 20.0),
    )
    verdict = Verdict(checks)
    assert [check.passed for check in checks] == [False, True, None, False]
    assert not verdict.passed and Verdict(checks[1:3]).passed
    assert verdict.reasons == [
        "way kept: half the step: 50 %, less than 90 %",
        "speed: diverged, more than 20",
    ]
    assert shown(None) == ""


@pytest.mark.slow
def test_train_tests_its_champion_at_half_the_step(cli, tmp_path, monkeypatch):
    """The result equals the half-step variation of an audit. An unreachable limit warns."""
    # Two bodies on a hinge have a short displacement.
    monkeypatch.setattr(audit, "LEAST_DISPLACEMENT", 1e-9)
    run = tmp_path / "run"
    settings = (
        *PAIR,
        "audit.after_training=true",
        "task={type: distance}",
        "evolution.generations=1",
    )
    _, err = cli.passes("train", CONFIG, *settings, "audit.half_step=1.5", "--out", run)
    assert "warning: at half the physics step it keeps" in err and "evo-cpg audit" in err
    kept = RunFolder(run).read_meta()["half_step"]
    assert kept["passed"] is False and kept["least"] == 1.5
    assert kept["genes_sha256"] == genes_digest(RunFolder(run).load_champion()[0].genes)
    experiment = build_experiment(load_config(run / "config.yaml"), run)
    champion = RunFolder(run).load_champion()[0]
    own = experiment.simulation
    whole, half = (
        compile_variation(experiment, Variation("", (each,)))(champion).displacement[0]
        for each in (own, dataclasses.replace(own, substeps=2 * own.substeps))
    )
    assert whole > 0
    assert kept["measured"] == np.clip(half / whole, 0.0, 1.0)


@pytest.mark.slow
def test_runs_without_a_champion_are_skipped(cli, finished_run, tmp_path, monkeypatch):
    run = RunFolder(tmp_path / "run")
    shutil.copytree(finished_run, run.path)
    done = run.load()
    assert done is not None
    audited = []

    def audits(experiment, champions, *rest):
        audited.extend(champions)
        raise UsageError("enough")

    monkeypatch.setattr(audit, "audits", audits)
    run.save(done._replace(records=(None, done.records[0], None), chosen=()))
    complaint = cli.refuses("audit", run.path, "--all")
    assert complaint.endswith("evo-cpg: enough\n")
    for number in (0, 2):
        assert f"{run.path}: run {number} has no champion to audit: every ind" in complaint
    assert [champion.fitness for champion in audited] == [done.records[0].fitness]
    run.save(done._replace(records=(None, None), chosen=()))
    assert "has no champion in its checkpoints" in cli.refuses("audit", run.path, "--all")


Called = tuple[int, str, str]


class Audited(NamedTuple):
    """Run folder after `evo-cpg audit RUN` and `evo-cpg audit RUN --all`."""

    run: Path
    one: Called
    every: Called

    def result(self, name: str = "audit") -> dict:
        return json.loads((self.run / f"{name}.json").read_text())


@pytest.fixture(scope="module")
def audited(cli, finished_run, tmp_path_factory) -> Audited:
    """Audit the champion of a run, and then all its champions, which is the same one."""
    run = tmp_path_factory.mktemp("audited") / "run"
    shutil.copytree(finished_run, run)
    with pytest.MonkeyPatch.context() as patch:
        # Two bodies on a hinge have a short displacement.
        patch.setattr(audit_checks, "LEAST_DISPLACEMENT", -1e9)
        one = cli("audit", run, "half_step=0", "quarter_step=0")
        return Audited(run, one, cli("audit", run, "--all"))


@pytest.mark.slow
def test_an_audit_prints_and_writes_its_checks(audited):
    code, out, complaint = audited.one
    found = audited.result()
    assert code == (0 if found["passed"] else 3), complaint
    assert str(audited.run / "audit.json") in out and "MuJoCo" in out
    keys = {check["key"] for check in found["checks"]}
    assert {"replay", "drag", "pose", "precision", "simulator_energy", "free_energy"} <= keys
    assert found["second_opinion"][1]["program"] == "MuJoCo"
    energy = found["energy"][0]
    work = sum(value for name, value in energy.items() if name not in ("stored", "left_over"))
    assert energy["stored"] == pytest.approx(work + energy["left_over"])
    assert 0.01 < ink(audited.run / "plots" / "audit.png") < 0.5


@pytest.mark.slow
def test_a_champion_has_the_same_audit_alone_and_among_all(audited):
    code, out, _ = audited.every
    every, one = audited.result("audit_run0"), audited.result()
    assert code == (0 if every["passed"] else 3)
    assert "of 1 champions pass" not in out
    assert "quarter %" in out and "MuJoCo: way" in out
    assert [x["measured"] for x in every["checks"]] == [x["measured"] for x in one["checks"]]


def judged(*checks: Check, run: int = 0) -> Audit:
    return Audit(Champion(np.zeros(1), 0.0, 0, {}, {}, run=run), Verdict(checks), (), 1.0)


def test_the_verdict_says_not_confirmed(capsys):
    moved = Check("way", "", 2.0)
    soft, hard = (
        judged(moved, Check("half_step", "", 1.0), Check("mujoco", f"{KEPT}MuJoCo", kept, unit="%"))
        for kept in (0.71, 0.13)
    )
    show_verdict(Path("run"), [soft], "the champion")
    assert "passes its audit; second opinions" in capsys.readouterr().out
    show_verdict(Path("run"), [hard], "the champion")
    assert "not confirmed" in capsys.readouterr().out
    found = hard.as_dict()
    assert found["confirmed"] is False
    page = origin.audit(SimpleNamespace(audit=found, half_step=None, stale=False))
    assert "not confirmed" in str(page)
    show_verdict(Path("run"), [soft, hard], "")
    assert "1 of 2 are not confirmed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("moved", "kept", "out", "complaint"),
    [
        (2.0, {"half_step": 1.0, "blind": 0.3}, "run: the champion passes its audit\n", ""),
        (2.0, {"half_step": 1.0, "blind": 0.83}, "passes", "does not use its eyes"),
        (0.004, {}, "passes", "displacement 0.004 m: too short to compare variations with"),
    ],
)
def test_the_verdict_names_unused_eyes_and_short_displacements(capsys, moved, kept, out, complaint):
    checks = Check("way", "", moved), *(Check(key, "", fraction) for key, fraction in kept.items())
    show_verdict(Path("run"), [judged(*checks)], "the champion")
    told = capsys.readouterr()
    assert out in told.out and complaint in told.err and bool(complaint) == bool(told.err)
