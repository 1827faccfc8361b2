import pytest


@pytest.fixture
def usage_error(cli, tmp_path):
    def call(*arguments):
        code, out, err = cli(*arguments, folder=tmp_path)
        assert (code, out) == (2, "")
        return err.splitlines()[-1]

    return call


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("train", "Missing argument 'CONFIG'. Name a configuration, such as iwadate2010_swimmer."),
        ("render", "Missing argument 'RUN'. Name a run folder."),
        ("lab", "Missing argument 'ANIMAL'. Name a configuration, such as eel, or a run folder."),
    ],
)
def test_a_missing_argument_gets_an_example(usage_error, command, words):
    assert words in usage_error(command)


@pytest.mark.parametrize(
    ("arguments", "setting"),
    [
        (("--generations", "3"), "evolution.generations=3"),
        (("--population=80",), "evolution.population=80"),
        (("--seed", "7"), "seed=7"),
        (("--seconds",), "simulation.seconds=VALUE"),
    ],
)
def test_an_option_that_is_a_setting_is_written_as_one(usage_error, arguments, setting):
    message = usage_error("train", "eel", *arguments)
    assert message.startswith(f"Error: No such option: {arguments[0].partition('=')[0]}. ")
    assert message.endswith(f"a setting, which has no dashes: {setting}")


def test_other_unknown_options_get_similar_options(usage_error):
    assert "--out" in usage_error("train", "eel", "--outt", "x")
    # This command takes no settings.
    assert "setting" not in usage_error("render", "runs/eel", "--seed", "3")
