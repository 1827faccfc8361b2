"""Wrong input of every kind: one or two lines, exit code 2, and no file is changed."""

import re
import shutil
import sys

import pytest
import yaml

from tiny_run import CONFIG, REPOSITORY, TINY, contents, own_config

TASKS = """
import jax.numpy as jnp
from evo_cpg.control.controller import Command, Controller
from evo_cpg.simulation.sensors import Sensor
from evo_cpg.simulation.task import Task

class NotATask: ...

class Unfinished(Task): ...

class Jump(Task):
    light: tuple[float, float, float] = (1.0, 0.0, 0.0)
    height: float = 1.0

    def __check_init__(self):
        if self.height < 0:
            raise ValueError(f"height must not be negative, got {self.height}")
        if self.height > 100:
            raise KeyError(f"tail{self.height:g}.z")

    def begin(self, batch, dtype, steps):
        return jnp.zeros(batch, dtype)

    def update(self, tally, transition, steps):
        return tally

    def terms(self, tally, steps):
        return {"jump": tally}

    def fitness(self, terms, scales):
        return terms["jump"]

class Forgets(Jump):
    def update(self, tally, transition, steps):
        return tally[None]

class Nameless(Jump):
    def terms(self, tally, steps):
        return tally

class Wholesale(Jump):
    def fitness(self, terms, scales):
        return terms["jump"].mean()

class Unreal(Jump):
    def fitness(self, terms, scales):
        return terms["jump"] * 1j

class Ranked(Jump):
    def fitness(self, terms, scales):
        return terms["jump"][jnp.argsort(terms["jump"])]

class Listed(Jump):
    def descriptors(self, terms):
        return [terms["jump"]]

class Described(Jump):
    def descriptors(self, terms):
        return {"energy": terms["energy"]}

class Worded(Jump):
    def descriptors(self, terms):
        return {"jump": "high"}

class Measured(Jump):
    def scales(self, terms):
        return terms["jump"].max()

class Lost(Jump):
    def update(self, tally, transition, steps):
        return transition.after.position[2, transition.after.body("nose")]

class Numb(Sensor):
    count: int = 2

    def sense(self, snapshot, forces):
        return snapshot.state.velocity[:3]

class Stiff(Controller):
    gene_count: int = 1

    def random_genes(self, key, batch, dtype):
        return jnp.zeros((1, *batch), dtype)

    def initial_state(self, batch, dtype):
        return jnp.zeros(batch, dtype)

    def act(self, decoded, state, observation):
        return state, Command(decoded, decoded)
"""


