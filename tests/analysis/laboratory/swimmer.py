"""A small swimmer for questions: four boxes in a row, in water with constant coefficients.

It swims forwards at full drive, a small adaptation gain and without feedback (`FORWARDS`).
"""

from pathlib import Path

import yaml

from evo_cpg.analysis.laboratory.ask import Subject
from evo_cpg.io.load import load_config

JOINT = {
    "parent": "head",
    "at": [-0.11, 0, 0],
    "child_at": [0.11, 0, 0],
    "axes": ["z"],
    "limits_deg": [-90, 90],
    "actuator": {"gain": 0.05},
}
SWIMMER = {
    "name": "ribbon",
    "creature": {
        "name": "ribbon",
        "materials": {"flesh": {"density": 1000}},
        "bodies": [
            {
                "name": "head",
                "shape": {"type": "box", "size": [0.2, 0.04, 0.1]},
                "material": "flesh",
            },
            {
                "name": "tail{i}",
                "repeat": 3,
                "shape": {"type": "box", "size": [0.2, 0.02, 0.1]},
                "material": "flesh",
                "joint": JOINT,
            },
        ],
    },
    "world": {"water": {"form_resolution": 1, "reactive_thrust": True, "form_drag": 0.1}},
    "simulation": {"seconds": 4, "substeps": 1},
    "controller": {
        "type": "brain_cpg",
        "rate_gain": 12.0,
        "max_rate": 8.0,
        "brain": {"hidden": [2]},
        "cpg": {"time_scale": 0.5, "feedback": {"stretch": [{"angle_weight": 2.0}]}},
    },
    "task": {"type": "distance"},
}


FORWARDS = {"u": [1.0], "b": [2.0], "feedback": [0.0]}


def subject(folder: Path, config: dict = SWIMMER) -> Subject:
    """Return the swimmer, with its configuration in a folder."""
    path = folder / "ribbon.yaml"
    path.write_text(yaml.safe_dump(config))
    return Subject(load_config(path), path)
