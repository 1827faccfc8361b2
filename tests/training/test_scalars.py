"""Event files for TensorBoard, read back byte by byte."""

import math
import struct
import sys
import time

import pytest

from evo_cpg.files import OutputError
from evo_cpg.training.scalars import MissingWriterError, Scalars, require_writer

pytest.importorskip("tensorboardX")


def checksum(data: bytes) -> int:
    """Return the CRC-32C (Castagnoli) with the mask of TFRecord."""
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ (0x82F63B78 if register & 1 else 0)
    register ^= 0xFFFFFFFF
    return (((register >> 15) | (register << 17)) + 0xA282EAD8) & 0xFFFFFFFF


def events(path) -> list:
    """Return the events of a file, and check that it is whole."""
    from tensorboardX.proto.event_pb2 import Event

    data, found = path.read_bytes(), []
    while data:
        length, check = struct.unpack("<QI", data[:12])
        assert check == checksum(data[:8])
        body = data[12 : 12 + length]
        assert struct.unpack("<I", data[12 + length : 16 + length])[0] == checksum(body)
        found.append(Event.FromString(body))
        data = data[16 + length :]
    return found


def told(path) -> dict[int, dict[str, float]]:
    """Return the scalars by generation."""
    first, *rest = events(path)
    assert first.file_version == "brain.Event:2"
    steps = [event.step for event in rest]
    assert steps == sorted(set(steps))
    return {event.step: {v.tag: v.simple_value for v in event.summary.value} for event in rest}


def row(generation: int, **more: float) -> dict[str, float]:
    return {"generation": generation, "best": generation / 2, "mean": -1.0, **more}


FILE = "tensorboard/events.out.tfevents.evo-cpg"


def test_rows_are_read_back_by_column_name(tmp_path):
    scalars = Scalars(tmp_path)
    scalars.add([row(0)])
    scalars.add([row(1, best_distance=math.nan)])
    scalars.close()
    found = told(tmp_path / FILE)
    assert found == {0: {"best": 0.0, "mean": -1.0}, 1: {"best": 0.5, "mean": -1.0}}


def test_each_run_has_its_own_file(tmp_path):
    scalars = Scalars(tmp_path)
    scalars.add([row(0, run=0), row(0, run=1)])
    scalars.close()
    for run in (0, 1):
        path = tmp_path / "tensorboard" / f"run_{run}" / "events.out.tfevents.evo-cpg"
        assert told(path) == {0: {"best": 0.0, "mean": -1.0}}


@pytest.mark.parametrize("left", [b"", b"x" * 5, b"rubbish" * 40])
def test_a_resumed_run_rewrites_its_file(tmp_path, left):
    """No generation is missing or duplicated, for any file that a kill leaves."""
    scalars = Scalars(tmp_path)
    scalars.add([row(i) for i in range(3)])
    scalars.close()
    path = tmp_path / FILE
    before = path.read_bytes()
    path.write_bytes(left)
    scalars = Scalars(tmp_path, [row(i, seconds=10.0) for i in range(4)])
    scalars.add([row(4)])
    scalars.close()
    assert sorted(told(path)) == [0, 1, 2, 3, 4]
    # Old rows without the column of seconds have an equal number of bytes.
    Scalars(tmp_path, [row(i) for i in range(3)]).close()
    assert len(path.read_bytes()) == len(before)


def test_earlier_generations_keep_their_distance_in_time(tmp_path):
    took = [row(0, seconds=50.0), row(1, seconds=20.0), row(2, seconds=30.0)]
    began = time.time()
    Scalars(tmp_path, took).close()
    times = [event.wall_time - began for event in events(tmp_path / FILE)[1:]]
    assert times == pytest.approx([-50.0, -30.0, 0.0], abs=5.0)


def test_generations_lost_with_a_checkpoint_are_removed(tmp_path):
    """The newest checkpoint was damaged, so the run continues from the previous one."""
    scalars = Scalars(tmp_path)
    scalars.add([row(i) for i in range(5)])
    scalars.close()
    scalars = Scalars(tmp_path, [row(i) for i in range(3)])
    scalars.add([row(3) | {"best": 77.0}])
    scalars.close()
    found = told(tmp_path / FILE)
    assert sorted(found) == [0, 1, 2, 3] and found[3]["best"] == 77.0


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "tensorboard").write_text("a file")
    with pytest.raises(OutputError, match=r"cannot write .*tensorboard"):
        Scalars(tmp_path, [row(0)])


def test_a_missing_package_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX.proto.event_pb2", None)
    with pytest.raises(
        MissingWriterError, match=r"Install it: `.*-m pip install .*\[tensorboard\]'`"
    ):
        require_writer()