@pytest.fixture
def refused(cli, tmp_path, monkeypatch):
    """Return a function that runs the program, checks the form of its error and returns it."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> str:
        before = contents(tmp_path)
        err = cli.refuses(*arguments)
        assert err.startswith("evo-cpg: ") and err.endswith("\n") and 1 <= err.count("\n") <= 2
        assert "Traceback" not in err
        assert contents(tmp_path) == before
        return err.removeprefix("evo-cpg: ").removesuffix("\n")

    return call


@pytest.mark.parametrize("command", ["train", "validate", "preview"])
def test_every_command_rejects_an_invalid_config(refused, tmp_path, command):
    path = tmp_path / "newt.yaml"
    path.write_text("name: x\ncreature: {name: y, bodies: [}\n")
    assert refused(command, path).startswith(f"{path}: line 2, column ")
    assert "no such file: did you mean 'newt.yaml'?" in refused(command, tmp_path / "my_newt.yaml")
    assert "cannot be read (Is a directory)" in refused(command, tmp_path)


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("controller.cpg.pair_wait=1", "pair_wait: unknown key: did you mean"),
        ("simulation.start=[0, 0, -3]", "at most 2"),
        ('creature.bodies.0.name="a\\nb"', "on one line"),
        ('creature.bodies.0.name="a\\e[1m"', "on one line"),
        ("creature.bodies.².repeat=5", "creature.bodies has no ²"),
        ('name="a\\0b"', "name: 'a\\x00b'"),
        ("task.light_weight=2", "eq. 10"),
        (f"world.ground={'1' * 400}", "world.ground"),
    ],
)
def test_invalid_setting_is_rejected_before_any_output(refused, override, expected):
    assert expected in refused("train", CONFIG, override, "--out", "run")


@pytest.mark.parametrize(
    ("earlier", "later"),
    [
        ("seed=1", "seed=2"),
        ("creature.bodies.1.repeat=2", "creature.bodies.01.repeat=3"),
        ("evolution.population=40", "evolution={type: random}"),
    ],
)
def test_an_override_that_another_replaces_is_named(cli, earlier, later):
    code, _, err = cli("validate", CONFIG, earlier, later)
    words = f"{earlier.partition('=')[0]} is given twice. Only the last value counts: {later}"
    assert code == 0 and words in err


def test_invalid_output_folder_is_rejected(refused, tmp_path):
    used, other = tmp_path / "used", tmp_path / "other"
    for folder in (used, other):
        folder.mkdir()
    (used / "config.yaml").write_text("name: mine\n")
    (other / "thesis.tex").write_text("years of work")
    for place, words in (
        (used, f"`evo-cpg resume {used}`"),
        (other, "holds no run"),
        ("/proc/run", "cannot write /proc/run ("),
    ):
        assert words in refused("train", CONFIG, *TINY, "--out", place)


@pytest.mark.parametrize(
    "command", ["resume", "verify", "render", "plot", "refine", "audit", "analyse", "watch"]
)
def test_folder_without_a_run_is_rejected(refused, tmp_path, command):
    for place in (tmp_path, CONFIG):
        assert "is not a run folder" in refused(command, place)


@pytest.mark.parametrize("command", ["resume", "watch", "analyse"])
def test_a_missing_run_folder_is_called_missing(refused, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    assert "evo-cpg train CONFIG --out runs/first" in refused(command, "runs/first")
    (tmp_path / "runs" / "Swim-2026").mkdir(parents=True)
    (tmp_path / "runs" / "Swim-2026" / "config.yaml").touch()
    for name in ("runs/Swim", "runs/swim-2025", "Swim-2026"):
        assert refused(command, name).endswith("did you mean 'runs/Swim-2026'?")
    assert refused(command, "runs").endswith("It holds runs, such as runs/Swim-2026")
    assert "is a part of a run" in refused(command, "runs/Swim-2026/config.yaml")


@pytest.mark.parametrize(
    "arguments",
    [
        ("lab", "runs/first"),
        ("export", "runs/first", "x.glb"),
        ("train", "eel", "--from", "runs/first"),
    ],
)
def test_a_missing_run_in_another_place_is_called_missing(refused, arguments):
    assert "runs/first: there is no such folder" in refused(*arguments)


def test_a_run_folder_is_no_configuration(refused, tmp_path):
    (tmp_path / "config.yaml").touch()
    message = refused("train", tmp_path)
    assert message.startswith(f"{tmp_path} is a run folder. `evo-cpg resume {tmp_path}` continues")


def test_run_with_a_broken_config_or_no_champion_is_rejected(refused, tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    (run / "config.yaml").write_text("name: [")
    for command in ("resume", "verify", "render", "plot"):
        assert "config.yaml: line 2" in refused(command, run)
    (run / "config.yaml").write_text(yaml.safe_dump(own_config()))
    for command in ("verify", "render", "plot"):
        assert "has no champion yet" in refused(command, run)


@pytest.mark.parametrize(
    ("command", "options", "words"),
    [
        ("preview", ("--size", "12x12"), "the smallest is 16 x 16"),
        ("preview", ("-o", "body.mp4"), "the name ends in '.mp4'"),
        ("render", ("-o", "film.avi"), "the name ends in '.avi'"),
        ("render", ("-o", "no/film.mp4"), "there is no folder"),
        ("render", ("--size", "big"), "--size: 'big'"),
        ("render", ("--size", "10x10"), "the smallest is 16 x 16"),
        ("render", ("--size", "99999x99999"), "the largest is 8192 x 8192"),
        ("render", ("--sheet", "4x0"), "--sheet: '4x0'"),
        ("render", ("--sheet", "9x9", "--seconds", "0.1"), "the film has 4 frames"),
        ("render", ("--sheet", "4x3", "-o", "film.mp4"), "Use .png"),
        ("render", ("--speed", "inf"), "must be positive and finite"),
        ("probe", ("--bearings", "left"), "--bearings: 'left' is neither"),
        ("probe", ("--bearings", "0:90"), "--bearings: '0:90' is neither"),
        ("probe", ("--bearings", "0:90:0"), "at most 10000 numbers"),
        ("probe", ("--bearings", "0:90:20000"), "--bearings: '0:90:20000' is neither"),
        ("probe", ("--bearings", "0:9:200", "--distances", "1:9:100"), "20000 lights. Allowed"),
        ("probe", ("--distances", ""), "--distances: '' is neither"),
        ("probe", ("--distances", "nan"), "--distances: 'nan' is neither"),
        ("probe", ("--distances", "3,-2"), "distances: must be greater than 0"),
        ("probe", ("--distances", "1e9"), "1e+09 m: the light at"),
        ("probe", ("--trials", "--bearings", "0"), "Leave out --bearings and"),
        ("probe", ("--run", "3"), "has 1 run(s)"),
        ("probe", ("--out", "/proc/no/where"), "cannot write /proc/no/where ("),
        ("render", ("--story", "--sheet", "2x2"), "--story and --sheet exclude"),
        ("render", ("--story", "--crowd", "0"), "--story and --crowd exclude"),
        ("render", ("--story", "--wall", "0"), "--story and --wall exclude"),
        ("render", ("--wall", "0", "--crowd", "0"), "--crowd and --wall exclude"),
        ("render", ("--wall", "0", "--signals"), "--wall and --signals exclude"),
        ("render", ("--wall", "0", "--camera", "top"), "--wall and --camera exclude"),
        ("render", ("--wall", "0", "--sheet", "2x2", "-o", "a.html"), "--wall and --sheet exclude"),
        ("render", ("--lineage", "ancestors"), "its search does not evolve body plans"),
        ("render", ("--lineage", "parents"), "is neither auto, ancestors nor a list"),
        ("render", ("--lineage", "ancestors", "--signals"), "--lineage ancestors and --signals"),
        ("render", ("--story", "--speed", "2"), "--story and --speed exclude"),
        ("render", ("--story", "--title", "a", "--title", "b"), "2 titles for one story"),
        ("render", ("--story", "-o", "a.png"), "Use .mp4"),
        ("lab", ("u",), "'u' is not KNOB=VALUES, such as u=0.2,0.6 or u=0.2:1:9"),
        ("lab", ("u=1", "u=2"), "u is given twice"),
        ("lab", ("u=0:1",), "is neither START:STOP:COUNT"),
        ("lab", ("u=0:1:3:lin",), "is neither START:STOP:COUNT"),
        ("lab", ("u=1", "--run", "1"), "is a configuration, not a run folder"),
        ("lab", ("u=1", "--out", CONFIG), f"{CONFIG.name} is a file. --out is a folder"),
        ("lab", ("u=1", "simulation.substeps=9"), "is a whole number"),
        ("audit", ("half_stp=0.5",), "Did you mean half_step?"),
        ("audit", ("xyz=1",), "Allowed: half_step, "),
        *(("audit", (f"half_step={x}",), "is no limit") for x in ("", "-1", "nan", "1_0")),
        ("audit", ("--all", "--run", 0), "--all and --run exclude each other"),
        ("audit", ("--all", "--cell", "0,0"), "--all and --cell exclude each other"),
    ],
)
def test_wrong_options_are_rejected(refused, finished_run, command, options, words):
    subject = CONFIG if command in ("lab", "preview") else finished_run
    assert words in refused(command, subject, *options)


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("task={type: 'no_such_module:Task'}", "cannot be imported (no mod"),
        ("task={type: 'my_tasks:Jmup'}", "(AttributeError"),
        ("task={type: 'broken_tasks:Jump'}", "(SyntaxErr"),
        ("task={type: '..my_tasks:Jump'}", "(TypeError"),
        ("task={type: 'my_tasks:NotATask'}", "is not a subclass"),
        ("task={type: 'my_tasks:Unfinished'}", "cannot be built with these"),
        ("task={type: 'my_tasks:Jump', options: {height: 101}}", "(KeyError: 'tail101.z')"),
        ("task={type: 'my_tasks:Jump', options: {hieght: 2}}", "cannot be built with these"),
        ("task={type: 'my_tasks:Jump', options: {height: -2}}", "height must not be negative"),
        ("task={type: 'my tasks:Jump'}", "must be a module and a class"),
        ("task={type: 'my_tasks:Forgets'}", "Forgets.update must return"),
        ("task={type: 'my_tasks:Nameless'}", "Nameless.terms must return"),
        ("task={type: 'my_tasks:Wholesale'}", "Wholesale.fitness must return"),
        ("task={type: 'my_tasks:Unreal'}", "Unreal.fitness must return"),
        ("task={type: 'my_tasks:Ranked'}", "Ranked.fitness fails at line 51"),
        ("task={type: 'my_tasks:Listed'}", "Listed.descriptors must return"),
        ("task={type: 'my_tasks:Described'}", "Described.descriptors fails at line 59"),
        ("task={type: 'my_tasks:Worded'}", "Worded.descriptors must return"),
        ("task={type: 'my_tasks:Measured'}", "Measured.scales must return"),
        ("task={type: 'my_tasks:Lost'}", "Lost.update fails at line 71"),
        ("creature.sensors=[{type: 'my_tasks:Numb'}]", "Numb.sense must return"),
        ("creature.sensors=[{type: 'my_tasks:Jump'}]", "is not a subclass"),
        ("creature.sensors=[{type: velocty}]", "'velocty' is not known"),
        ("creature.sensors=[{body: head}]", "creature.sensors.0.type: is missing"),
        ("creature.sensors=[{type: velocity, body: hed}]", "did you mean 'head'?"),
        ("controller={type: 'my_tasks:Stiff'}", "Stiff.act must return"),
    ],
)
def test_invalid_classes_of_ones_own_are_rejected(
    refused, tmp_path, monkeypatch, override, expected
):
    config = config_with_tasks(tmp_path, monkeypatch)
    (tmp_path / "x.yaml").write_text(yaml.safe_dump(config))
    message = refused("train", "x.yaml", override, "--out", "run")
    assert override.partition("=")[0] in message and expected in message


def config_with_tasks(tmp_path, monkeypatch):
    """Write the modules of tasks, and return a configuration that can use them."""
    (tmp_path / "my_tasks.py").write_text(TASKS)
    (tmp_path / "broken_tasks.py").write_text("def :\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.delitem(sys.modules, "my_tasks", raising=False)
    return own_config()


def test_validate_reports_every_file_and_fails_if_one_is_wrong(cli, tmp_path):
    (tmp_path / "x.yaml").write_text("nam: x\n")
    code, out, err = cli("validate", tmp_path / "x.yaml", CONFIG)
    assert code == 2
    assert out == f"{CONFIG}: 10 bodies, 27 joint axes, 20 kg, 1639 genes\n"
    assert err.startswith(f"evo-cpg: {tmp_path / 'x.yaml'}: line 1: nam: unknown key: did you")
    assert err.count("\n") == 1


BOX = {
    "name": "box",
    "creature": {
        "name": "box",
        "materials": {"m": {"density": 1000}},
        "bodies": [{"name": "b", "shape": {"type": "box", "size": [0.1] * 3}, "material": "m"}],
    },
    "world": {"water": None, "ground": {}},
    "controller": {"type": "evo_cpg.control.commanded:Commanded"},
    "task": {"type": "distance"},
    "evolution": {"population": 4, "elites": 1, "generations": 2},
}


def test_controller_without_genes_is_not_evolved(cli, tmp_path):
    """Such a creature can be exported."""
    path, folder = tmp_path / "box.yaml", tmp_path / "run"
    path.write_text(yaml.safe_dump(BOX))
    for command in (
        ("validate", path),
        ("train", path, "--out", folder),
        ("sweep", path, "--grid", "seed=1,2", "--out", folder),
    ):
        assert "controller: Commanded has no genes" in cli.refuses(*command)
    assert not folder.exists()
    assert cli("export", path, tmp_path / "box.xml")[0] == 0
    folder.mkdir()
    path.rename(folder / "config.yaml")
    assert "Commanded has no genes" in cli.refuses("resume", folder)
    assert [each.name for each in folder.iterdir()] == ["config.yaml"]


@pytest.mark.slow
def test_validate_accepts_every_shipped_config(cli):
    paths = sorted((REPOSITORY / "configs").glob("*.yaml"))
    code, out, err = cli("validate", *paths)
    assert code == 0 and out.count("\n") == len(paths)
    # The turtle's paddles hold an angle (docs/tutorials/turtle.md), and the ant couples no joints.
    # Long work also prints its progress.
    found = re.findall(r"^evo-cpg: warning: .*?(\w+)\.yaml: (.*?):", err, re.MULTILINE)
    assert found == [
        ("ant", "coupled to no other oscillator"),
        ("turtle", "coupled to no other oscillator, and at rest under a constant drive"),
    ]


TRIPOD = REPOSITORY / "configs/hexapod_tripod.yaml"
PAIRS = ", ".join(
    f"{{oscillators: [{leg}_left_femur.z, {leg}_right_femur.z], lag_deg: 180}}"
    for leg in ("front", "middle", "hind")
)


@pytest.mark.parametrize(
    ("rings", "groups"),
    [
        ("", "6 groups of limbs are not coupled to each other"),
        (PAIRS, "3 groups of limbs are not coupled to each other"),
        ("{oscillators: ['*_femur.z'], lag_deg: 60}", None),
    ],
    ids=["no ring", "pairs", "one ring"],
)
def test_legs_that_are_not_coupled_get_a_warning(cli, rings, groups):
    _, err = cli.passes("validate", TRIPOD, f"controller.cpg.rings=[{rings}]")
    if groups is None:
        assert err == ""
    else:
        assert groups in err and "front_left_femur, front_" in err
        assert "such as rings: [{oscillators: [front_left_femur.z, " in err
        assert err.endswith("(docs/walker.md)\n")


@pytest.mark.parametrize(
    "arguments", [["train"], ["train", CONFIG, "--cores", 0], ["fly"], ["verify", "--fast"]]
)
def test_invalid_command_line_prints_the_usage(cli, arguments):
    err = cli.refuses(*arguments)
    assert "Usage: evo-cpg" in err and "Traceback" not in err


@pytest.mark.parametrize(
    "arguments", [("render", "run", "--camera", "front"), ("train", CONFIG, "--start", "front")]
)
def test_invalid_choice_lists_the_choices(cli, arguments):
    assert f"Invalid value for '{arguments[2]}': 'front' is not one of '" in cli.refuses(*arguments)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ((), "and at rest under a constant drive"),
        (("controller.cpg.pair_weight=1.3",), "coupled to no other oscillator: arm1_1.z, arm4_1.z"),
    ],
)
def test_uncoupled_oscillators_get_a_warning_with_a_remedy(cli, tmp_path, settings, words):
    shutil.copytree(REPOSITORY / "configs/creatures", tmp_path / "creatures")
    path = tmp_path / "starfish_land.yaml"
    text = (REPOSITORY / "configs/starfish_land.yaml").read_text()
    path.write_text(re.sub(r"\n      - \{source: .arm\[145\].*", "", text))
    ring = "{oscillators: [arm1_1.z, arm4_1.z, arm5_1.z], lag_deg: 120}"
    code, _, err = cli("validate", path, *settings)
    assert code == 0 and words in err and f"rings: [{ring}]" in err
    if settings:
        # The remedy, beside the ring of the lifts.
        both = f"[{{oscillators: ['arm*_1.y'], lag_deg: 72, weight: 2}}, {ring}]"
        code, _, err = cli("validate", path, *settings, f"controller.cpg.rings={both}")
        assert (code, err) == (0, "")


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("constant_input=-2", "max_tonic_input + constant_input is -1"),
        ("constants=as_printed", "is more than 8.71"),
    ],
)
def test_resting_oscillators_get_a_warning(cli, setting, words):
    code, _, err = cli("validate", CONFIG, f"controller.cpg.{setting}")
    assert code == 0 and ": at rest under a constant drive: segment1.x" in err and words in err


@pytest.mark.parametrize(
    ("command", "words"),
    [("train", "such as iwadate2010_swimmer"), ("render", "Name a run folder"), ("lab", "eel")],
)
def test_a_missing_argument_gets_an_example(cli, tmp_path, command, words):
    assert words in cli.refuses(command, folder=tmp_path).splitlines()[-1]
