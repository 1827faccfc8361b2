"""`evo-cpg audit`: what it prints, writes and refuses."""

import json
import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from evo_cpg.analysis.verdict import Check, Limits, Verdict, limits_from, shown
from evo_cpg.api import audit
from evo_cpg.api.audit import Audit
from evo_cpg.cli.audited import say_verdict
from evo_cpg.cli.errors import UsageError
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.training.checkpoint import Champion, genes_digest
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.variations import Variation, compile_variation, finer
from pictures import ink
from tiny_run import CONFIG, PAIR


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("half_stp=0.5", "there is no limit 'half_stp'. Did you mean half_step?"),
        ("xyz=1", "there is no limit 'xyz'. Allowed: half_step, "),
        ("way=1", "there is no limit 'way'"),
        ("half_step=", "'' is no limit. Allowed: a number of at least 0"),
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
    """Its result for half the step equals that of a variation; a limit out of reach warns."""
    # Two bodies on a hinge get nowhere much.
    monkeypatch.setattr(audit, "_LEAST_DISPLACEMENT", 1e-9)
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
        compile_variation(experiment, Variation("", (each,)))(champion).displacement[0]
        for each in (own, finer(own, 2))
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


Called = tuple[int, str, str]


class Audited(NamedTuple):
    """A run folder after `evo-cpg audit RUN` and `evo-cpg audit RUN --all`."""

    run: Path
    one: Called
    every: Called

    def told(self, name: str = "audit") -> dict:
        return json.loads((self.run / f"{name}.json").read_text())


@pytest.fixture(scope="module")
def audited(cli, finished_run, tmp_path_factory) -> Audited:
    """Audit a run's champion, and then all champions, of which the run has one."""
    run = tmp_path_factory.mktemp("audited") / "run"
    shutil.copytree(finished_run, run)
    with pytest.MonkeyPatch.context() as patch:
        # Two bodies on a hinge get nowhere much.
        patch.setattr(audit, "_LEAST_DISPLACEMENT", -1e9)
        one = cli("audit", run, "half_step=0", "quarter_step=0")
        return Audited(run, one, cli("audit", run, "--all"))


@pytest.mark.slow
def test_exit_code_is_the_verdict(audited):
    code, _, complaint = audited.one
    assert code == (0 if audited.told()["passed"] else 3), complaint
    assert audited.every[0] == (0 if audited.told("audit_run0")["passed"] else 3)


@pytest.mark.slow
def test_audit_file_has_every_check(audited):
    keys = {check["key"] for check in audited.told()["checks"]}
    assert {"replay", "drag", "pose", "precision", "simulator_energy", "free_energy"} <= keys
    assert audited.told()["second_opinion"][1]["program"] == "MuJoCo"


@pytest.mark.slow
def test_audit_file_balances_energy(audited):
    energy = audited.told()["energy"][0]
    work = sum(value for name, value in energy.items() if name not in ("stored", "left_over"))
    assert energy["stored"] == pytest.approx(work + energy["left_over"])


@pytest.mark.slow
def test_audit_prints_tables_and_draws_a_picture(audited):
    _, out, _ = audited.one
    assert str(audited.run / "audit.json") in out and "MuJoCo" in out
    assert 0.01 < ink(audited.run / "plots" / "audit.png") < 0.5


@pytest.mark.slow
def test_all_champions_are_audited_as_one_is(audited):
    _, out, _ = audited.every
    assert "of 1 champions pass" not in out
    assert "quarter %" in out and "MuJoCo: way" in out
    alone, told = audited.told("audit_run0"), audited.told()
    assert [x["measured"] for x in alone["checks"]] == [x["measured"] for x in told["checks"]]


@pytest.mark.parametrize("other", [("--run", 0), ("--cell", "0,0")])
def test_all_and_one_champion_are_refused(cli, tmp_path, other):
    code, _, complaint = cli("audit", tmp_path, "--all", *other)
    assert code == 2 and f"--all and {other[0]}: give one of them" in complaint


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
    say_verdict(Path("run"), [champion], [sees], "the champion")
    assert capsys.readouterr() == ("run: the champion passes its audit\n", "")
    say_verdict(Path("run"), [champion], [blind], "the champion")
    assert capsys.readouterr().err == (
        "run: note: the champion does not use its eyes: blind it keeps 83% of its displacement\n"
    )
    say_verdict(Path("run"), [champion, champion._replace(run=1)], [sees, still], "")
    assert capsys.readouterr().err == (
        "run: run 1: displacement 0.004 m: too little to try what is kept of it\n"
    )
