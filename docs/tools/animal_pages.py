"""Pages of the shipped animals, with living champions.

    python docs/tools/animal_pages.py RUN...

takes the champion of each run, which `evo-cpg train` or `evo-cpg reproduce`, and `evo-cpg analyse`,
made from a shipped configuration. Only its number of runs and its name may differ. It writes three
files into `docs/animals`:

- `NAME.json`: the numbers of the champion.
- `NAME.jpg`: a picture.
- `NAME.scene.gz`: the motion and the shapes, for the viewer.

    python docs/tools/animal_pages.py --redraw

draws the shapes of all animals anew, after a change of their look. The motions stay.

`generate.py` writes the text of the pages. As an extension of Sphinx, this file puts the animal
into its page: a frame with `NAME.animal.html`, which is one file without a network.
"""

import base64
import gzip
import hashlib
import json
import math
import re
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np

DOCS = Path(__file__).parents[1]
ANIMALS = DOCS / "animals"
_STILL, _QUALITY = (960, 540), 80
# Positions are rounded to at most this fraction of the animal's radius, which the eye cannot see.
_FINE = 1 / 4000
# Quaternions of 16 bits are rounded to multiples of this, 0.03 degrees.
_TURN = 8
# Entries of a scene, its terrain and its obstacles that are numbers of arrays.
_ARRAYS = {
    "position", "rotation", "focus", "speed", "distance", "x", "y", "z", "normals", "points",
    "triangles",
}  # fmt: skip
# Numbers on a page, in this order.
_SHOWN = (
    "speed", "speed_in_lengths", "stride_frequency", "strouhal", "duty_factor", "airborne",
    "cost_of_transport", "power",
)  # fmt: skip


def collect(run: Path) -> str:
    """Write the files of a run's champion, and return the name of the animal."""
    from evo_cpg.io.run import open_run
    from evo_cpg.io.shipped import shipped_names
    from evo_cpg.training.checkpoint import genes_digest
    from evo_cpg.view.film import Film, picture
    from evo_cpg.view.run_page.viewer_data import viewer_data
    from evo_cpg.view.scene import panel_of

    opened = open_run(run).with_champion()
    experiment, champion, meta = opened.experiment, opened.champion, opened.folder.read_meta()
    digest = _digest(opened.config)
    name = next((each for each in shipped_names() if config_digest(each) == digest), None)
    if name is None:
        raise ValueError(f"{run}: not the champion of a shipped configuration as it is now")
    # Runs of a study keep no motion.
    recording = opened.recording or opened.replay([champion], 0)[0].recording
    panel = panel_of(opened.own.experiment, recording, "")
    ANIMALS.mkdir(exist_ok=True)
    _write_scene(name, rounded(viewer_data(panel)))
    picture([panel], Film(_STILL)).save(ANIMALS / f"{name}.jpg", "JPEG", quality=_QUALITY)
    simulation, kept = experiment.simulation, meta.get("half_step") or {}
    same = kept.get("genes_sha256") == genes_digest(champion.genes)
    audit = _read(run / "audit.json")
    mine = all(audit.get(key) == getattr(champion, key) for key in ("generation", "fitness"))
    facts = {
        "config_sha256": digest,
        "bodies": len(experiment.creature.bodies),
        "axes": simulation.world.tree.dof_count,
        "mass_kg": float(f"{float(experiment.creature.mass):.4g}"),
        "genes": simulation.genome.count,
        "seed": opened.config.seed + champion.run,
        "generation": champion.generation,
        "fitness": float(f"{champion.fitness:.4g}"),
        "half_step": float(f"{kept['measured']:.3g}") if same and kept.get("measured") else None,
        "passed_audit": audit["passed"] if audit and mine else None,
        "gait": _gait(_read(run / "analysis.json")),
    }
    text = json.dumps(facts, indent=1, allow_nan=False, ensure_ascii=False)
    (ANIMALS / f"{name}.json").write_text(text + "\n", encoding="utf-8")
    return name


