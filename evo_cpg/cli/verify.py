"""`evo-cpg verify`: check that a champion is unchanged and replays as recorded."""

from pathlib import Path

from evo_cpg.cli.errors import ExitCode, tell
from evo_cpg.cli.options import CoresOfRun, Run


def verify(run: Run, cores: CoresOfRun = None) -> None:
    """Replay the champion and compare it with the record."""
    import numpy as np

    from evo_cpg.api.machine import machine_changes, machine_fingerprint
    from evo_cpg.cli.champions import REPLAY_TOLERANCE, open_and_build, replayed, use_cores_of
    from evo_cpg.training.checkpoint import genes_digest, outcome_digest

    use_cores_of(run, cores)
    opened = open_and_build(run)
    opened.require_configured()
    folder, experiment = opened.folder, opened.experiment
    champion, _, digests = folder.load_champion()
    differences = []
    if digests["genes_sha256"] != genes_digest(champion.genes):
        differences.append("champion.npz: the genome differs from the evolved genome")
    if digests["outcome_sha256"] != outcome_digest(champion):
        differences.append("champion.npz: fitness or terms differ from the recorded values")
    if opened.changed:
        differences.append(opened.changed)
    checkpoint = folder.load()
    kept = checkpoint.champion if checkpoint else None
    if kept and kept.generation == champion.generation:
        if not np.array_equal(kept.genes, champion.genes):
            differences.append("champion.npz: the genome differs from the newest checkpoint")
        if outcome_digest(kept) != outcome_digest(champion):
            differences.append("champion.npz: fitness or terms differ from the newest checkpoint")
    wrong = experiment.simulation.genome.misfit(champion.genes)
    if wrong:
        _report(run, [*differences, wrong])
    replay = replayed(opened, champion)
    recorded = {"fitness": champion.fitness, **champion.terms}
    found = {"fitness": replay.fitness, **replay.terms}
    for name, value in recorded.items():
        if name not in found:
            differences.append(f"{name}: recorded {value:.6g}, but missing in the replay")
            continue
        now = found[name]
        if not np.isclose(now, value, REPLAY_TOLERANCE, REPLAY_TOLERANCE, equal_nan=True):
            differences.append(f"{name}: recorded {value:.6g}, replayed {now:.6g}")
    here = machine_fingerprint(experiment.simulation.engine, opened.devices)
    for changed in machine_changes(folder.read_meta(), here):
        tell(f"{run}: {changed}. The last digits may differ")
    _report(run, differences)
    same = all(np.array_equal(found[name], recorded[name], True) for name in recorded)
    exact = "exactly" if same else f"to {REPLAY_TOLERANCE:g}"
    print(f"{run}: the champion's fitness {champion.fitness:.6f} is as recorded ({exact})")


def _report(run: Path, differences: list[str]) -> None:
    if differences:
        for difference in differences:
            tell(f"evo-cpg: {run}: {difference}")
        raise SystemExit(ExitCode.NOT_PASSED)
