"""`train --tensorboard`: scalars with the names of metrics.csv, which `resume` continues."""

import csv
import shutil
import sys

import pytest

from tiny_run import CONFIG, PAIR

pytest.importorskip("tensorboardX")


@pytest.fixture(scope="module")
def run(cli, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scalars") / "run"
    code, _, complaint = cli(
        "train", CONFIG, *PAIR, "evolution.generations=2", "--tensorboard", "--out", folder
    )
    assert code == 0, complaint
    return folder


def scalars(run) -> list[dict[str, float]]:
    from tensorboardX.proto.event_pb2 import Event

    data, found = (run / "tensorboard" / "events.out.tfevents.evo-cpg").read_bytes(), []
    while data:
        length = int.from_bytes(data[:8], "little")
        event = Event.FromString(data[12 : 12 + length])
        if event.HasField("summary"):
            values = {value.tag: value.simple_value for value in event.summary.value}
            found.append(values | {"generation": event.step})
        data = data[16 + length :]
    return found


def table(run) -> list[dict[str, float]]:
    with (run / "metrics.csv").open() as file:
        return [{name: float(x) for name, x in row.items()} for row in csv.DictReader(file)]


def agrees(run, generations: int) -> None:
    found, written = scalars(run), table(run)
    assert len(found) == len(written) == generations
    for one, other in zip(found, written, strict=True):
        assert one == pytest.approx(other, rel=1e-6)


def test_scalars_equal_the_table(run):
    agrees(run, 2)


def test_resume_continues_the_same_file(cli, run, tmp_path):
    again = tmp_path / "run"
    shutil.copytree(run, again)
    code, _, complaint = cli("resume", again, "--generations", 4)
    assert code == 0, complaint
    agrees(again, 4)
    assert len(list((again / "tensorboard").iterdir())) == 1


def test_resume_starts_a_file_only_with_the_option(cli, run, tmp_path):
    again = tmp_path / "run"
    shutil.copytree(run, again)
    shutil.rmtree(again / "tensorboard")
    code, _, complaint = cli("resume", again, "--generations", 3)
    assert code == 0, complaint
    assert not (again / "tensorboard").exists()
    code, _, complaint = cli("resume", again, "--generations", 4, "--tensorboard")
    assert code == 0, complaint
    agrees(again, 4)


def test_a_missing_package_is_an_error_before_training(cli, run, tmp_path, monkeypatch):
    before = scalars(run)
    monkeypatch.setitem(sys.modules, "tensorboardX.proto.event_pb2", None)
    code, _, complaint = cli("train", CONFIG, *PAIR, "--tensorboard", "--out", tmp_path / "new")
    assert code == 2 and not (tmp_path / "new").exists()
    assert "--tensorboard: 'tensorboardX' is not installed here" in complaint
    again = tmp_path / "run"
    shutil.copytree(run, again)
    code, _, complaint = cli("resume", again, "--generations", 3)
    assert code == 0 and "writing no more scalars for TensorBoard" in complaint
    monkeypatch.undo()
    assert scalars(again) == before