def redraw(name: str) -> None:
    """Replace the shapes in an animal's scene with those that this version draws."""
    from evo_cpg.io.build import build_creature
    from evo_cpg.io.load import load_config
    from evo_cpg.io.shipped import shipped
    from evo_cpg.view.run_page.viewer_data import Arrays, animal_data

    path = shipped(name).path
    creature = build_creature(load_config(path), path)
    file = ANIMALS / f"{name}.scene.gz"
    scene, arrays = json.loads(gzip.decompress(file.read_bytes())), Arrays()
    for found in (scene, scene["terrain"] or {}, *scene["obstacles"]):
        for key in _ARRAYS & found.keys():
            arrays.written.append(scene["arrays"][found[key]])
            found[key] = len(arrays.written) - 1
    scene |= animal_data(creature, arrays)
    scene["arrays"] = arrays.written
    _write_scene(name, scene)


def _write_scene(name: str, scene: dict[str, Any]) -> None:
    text = json.dumps(scene, separators=(",", ":"), allow_nan=False)
    (ANIMALS / f"{name}.scene.gz").write_bytes(gzip.compress(text.encode(), 9, mtime=0))


def config_digest(name: str) -> str:
    """Return the digest of a shipped configuration."""
    from evo_cpg.io.load import load_config
    from evo_cpg.io.shipped import shipped

    return _digest(load_config(shipped(name).path))


def _digest(config: Any) -> str:
    """Return the digest of all values of a configuration but its name and its number of runs."""
    from evo_cpg.io.run import fingerprint

    parts = fingerprint(config)["config"]
    values = json.dumps(
        {key: parts[key] for key in parts.keys() - {"name", "runs"}}, sort_keys=True
    )
    return hashlib.sha256(values.encode()).hexdigest()


def outdated() -> list[str]:
    """Return the names of animals whose configuration has changed since their champion evolved."""
    found = {path.stem: _read(path) for path in sorted(ANIMALS.glob("*.json"))}
    return [name for name, facts in found.items() if facts["config_sha256"] != config_digest(name)]


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def _gait(analysis: dict[str, Any]) -> list[tuple[str, str]]:
    from evo_cpg.view.run_page.html import quantity

    found = analysis.get("quantities", {})
    shown = [found[key] for key in _SHOWN if key in found]
    pairs = [(each["name"], quantity(each["value"], each["unit"])) for each in shown]
    return [pair for pair in pairs if pair[1]]


def rounded(scene: dict[str, Any]) -> dict[str, Any]:
    """Return the data of a viewer with rounded places and rotations, which compress better."""
    arrays = list(scene["arrays"])

    def coarser(number: int, kind: str, step: float) -> None:
        values = np.frombuffer(base64.b64decode(arrays[number]), kind)
        made = (np.round(values / step) * step).astype(kind)
        arrays[number] = base64.b64encode(made.tobytes()).decode()

    # A power of two leaves the last bits of each number zero.
    step = 2.0 ** math.floor(math.log2(scene["radius"] * _FINE))
    for key in ("position", "focus"):
        coarser(scene[key], "<f4", step)
    coarser(scene["rotation"], "<i2", _TURN)
    return scene | {"arrays": arrays}


def page(name: str) -> str:
    """Return the generated part of an animal's page."""
    from evo_cpg.io.shipped import shipped

    about = re.sub(r"(^|\. )docs/([\w/-]+\.md)", r"\1[This page](../\2)", shipped(name).about)
    about = re.sub(r"docs/([\w/-]+\.md)", r"[this page](../\1)", about)
    parts = [textwrap.fill(about, 100, break_long_words=False, break_on_hyphens=False)]
    study = next((link for start, link in _STUDIES if name.startswith(start)), None)
    if study:
        parts.append(f"Read more: {study}.")
    facts = _read(ANIMALS / f"{name}.json")
    if facts:
        parts.insert(0, f"![The champion of {title(name)}]({name}.jpg)")
    parts.append(f"```console\n$ evo-cpg train {name}\n$ evo-cpg render runs/{name}\n```")
    if facts:
        parts += ["## In numbers", _table(facts)]
    parts.append(
        "## Configuration\n\n"
        f"The website shows `configs/{name}.yaml` here. In the repository, open the file.\n\n"
        f"```{{literalinclude}} ../../configs/{name}.yaml\n:language: yaml\n```"
    )
    return "\n\n".join(parts)


