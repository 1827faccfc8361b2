"""Creatures of imported models, as they are written to YAML and read again."""

import yaml

from evo_cpg.creature.creature import Creature
from evo_cpg.io.models.mjcf_import import Imported
from evo_cpg.io.schema.creature import CreatureConfig
from evo_cpg.io.yaml_text import to_yaml


def creature_of(imported: Imported) -> Creature:
    """Return the creature of an import."""
    text = to_yaml(imported.experiment["creature"])
    return CreatureConfig.model_validate(yaml.safe_load(text)).build()
