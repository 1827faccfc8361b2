"""Documents: exact bytes, undo, autosave, and files that change behind them."""

import json
from pathlib import Path

import pytest

from evo_cpg.files import OutputError, write_text
from evo_cpg.io.load import load_config
from evo_cpg.view.drawing_page.commands import edit
from evo_cpg.view.drawing_page.document import Document, EditError, Texts
from evo_cpg.view.drawing_page.session import problems
from evo_cpg.view.drawing_page.yaml_edit import equal
from shipped_configs import some_configs

CONFIGS = Path(__file__).parents[3] / "configs"


def do(document: Document, command: str, **given):
    return document.apply(edit(command, document.path, given))


@pytest.fixture
def fish(tmp_path) -> Document:
    """A fish, whose creature has a file of its own."""
    (tmp_path / "creatures").mkdir()
    for name in ("fish.yaml", "creatures/fish.yaml"):
        (tmp_path / name).write_bytes((CONFIGS / name).read_bytes())
    return Document.open(tmp_path / "fish.yaml")


@some_configs
def test_the_data_are_those_that_the_program_loads(path):
    document = Document.open(path)
    assert not document.is_changed
    assert problems(document.data, document.path, thorough=False) is not None
    copied = Document.copy_of(path, Path("elsewhere.yaml"))
    assert equal(copied.data, document.data) and copied.texts.creature is None


def test_saving_without_a_change_keeps_the_bytes(tmp_path):
    path = tmp_path / "a.yaml"
    text = "\ufeff# Windows\r\nname: a\r\ncreature: {name: a}\r\n"
    path.write_bytes(text.encode())
    document = Document.open(path)
    document.save()
    assert path.read_bytes() == text.encode()
    do(document, "set_value", key=["seed"], value=3)
    document.save()
    assert path.read_bytes() == (text + "seed: 3\r\n").encode()


def test_an_edit_goes_to_the_file_of_its_key(fish):
    main, creature = fish.path, fish.path.parent / "creatures/fish.yaml"
    before = main.read_bytes(), creature.read_bytes()
    do(fish, "set_value", key=["creature", "bodies", 0, "color"], value="#ff8800")
    fish.save()
    assert main.read_bytes() == before[0]
    added = set(creature.read_text().splitlines()) - set(before[1].decode().splitlines())
    assert added == {"    color: '#ff8800'"}
    do(fish, "set_value", key=["seed"], value=7)
    fish.save()
    assert load_config(main).seed == 7 and load_config(main).creature.bodies[0].color == "#ff8800"


def test_undo_restores_the_exact_texts(fish):
    first = fish.texts
    do(fish, "stretch", name="head", factors=[1.1, 1, 0.9])
    newest = fish.texts
    assert fish.can_undo and not fish.can_redo
    # One more undo or redo than there are edits changes nothing.
    for _ in range(2):
        fish.undo()
        assert fish.texts == first and not fish.can_undo and not fish.is_changed
    for _ in range(2):
        fish.redo()
        assert fish.texts == newest
    fish.undo()
    do(fish, "set_value", key=["seed"], value=1)
    assert not fish.can_redo


def test_lost_comments_are_reported_before_the_edit(fish):
    change = fish.propose(edit("remove_part", fish.path, {"name": "{side}_pectoral"}))
    assert set(change.lost) == {"# swept back", "# up, then twist with the front edge up"}
    assert not fish.is_changed
    fish.accept(change)
    assert fish.is_changed


def test_an_autosave_survives_a_crash(fish):
    do(fish, "set_value", key=["seed"], value=7)
    autosave = fish.path.parent / ".fish.yaml.autosave"
    again = Document.open(fish.path)
    assert again.recovered and again.texts == fish.texts and again.is_changed
    undone = Document.open(fish.path)
    undone.undo()
    undone.discard()
    assert not undone.recovered and not undone.is_changed
    # The other program still works, and saves itself again.
    fish.undo()
    fish.redo()
    again = Document.open(fish.path)
    again.discard()
    assert not again.is_changed and not autosave.exists() and again.can_undo
    again.undo()
    assert again.data["seed"] == 7
    again.save()
    assert not autosave.exists()
    assert not Document.open(fish.path).recovered


def test_an_autosave_of_other_texts_is_ignored(fish):
    do(fish, "set_value", key=["seed"], value=7)
    fish.path.write_text(fish.path.read_text() + "runs: 2\n")
    autosave, old = (fish.path.parent / f".fish.yaml.autosave{end}" for end in ("", ".old"))
    kept = autosave.read_bytes()
    assert not Document.open(fish.path).recovered
    assert old.read_bytes() == kept and not autosave.exists()
    for wrong in ("", "[]", json.dumps({"base": "", "texts": [1, 2]})):
        autosave.write_text(wrong)
        assert not Document.open(fish.path).recovered


def test_an_interrupted_save_loses_no_edit(fish, monkeypatch):
    creature = fish.path.parent / "creatures/fish.yaml"
    before = creature.read_bytes()
    do(fish, "set_value", key=["seed"], value=7)
    do(fish, "set_value", key=["creature", "bodies", 0, "color"], value="#ff8800")

    def write(path: Path, text: str) -> None:
        if path == creature:
            raise OutputError("the disk is full")
        write_text(path, text)

    with monkeypatch.context() as broken:
        broken.setattr("evo_cpg.view.drawing_page.document.write_text", write)
        with pytest.raises(OutputError, match="the disk is full"):
            fish.save()
    assert load_config(fish.path).seed == 7 and creature.read_bytes() == before
    again = Document.open(fish.path)
    assert again.recovered and again.texts == fish.texts
    fish.save()
    assert load_config(fish.path).creature.bodies[0].color == "#ff8800"


def test_the_creature_stays_in_its_own_file(fish):
    main = fish.texts.main
    do(fish, "set_value", key=["creature", "file"], value="../elsewhere.yaml")
    assert fish.texts.main == main


def test_a_file_that_changed_on_the_disk_is_not_overwritten(fish, tmp_path):
    do(fish, "set_value", key=["seed"], value=7)
    fish.path.write_text(fish.path.read_text() + "runs: 2\n")
    with pytest.raises(EditError, match="has changed on the disk"):
        fish.save()
    with pytest.raises(EditError, match="exists"):
        fish.save_as(fish.path)
    fish.save_as(tmp_path / "other.yaml")
    assert load_config(tmp_path / "other.yaml").seed == 7
    assert not fish.is_changed and fish.texts == Texts(fish.texts.main)


def test_a_new_document_is_valid_and_overwrites_nothing(tmp_path):
    document = Document.new(tmp_path / "my fish.yaml")
    assert document.data["name"] == "my_fish" and not (tmp_path / "my fish.yaml").exists()
    (tmp_path / "my fish.yaml").write_text("precious")
    with pytest.raises(EditError, match="exists"):
        document.save()
    (found,) = problems(document.data, document.path, thorough=False)
    assert found.kind == "warning" and "eye" in found.words