def _table(facts: dict[str, Any]) -> str:
    rows = [
        ("bodies", facts["bodies"]),
        ("joint axes", facts["axes"]),
        ("mass", f"{facts['mass_kg']:.3g} kg"),
        ("genes", facts["genes"]),
        ("champion", f"generation {facts['generation']}, seed {facts['seed']}"),
        ("fitness", f"{facts['fitness']:.3g}"),
        *facts["gait"],
    ]  # fmt: skip
    if facts["half_step"] is not None:
        rows.append(("displacement left at half the step", f"{100 * facts['half_step']:.3g} %"))
    if facts["passed_audit"] is not None:
        rows.append(("passes its audit", "yes" if facts["passed_audit"] else "no"))
    return "\n".join(["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in rows)])


def cards(chosen: list[str]) -> str:
    """Return a gallery of animals, or of all animals if none is chosen."""
    from evo_cpg.io.shipped import shipped_names

    base = "animals/" if chosen else ""
    lines = []
    for name in chosen or shipped_names():
        picture = (
            f"![Picture of {title(name)}]({base}{name}.jpg)\n  "
            if (ANIMALS / f"{name}.jpg").is_file()
            else ""
        )
        lines.append(f"- [{picture}{title(name)}]({base}{name}.md)")
    return ":::{container} gallery\n" + "\n".join(lines) + "\n:::"


def new_pages() -> list[Path]:
    """Return the pages that do not exist, one for each shipped configuration."""
    from evo_cpg.io.shipped import shipped_names

    found = [ANIMALS / f"{name}.md" for name in shipped_names()]
    return [path for path in found if not path.is_file()]


def empty_page(name: str) -> str:
    """Return the page of an animal without its generated part."""
    return f"# {title(name)}\n\n<!-- begin animal {name} -->\n<!-- end -->\n"


def title(name: str) -> str:
    """Return a name as a title."""
    return TITLES.get(name, name.replace("_", " ").capitalize())


TITLES = {
    "fukui2003_model1": "Fukui 2003, Model 1",
    "fukui2003_model2": "Fukui 2003, Model 2",
    "fukui2003_model3": "Fukui 2003, Model 3",
    "fukui2003_model1_robust": "Fukui 2003, Model 1, robust",
    "fukui2003_model2_robust": "Fukui 2003, Model 2, robust",
    "fukui2003_model3_robust": "Fukui 2003, Model 3, robust",
    "fukui2003_model1_open_es": "Fukui 2003, Model 1, with OpenAI-ES",
    "evolving_swimmer": "Swimmer with evolving proportions",
    "evolving_walker": "Walker with evolving proportions",
    "follow_the_light": "Virtual creatures that follow a light",
    "virtual_creatures_land": "Virtual creatures on land",
    "virtual_creatures_water": "Virtual creatures in water",
    "iwadate2010_swimmer": "Swimmer of Iwadate 2010",
    "iwadate2010_salamander_land": "Salamander on land",
    "iwadate2010_salamander_water": "Salamander in water",
    "salamander_amphibious": "Salamander at the shore",
    "salamander_boulders": "Salamander among boulders",
    "salamander_swim": "Swimming salamander",
    "salamander_trot": "Trotting salamander",
    "hexapod": "Hexapod with postures",
    "hexapod_tripod": "Insect on tripods",
    "starfish": "Starfish in water",
    "starfish_land": "Starfish on land",
    "swimmer_gaits": "Gaits of the swimmer",
    "two_eyed_swimmer": "Swimmer with two eyes",
    "walker_gaits": "Gaits of a walker",
    "waypoints": "Fish that swims from light to light",
    "land_waypoints": "Salamander that walks from light to light",
    "moving_light": "Salamander that follows a moving light",
    "fleeing_light": "Salamander that chases a light",
    "cross_current": "Salamander in a cross current",
    "reef": "Salamander in a reef",
    "vortex_street": "Salamander in a vortex street",
}

_STUDIES = (
    ("fukui2003", "[the study of Fukui 2003](../reproduction/fukui2003.md)"),
    ("walker_gaits", "[maps of gaits](../searches.md)"),
    ("swimmer_gaits", "[maps of gaits](../searches.md)"),
    ("iwadate2010_swimmer", "[the study of Iwadate 2010](../reproduction/iwadate2010.md)"),
    ("salamander_trot", "[a gait for a walker](../walker.md)"),
    ("salamander_swim", "[a gait for a walker](../walker.md)"),
    ("hexapod_tripod", "[a gait for a walker](../walker.md)"),
    ("hexapod", "[the study of the hexapod](../reproduction/hexapod.md)"),
    ("iwadate2010_salamander", "[the study of the salamander](../reproduction/salamander.md)"),
    ("salamander_amphibious", "[the study of the amphibian](../reproduction/amphibian.md)"),
    ("salamander", "[the study of the salamander](../reproduction/salamander.md)"),
    ("two_eyed", "[the study of the salamander](../reproduction/salamander.md)"),
    ("starfish", "[the study of the starfish](../reproduction/starfish.md)"),
    ("turtle", "[the tutorial](../tutorials/turtle.md)"),
    ("ant", "[cheetah and ant](../runners.md)"),
    ("half_cheetah", "[cheetah and ant](../runners.md)"),
    ("eel", "[eel, fish and worm](../swimmers.md)"),
    ("fish", "[eel, fish and worm](../swimmers.md)"),
    ("worm", "[eel, fish and worm](../swimmers.md)"),
    *(
        (name, "[worlds that need a brain](../reproduction/worlds.md)")
        for name in (
            "waypoints",
            "moving_light",
            "fleeing_light",
            "cross_current",
            "vortex_street",
            "reef",
            "land_waypoints",
        )
    ),
)


def _with_frame(app: Any, docname: str, source: list[str]) -> None:
    """Put the living animal in place of its picture."""
    folder, _, name = docname.rpartition("/")
    if folder != "animals" or not (ANIMALS / f"{name}.scene.gz").is_file():
        return
    frame = (
        f'<div class="living"><iframe src="{name}.animal.html" title="{title(name)}"></iframe>'
        f'<p><a href="{name}.animal.html">The animal alone, in one file</a></p></div>'
    )
    source[0] = re.sub(r"!\[[^]]*\]\([^)]*\)", lambda _: frame, source[0], count=1)


def _write_animals(app: Any, failed: Exception | None) -> None:
    """Write one file for each animal, with its viewer."""
    from evo_cpg.view.run_page.document import animal_alone

    if failed or app.builder.name != "html":
        return
    for path in sorted(ANIMALS.glob("*.scene.gz")):
        name = path.name.removesuffix(".scene.gz")
        scene = json.loads(gzip.decompress(path.read_bytes()))
        text = animal_alone(title(name), scene, (ANIMALS / f"{name}.jpg").read_bytes())
        (Path(app.outdir) / "animals" / f"{name}.animal.html").write_text(text, encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Register the pages with Sphinx."""
    app.connect("source-read", _with_frame)
    app.connect("build-finished", _write_animals)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    if sys.argv[1:] == ["--redraw"]:
        for path in sorted(ANIMALS.glob("*.scene.gz")):
            redraw(path.name.removesuffix(".scene.gz"))
    else:
        for folder in sys.argv[1:]:
            print(collect(Path(folder)))
