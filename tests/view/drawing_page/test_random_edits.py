"""Random edits: each is made or refused in words, leaves an animal that runs, and is undone."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from random_edits import RandomEdits

from evo_cpg.analysis.laboratory.trials import record_all
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import complete_config, load_config
from evo_cpg.io.yaml_text import to_yaml
from evo_cpg.view.drawing_page.commands import COMMANDS
from evo_cpg.view.drawing_page.document import Document
from evo_cpg.view.drawing_page.session import DrawingSession, problems

CONFIGS = Path(__file__).parents[3] / "configs"
# Largest number of bodies that an edit may leave, so that simulations compile in seconds.
LARGEST = 16
# Their controllers name parts by patterns. A renamed part leaves an animal that is refused.
NAMING = ("starfish_land", "turtle", "hexapod")

# Comments, an anchor, a merge, a row, a mirrored limb and a star, in block and in flow style.
RICH = """\
# A beast.
name: beast   # its name
creature:
  name: beast
  materials:
    flesh: &flesh {density: 1000}  # as water
    bone: {<<: *flesh, density: 1100}
  bodies:
    # The trunk carries all others.
    - name: trunk
      shape: {type: ellipsoid, radii: [0.1, 0.05, 0.04]}
      material: flesh
    - name: tail{i}
      repeat: 3        # a row
      shape: &bar {type: box, size: [0.06, 0.03, 0.03]}
      material: flesh
      joint: &hinge
        parent: trunk
        at: [-0.1, 0, 0]
        child_at: [0.035, 0, 0]
        axes: [z]
        limits_deg: [-40, 40]   # sideways
        actuator: {gain: 2.0e+0}
    - {name: "{side}_fin", mirror: y, shape: *bar, material: bone, joint: {<<: *hinge,
        at: [0.02, 0.05, 0], child_at: [-0.035, 0, 0], rotation_deg: [0, 0, 90]}}
    - name: feeler_{j}
      radial: 3
      shape:
        type: capsule
        radius: 0.006
        length: 0.05
      material: bone
      joint: {parent: trunk, at: [0.06, 0, 0.03], child_at: [-0.03, 0, 0], axes: [y, z]}
  light_sensors:
    - {body: trunk, position: [0.1, 0, 0]}   # an eye
  pressure_sensors: ["{side}_fin", trunk]
  tendons:
    - {name: cord, joints: {tail1.z: 1, tail2.z: -1}, stiffness: 0.01}
world: {water: {density: 1000}, ground: null}
"""
MJCF = """\
<mujoco model="cat"><worldbody><body name="torso" pos="0 0 0.7"><freejoint/>
<geom type="box" size="0.1 0.05 0.05"/><body name="hip" pos="0.1 0.05 0">
<joint name="swing" axis="0 0 1" range="-40 50"/><joint name="lift" axis="0 1 1"/>
<geom type="capsule" size="0.01" fromto="0 0 0 0.1 0.05 -0.1"/></body></body></worldbody>
<actuator><motor joint="swing" gear="0.5" ctrlrange="-1 1"/></actuator></mujoco>
"""
# Words of Python's own errors, which tell a user nothing.
FOREIGN = re.compile(
    r"Traceback|NoneType|unhashable|operand|not supported between|float\(\)|object has no|"
    r"not callable|subscriptable|not iterable|codec|Errno|<class|KeyError|not possible here"
)


def opened(start: str, folder: Path) -> Document:
    """Return the document of a start: a shipped configuration, or a text of this file."""
    if start == "blank":
        return Document.new(folder / "blank.yaml")
    if start == "imported":
        from evo_cpg.io.models.mjcf_import import read_model

        pytest.importorskip("mujoco")
        (folder / "cat.xml").write_text(MJCF)
        text = to_yaml(read_model(folder / "cat.xml").experiment)
    elif start == "rich":
        text = RICH
    else:
        return Document.copy_of(CONFIGS / f"{start}.yaml", folder / "copy.yaml")
    (folder / "start.yaml").write_text(text)
    return Document.open(folder / "start.yaml")


def is_broken(answer: dict) -> bool:
    """Return whether an animal is not drawn, or whether its values are refused."""
    return not answer["scene"] or any(each["kind"] == "error" for each in answer["problems"])


def require_plain(words: str) -> None:
    assert words and "\n" not in words and len(words) < 1000
    assert not FOREIGN.search(words), words


def require_motion(document: Document) -> bool:
    """Require that an animal without errors moves for a few steps with finite numbers."""
    found = [each for each in problems(document.data, document.path) if each.kind == "error"]
    for each in found:
        require_plain(each.words)
    document.path.with_name("written.yaml").write_text(document.texts.main, encoding="utf-8")
    if found:
        with pytest.raises(ConfigError):
            path = document.path.with_name("written.yaml")
            build_experiment(load_config(path), path)
        return False
    data = document.data
    data["simulation"] = {**(data.get("simulation") or {}), "seconds": 0.05}
    config = complete_config(data, document.path)
    simulation = build_experiment(config, document.path).simulation
    frames = record_all(simulation, np.full((simulation.genome.count, 1), 0.5))
    for name, values in frames.items():
        assert np.isfinite(values).all(), name
    return True


@pytest.mark.parametrize(
    ("start", "count", "sense"),
    [
        ("rich", 20, 0.9),
        *(
            pytest.param(start, 500, sense, marks=pytest.mark.slow)
            for start in ("blank", "rich", "imported", "starfish_land", "turtle", "hexapod")
            for sense in (0.98, 0.8)
        ),
    ],
)
@pytest.mark.slow
def test_random_edits_leave_an_animal_that_runs_or_is_refused(tmp_path, start, count, sense):
    document = opened(start, tmp_path)
    session, first = DrawingSession(document), document.texts
    edits, every = RandomEdits(document, count, sense), 125
    made = refused = ran = 0
    for i in range(1, count + 1):
        command, given = edits.next()
        before = document.texts
        request = {"command": command, "given": json.loads(json.dumps(given)), "accept": True}
        answer = json.loads(json.dumps(session.answer("edit", request)))
        if "error" in answer:
            refused += 1
            require_plain(answer["error"])
            assert document.texts == before
        else:
            made += 1
        if answer["undrawn"]:
            require_plain(answer["undrawn"])
            assert any(each["kind"] == "error" for each in answer["problems"])
        # A broken or large animal is rarely edited further.
        while document.can_undo and (is_broken(answer) or len(answer["scene"]["bodies"]) > LARGEST):
            if edits.draw.random() < 0.1:
                break
            answer = session.answer("undo", {})
        if i % every == 0:
            ran += require_motion(document)
    assert made > count / 4 and refused > count / 10
    assert ran or count < 100 or start in NAMING
    last, undone = document.texts, 0
    while document.can_undo:
        document.undo()
        undone += 1
    assert document.texts == first
    for _ in range(undone):
        document.redo()
    assert document.texts == last


def test_random_edits_know_all_commands(tmp_path):
    edits = RandomEdits(opened("blank", tmp_path), 1)
    assert {edits.next()[0] for _ in range(1000)} == COMMANDS.keys()
