"""The text of a new document: one body in water, to which parts are added."""

import re

_BLANK = """\
# Drawn with `evo-cpg model`. Lengths are in m, angles in degrees. x is ahead, y left, z up.
name: {name}
creature:
  name: {name}
  materials:
    flesh: {{density: 1000}}
  bodies:
    - name: body
      shape: {{type: box, size: [0.2, 0.1, 0.1]}}
      material: flesh
world:
  gravity: 9.81
  water: {{density: 1000}}
  ground: null
"""


def blank(stem: str) -> str:
    """Return the text of a new document.

    Args:
        stem: name of its file without the suffix, which names the animal, too.
    """
    return _BLANK.format(name=re.sub(r"[^A-Za-z0-9_]+", "_", stem).strip("_") or "animal")
