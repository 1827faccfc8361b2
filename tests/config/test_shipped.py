"""Configurations that come with the program: found by their names, told apart, copied."""

import filecmp
from pathlib import Path

import pytest

from evo_cpg.api.load import load
from evo_cpg.config import shipped as module
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.load import load_config
from evo_cpg.config.shipped import (
    copy_shipped,
    find_config,
    shipped,
    shipped_folder,
    shipped_name,
    shipped_names,
)
from evo_cpg.config.trust import VARIABLE
from tiny_run import CONFIG, REPOSITORY

CONFIGS = REPOSITORY / "configs"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Seen from an empty folder, and trusted no more than others."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(VARIABLE)


def test_in_a_checkout_they_are_those_of_its_folder():
    assert shipped_folder() == CONFIGS
    assert shipped_names() == sorted(path.stem for path in CONFIGS.glob("*.yaml"))


def test_an_installed_package_has_its_own_and_not_what_lies_beside_it(tmp_path, monkeypatch):
    package = tmp_path / "site-packages" / "evo_cpg"
    (package.parent / "configs").mkdir(parents=True)
    (package.parent / "configs" / "anybodys.yaml").touch()
    monkeypatch.setattr(module, "_PACKAGE", package)
    assert shipped_folder() is None and shipped_names() == []
    (package / "configs").mkdir(parents=True)
    (package / "configs" / "ours.yaml").touch()
    assert shipped_names() == ["ours"]


@pytest.mark.parametrize("name", shipped_names())
def test_every_one_is_told_in_a_sentence_of_its_own(name):
    found = shipped(name)
    assert (found.name, found.path) == (name, CONFIGS / f"{name}.yaml")
    assert 20 < len(found.summary) < 190 and not found.summary.endswith(".")
    assert found.summary not in {
        shipped(other).summary for other in shipped_names() if other != name
    }
    start = name.partition("_")[0]
    if start in ("iwadate2010", "fukui2003"):
        assert found.study.replace(" ", "").lower() == start
    elif start in ("hexapod", "starfish", "turtle"):
        assert found.study == ""
    else:
        assert found.study in ("Iwadate 2010", "Fukui 2003")


def test_a_sentence_ends_at_its_point_and_a_study_has_a_year(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "shipped_folder", lambda: tmp_path)
    (tmp_path / "a.yaml").write_text(
        "# Ten of them (Poe, Dickens and Melville 1951), of 1.5 m. They\n# swim.\n#\n# More 1999.\n"
    )
    (tmp_path / "b.yaml").write_text("name: b\n# Not at the head 2000\n")
    assert shipped("a")[3:] == (
        "Ten of them (Poe, Dickens and Melville 1951), of 1.5 m",
        "Poe 1951",
    )
    assert shipped("b")[3:] == ("", "")


def test_a_file_that_is_there_wins_over_the_name(tmp_path):
    assert find_config("hexapod") == CONFIGS / "hexapod.yaml"
    Path("hexapod").write_text("name: mine\n")
    assert find_config("hexapod") == find_config(Path("./hexapod")) == Path("hexapod")


def test_a_folder_wins_only_where_a_folder_is_meant():
    Path("hexapod").mkdir()
    Path("mine").mkdir()
    assert find_config("hexapod") == CONFIGS / "hexapod.yaml"
    assert find_config("hexapod", folders=True) == Path("hexapod")
    assert find_config("mine") == Path("mine")


@pytest.mark.parametrize("path", ["x.yaml", "configs/hexapod", "hexapod.yaml", "../x", "/x", ".."])
def test_what_has_a_folder_or_a_suffix_is_a_path(path):
    assert find_config(path) == Path(path)


