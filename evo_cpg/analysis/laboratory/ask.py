"""Ask an animal a question: many settings, one program, one table."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.gait_numbers import gait_numbers
from evo_cpg.analysis.laboratory.bodies import Variants, build_bodies
from evo_cpg.analysis.laboratory.measures import (
    cut_numbers,
    cut_of,
    flume_notes,
    ground_speed,
    held,
    straight_drag,
    tow_numbers,
)
from evo_cpg.analysis.laboratory.settings import (
    NERVES,
    NOTHING,
    Setting,
    combinations,
    require_values,
)
from evo_cpg.analysis.laboratory.surgery import genes_of, prepare, require_effects
from evo_cpg.analysis.laboratory.trials import record_all
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recording, as_recording
from evo_cpg.simulation.simulation import Simulation


class Subject(NamedTuple):
    """The animal of a question.

    Attributes:
        config: its configuration.
        source: file of the configuration.
        folders: further folders with a user's own classes.
        genes: genes of its champion, or None for an animal without training.
    """

    config: ExperimentConfig
    source: Path
    folders: Sequence[Path] = ()
    genes: Float[np.ndarray, " g"] | None = None


class Meaning(NamedTuple):
    """Meaning of a measure.

    Attributes:
        unit: unit, empty for a pure number.
        definition: definition.
    """

    unit: str
    definition: str


class Answer(NamedTuple):
    """An answer: a row of measures for each setting.

    Attributes:
        settings: the settings.
        rows: values of the knobs and all measures of each setting, by name. Measures that do not
            exist are NaN.
        recordings: motion under each setting.
        notes: results that belong to several settings, one sentence each.
        simulations: trial of each setting.
        meanings: unit and definition of each measure, by name.
    """

    settings: list[Setting]
    rows: list[dict[str, Any]]
    recordings: tuple[Recording, ...] = ()
    notes: tuple[str, ...] = ()
    simulations: tuple[Simulation, ...] = ()
    meanings: Mapping[str, Meaning] = MappingProxyType({})

    def __repr__(self) -> str:
        return f"Answer({len(self.rows)} settings, {len(self.rows[0])} columns)"


def ask(
    subject: Subject, values: Mapping[str, Sequence[Any]], seconds: float | None = None
) -> Answer:
    """Simulate an animal under all combinations of values, in one program.

    Args:
        subject: the animal.
        values: values of each knob (`evo_cpg.analysis.laboratory.settings.KNOBS`), or of each key
            of the configuration.
        seconds: duration of a trial, s, or None for the duration in the configuration. The second
            half is measured.

    Raises:
        LabError: a knob or a value does not fit the animal.
        ConfigError: a number of the configuration is wrong.
    """
    require_values(values, seconds)
    settings = combinations(values)
    bodies = _prepared(subject, settings, seconds, "tow" in values)
    require_effects(bodies.common.controller, values)
    frames = record_all(bodies.simulation, _genes(subject, bodies, settings))
    simulations = tuple(bodies.of(i) for i in range(len(settings)))
    rows, recordings, cut = [], [], cut_of(settings)
    meanings: dict[str, Meaning] = {}
    drags: dict[tuple, float] = {}
    for i, setting in enumerate(settings):
        own = {name: values[..., i : i + 1] for name, values in frames.items()}
        simulation, creature = simulations[i], bodies.creatures[i]
        recording = as_recording(simulation, own, [body.name for body in creature.bodies])
        recordings.append(recording)
        if not np.isfinite(recording.position).all():
            rows.append(dict(setting))
            continue
        found = gait_numbers(simulation, creature, own, recording)
        quantities = list(found.quantities)
        if "tow" in setting:
            body = tuple(value for name, value in setting.items() if name not in NERVES)
            if body not in drags:
                drags[body] = straight_drag(simulation)
            quantities += tow_numbers(simulation, own, found, setting["tow"], drags[body])
        quantities.append(ground_speed(simulation, recording, found))
        if "cut" in setting:
            own_cut = setting["cut"] if setting["cut"] != NOTHING else cut
            quantities += cut_numbers(simulation.world.tree, recording, own_cut, found.first)
        rows.append(dict(setting) | {one.key: one.value for one in quantities})
        meanings |= {one.key: Meaning(one.unit, one.definition) for one in quantities}
    names = list(dict.fromkeys(name for row in rows for name in row))
    rows = [{name: row.get(name, np.nan) for name in names} for row in rows]
    notes = flume_notes(settings, rows)
    return Answer(settings, rows, tuple(recordings), notes, simulations, meanings)


def _prepared(
    subject: Subject, settings: list[Setting], seconds: float | None, is_towed: bool
) -> Variants:
    """Return the animals of all settings, without noise, in their first situation."""

    def prepared(simulation: Simulation) -> Simulation:
        steps = simulation.steps
        if seconds is not None:
            steps = max(2, round(seconds * simulation.control_rate))
        kind = subject.config.controller.type
        controller = prepare(simulation.controller, settings, subject.genes is not None, kind)
        return dataclasses.replace(
            simulation,
            world=held(simulation.world) if is_towed else simulation.world,
            controller=controller,
            steps=steps,
            noise=Noise(),
            situations=simulation.situations[:1],
        )

    return build_bodies(subject.config, subject.source, settings, subject.folders, prepared)


def _genes(
    subject: Subject, bodies: Variants, settings: Sequence[Setting]
) -> Float[np.ndarray, "g n"]:
    """Return the genes of all settings."""
    tree = bodies.common.world.tree
    genes = [
        genes_of(bodies.of(i).controller, tree, setting, subject.genes)
        for i, setting in enumerate(settings)
    ]
    return np.stack(genes, axis=-1).astype(np.float32)


class Column(NamedTuple):
    """A measure in a table.

    Attributes:
        key: name of the measure in the rows.
        head: head of the column, at most 9 characters.
        label: name with unit.
        decades: whether values often span decades, so that a picture needs a logarithmic axis.
        cycle: length of a cycle, for a phase, or 0.
    """

    key: str
    head: str
    label: str
    decades: bool = False
    cycle: float = 0.0


SWIMMING = (
    Column("path_speed", "U m/s", "speed along the path (m/s)"),
    Column("stride_frequency", "f Hz", "frequency (Hz)"),
    Column("strouhal", "St", "Strouhal number"),
    Column("wave_slip", "U/V", "slip U/V"),
    Column("froude_efficiency", "eta", "Froude efficiency"),
    Column("cost_of_transport", "CoT", "cost of transport", decades=True),
    Column("power", "P W", "mean power of the motors (W)", decades=True),
    Column("tail_excursion", "A m", "tail, peak to peak (m)"),
    Column("travelling_index", "travel", "travelling index"),
    Column("duty_factor", "duty", "duty factor"),
)

FLUME = (Column("ground_speed", "ground m/s", "speed over ground (m/s)"), *SWIMMING)

CUT = (
    SWIMMING[0],
    Column("front_frequency", "f1 Hz", "frequency in front of the cut (Hz)"),
    Column("behind_frequency", "f2 Hz", "frequency behind the cut (Hz)"),
    Column("cut_lag", "lag deg", "lag at the cut (degrees)", cycle=360.0),
    Column("cut_scatter", "scatter", "scatter of the lag (cycles)"),
    *SWIMMING[1:],
)

TOWED = (
    Column("holding_force", "F N", "mean force that holds it, forwards (N)"),
    Column("straight_drag", "D N", "drag of the straight body (N)"),
    Column("thrust", "T N", "thrust (N)"),
    Column("net_power", "P W", "mean net power of the motors (W)"),
    Column("efficiency", "eta", "efficiency of the thrust"),
    Column("holding_sway", "side N", "sideways force that holds it, rms (N)"),
    Column("holding_yaw", "yaw N m", "moment that holds its heading, rms (N m)"),
    Column("stride_frequency", "f Hz", "frequency (Hz)"),
)


def shown_columns(rows: Sequence[Mapping[str, Any]]) -> list[Column]:
    """Return the measures that exist under at least one setting, the most important first."""
    names = {name for row in rows for name in row}
    if "diverged" in names:
        # On courses the measures are the task's own.
        return [Column(name, name[:9], name) for name in rows[0] if name not in NERVES]
    kinds = {"holding_force": TOWED, "current": FLUME, "cut_lag": CUT}
    kind = next((kind for name, kind in kinds.items() if name in names), SWIMMING)
    return [
        column
        for column in kind
        if any(math.isfinite(row.get(column.key, math.nan)) for row in rows)
    ]
