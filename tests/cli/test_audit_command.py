"""`evo-cpg audit`: what it prints, writes and refuses."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from evo_cpg.analysis.verdict import Check, Limits, Verdict, limits_from, shown
from evo_cpg.api import audit
from evo_cpg.api.audit import Audit
from evo_cpg.cli import audit as audit_command
from evo_cpg.cli.errors import UsageError
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.training.checkpoint import Champion, genes_digest
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.variations import Variation, finer, live
from pictures import ink
from tiny_run import CONFIG, PAIR


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("half_stp=0.5", "there is no limit 'half_stp'; did you mean half_step?"),
        ("xyz=1", "there is no limit 'xyz'; allowed: half_step, "),
        ("half_step=", "'' is no limit; allowed: a number of at least 0"),
        ("half_step=-1", "'-1' is no limit"),
        ("half_step=nan", "'nan' is no limit"),
        ("half_step=1_0", "'1_0' is no limit"),
    ],
)
def test_wrong_limits_are_refused_before_anything_is_done(cli, tmp_path, setting, words):
    code, _, complaint = cli("audit", tmp_path, setting)
    assert code == 2 and words in complaint


def test_a_folder_without_a_run_is_refused(cli, tmp_path):
    code, _, complaint = cli("audit", tmp_path)
    assert code == 2 and "is not a run folder" in complaint


def test_limits_are_changed_one_by_one():
    assert limits_from(["half_step=0.8"]) == Limits(half_step=0.8)
    assert limits_from([]) == Limits()


def test_a_verdict_says_why():
    """Shares at least and at most, what is only reported, and what diverged."""
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


def test_train_takes_a_first_look_at_its_champion(cli, tmp_path, monkeypatch):
    """What it says of half the step is what `live` says, and a limit out of reach is a warning."""
    # Two bodies on a hinge get nowhere much.
    monkeypatch.setattr(audit, "_SOME_WAY", 1e-9)
    run = tmp_path / "run"
    settings = (
        *PAIR,
        "audit.after_training=true",
        "task={type: distance}",
        "evolution.generations=1",
    )
    code, _, said = cli("train", CONFIG, *settings, "audit.half_step=1.5", "--out", run)
    assert code == 0
    assert "warning: at half the physics step it keeps" in said and "evo-cpg audit" in said
    told = RunFolder(run).read_meta()["half_step"]
    assert told["passed"] is False and told["least"] == 1.5
    assert told["genes_sha256"] == genes_digest(RunFolder(run).load_champion()[0].genes)
    experiment = build_experiment(load_config(run / "config.yaml"), run)
    champion = RunFolder(run).load_champion()[0]
    own = experiment.simulation
    way, half = (
        live(experiment, champion, Variation("", (each,))).way[0] for each in (own, finer(own, 2))
    )
    assert way > 0
    assert told["measured"] == np.clip(half / way, 0.0, 1.0)


@pytest.mark.slow
def test_runs_without_a_champion_are_passed_over(cli, finished_run, tmp_path, monkeypatch):
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
    code, _, complaint = cli("audit", run.path, "--all")
    assert code == 2 and complaint.endswith("evo-cpg: enough\n")
    for number in (0, 2):
        assert f"{run.path}: run {number}: every individual diverged: it has no ch" in complaint
    assert [champion.fitness for champion in audited] == [done.records[0].fitness]
    run.save(done._replace(records=(None, None), chosen=()))
    code, _, complaint = cli("audit", run.path, "--all")
    assert code == 2
    assert complaint == f"evo-cpg: --all: the checkpoints of {run.path} hold no champion\n"


@pytest.mark.slow
def test_a_champion_is_audited(cli, finished_run, tmp_path, monkeypatch):
    """A table, a verdict, a file and a picture; and a table of all champions, here of one."""
    # Two bodies on a hinge get nowhere much.
    monkeypatch.setattr(audit, "_SOME_WAY", -1e9)
    run = tmp_path / "run"
    shutil.copytree(finished_run, run)
    code, out, complaint = cli("audit", run, "half_step=0", "quarter_step=0")
    told = json.loads((run / "audit.json").read_text())
    assert code == (0 if told["passed"] else 3), complaint
    keys = {check["key"] for check in told["checks"]}
    assert {"replay", "drag", "pose", "precision", "simulator_energy", "free_energy"} <= keys
    assert told["second_opinion"][1]["program"] == "MuJoCo"
    energy = told["energy"][0]
    work = sum(value for name, value in energy.items() if name not in ("stored", "left_over"))
    assert energy["stored"] == pytest.approx(work + energy["left_over"])
    assert 0.01 < ink(run / "plots" / "audit.png") < 0.5
    assert str(run / "audit.json") in out and "MuJoCo" in out
    code, out, _ = cli("audit", run, "--all")
    alone = json.loads((run / "audit_run0.json").read_text())
    assert code == (0 if alone["passed"] else 3) and "of 1 champions pass" not in out
    assert [x["measured"] for x in alone["checks"]] == [x["measured"] for x in told["checks"]]
    assert "quarter %" in out and "MuJoCo: way" in out
    code, _, complaint = cli("audit", run, "--all", "--run", 0)
    assert code == 2 and "--all and --run" in complaint
    code, _, complaint = cli("audit", run, "way=1")
    assert code == 2 and "no limit 'way'" in complaint


def judged(*checks: Check) -> Audit:
    return Audit(Verdict(checks), (), 1.0)


def test_who_does_without_its_eyes_is_told(capsys):
    champion = Champion(np.zeros(1), 0.0, 0, {}, {})
    sees, blind, still = (
        judged(Check("way", "", way), *(Check(key, "", share) for key, share in shares.items()))
        for way, shares in (
            (2.0, {"half_step": 1.0, "blind": 0.3}),
            (2.0, {"half_step": 1.0, "blind": 0.83}),
            (0.004, {}),
        )
    )
    audit_command._say(Path("run"), [champion], [sees], "the champion")
    assert capsys.readouterr() == ("run: the champion passes its audit\n", "")
    audit_command._say(Path("run"), [champion], [blind], "the champion")
    assert capsys.readouterr().err == (
        "run: note: the champion does not use its eyes: blind it keeps 83% of its displacement\n"
    )
    audit_command._say(Path("run"), [champion, champion._replace(run=1)], [sees, still], "")
    assert capsys.readouterr().err == (
        "run: run 1: displacement 0.004 m: too little to try what is kept of it\n"
    )