@pytest.mark.parametrize("name", ["hexapodd", "a" * 5000, "a\0b"])
def test_an_unknown_name_is_answered_with_the_nearest(name):
    with pytest.raises(ConfigError, match="no such file here, and no configuration") as caught:
        find_config(name)
    assert ("did you mean 'hexapod'?" in str(caught.value)) == (name == "hexapodd")
    assert "iwadate2010_swimmer" in str(caught.value)
    with pytest.raises(ConfigError, match="no configuration of this name comes with evo-cpg; "):
        shipped(name)


def test_a_file_of_ones_own_is_named_with_its_suffix():
    Path("mine.yaml").touch()
    with pytest.raises(ConfigError, match=r"did you mean 'mine\.yaml'\?"):
        find_config("mine")


def test_a_missing_file_that_is_shipped_is_named():
    for path in ("hexapod.yaml", "configs/hexapod.yaml"):
        with pytest.raises(ConfigError, match=f"{path}: no such file; that which .* hexapod$"):
            load_config(path)


def test_python_knows_them_by_name():
    experiment = load("hexapod", {"seed": 3})
    assert experiment.name == "hexapod" and experiment.config.seed == 3
    assert experiment.source == CONFIGS / "hexapod.yaml"
    with pytest.raises(ConfigError, match="did you mean 'hexapod'"):
        load("hexapot")


def test_a_file_knows_whether_it_is_shipped(tmp_path):
    assert shipped_name(CONFIG) == "iwadate2010_swimmer"
    assert shipped_name(CONFIGS / "creatures" / "hexapod.yaml") is None
    assert shipped_name(tmp_path / "hexapod.yaml") is None
    assert shipped_name(CONFIGS / "configuration") is None


@pytest.mark.parametrize("name", shipped_names())
def test_a_copy_is_whole(name, tmp_path):
    made = copy_shipped(name, tmp_path / "new" / "folder")
    assert made == tmp_path / "new" / "folder" / f"{name}.yaml"
    assert load_config(made) == load_config(CONFIGS / f"{name}.yaml")
    files = [path for path in (tmp_path / "new").rglob("*") if path.is_file()]
    assert 2 <= len(files) <= 3
    for path in files:
        assert filecmp.cmp(path, CONFIGS / path.relative_to(made.parent), shallow=False)


def test_meshes_are_copied_too(tmp_path, monkeypatch):
    import trimesh

    theirs = tmp_path / "theirs"
    (theirs / "creatures" / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.1, 0.1, 0.1)).export(theirs / "creatures" / "meshes" / "box.stl")
    (theirs / "creatures" / "lump.yaml").write_text(
        "name: lump\nmaterials: {stuff: {density: 1000}}\nlight_sensors: [{body: lump}]\n"
        "bodies: [{name: lump, shape: {type: mesh, file: meshes/box.stl}, material: stuff}]\n"
    )
    (theirs / "lump.yaml").write_text("name: lump\ncreature: creatures/lump.yaml\n")
    monkeypatch.setattr(module, "shipped_folder", lambda: theirs)
    made = copy_shipped("lump", tmp_path / "mine")
    assert (tmp_path / "mine" / "creatures" / "meshes" / "box.stl").is_file()
    assert load_config(made) == load_config(theirs / "lump.yaml")


def test_where_no_folder_can_be_made_nothing_is_copied(tmp_path):
    (tmp_path / "creatures").write_text("mine")
    with pytest.raises(OSError, match="creatures"):
        copy_shipped("hexapod", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["creatures"]


def test_a_copy_replaces_nothing(tmp_path):
    copy_shipped("salamander_boulders", tmp_path)
    # They have the animal in common.
    copy_shipped("salamander_amphibious", tmp_path)
    changed = tmp_path / "creatures" / "salamander.yaml"
    changed.write_text("mine")
    with pytest.raises(ConfigError, match=r"salamander\.yaml: exists already, and is not that of"):
        copy_shipped("iwadate2010_salamander_land", tmp_path)
    assert changed.read_text() == "mine"
    assert not (tmp_path / "iwadate2010_salamander_land.yaml").exists()
    assert not list(tmp_path.rglob("*.partial"))
