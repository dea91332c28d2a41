"""The file of --config: both forms, the command line wins, and every wrong key is named."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.options import read_options

GIVEN = {
    "cycles": 40, "episode-cycles": 5, "mass": 2, "cell": 5, "package": ["a=b"], "gripper": True,
    "robot": "arm.urdf", "video": "", "record": "failed",
}  # fmt: skip
READ = {
    "cycles": 40, "episode_cycles": 5, "mass": 2.0, "cell": "5", "package": ("a=b",),
    "gripper": True, "robot": Path("arm.urdf"), "video": "", "record": "failed",
}  # fmt: skip


def test_json_and_toml_say_the_same(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(GIVEN))
    toml = "\n".join(f"{key} = {json.dumps(value)}" for key, value in GIVEN.items())
    (tmp_path / "a.toml").write_text(toml)
    assert read_options(tmp_path / "a.json") == READ
    assert read_options(tmp_path / "a.toml") == READ


def test_underscores_are_as_good_as_dashes(tmp_path):
    (tmp_path / "a.json").write_text('{"min_success": 0.5}')
    (tmp_path / "b.json").write_text('{"min-success": 0.5}')
    assert read_options(tmp_path / "a.json") == read_options(tmp_path / "b.json")


def test_the_configuration_of_a_run_gives_its_options_again(tmp_path):
    config = RunConfig(cycles=3, seed=7, cell="2", out=tmp_path / "out", xacro_arg=("a=1",))
    content = {"schema_version": 1, "options": config.as_json(), "versions": {}}
    (tmp_path / "config.json").write_text(json.dumps(content))
    again = RunConfig(**read_options(tmp_path / "config.json"), out=tmp_path / "out")
    assert again == config


BAD = {
    '{"cyles": 3}': "cyles",
    '{"cycles": 1.5}': "cycles",
    '{"cycles": true}': "cycles",
    '{"cycles": "3"}': "cycles",
    '{"mass": "heavy"}': "mass",
    '{"gripper": 1}': "gripper",
    '{"package": "a=b"}': "package",
    '{"package": [1]}': "package",
    '{"out": "a\\u0000b"}': "out",
    '{"scene": {"a": 1}}': "scene",
    '{"mass": 1' + "0" * 400 + "}": "mass",
    '{"min-success": 1, "min_success": 1}': "twice",
    '{"seed": ' + "9" * 5000 + "}": "not JSON",
    "[1]": "object",
    "{": "not JSON",
}


@pytest.mark.parametrize("text", BAD, ids=lambda text: text[:24])
def test_what_is_wrong_in_a_file_is_named(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(BadInput, match=BAD[text]) as refused:
        read_options(tmp_path / "a.json")
    assert "--config" in str(refused.value)
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize("name", ["nothing.json", "."])
def test_a_file_that_cannot_be_read_is_refused(tmp_path, name):
    with pytest.raises(BadInput, match="--config"):
        read_options(tmp_path / name)


def test_broken_toml_is_refused(tmp_path):
    (tmp_path / "a.toml").write_text("cycles = ")
    with pytest.raises(BadInput, match="not TOML"):
        read_options(tmp_path / "a.toml")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cycles": "ten"}, "--cycles: 'ten' is not a whole number"),
        ({"jobs": 1.5}, "--jobs: 1.5 is not a whole number"),
        ({"mass": "1"}, "--mass: '1' is not a number"),
        ({"cycles": None}, "--cycles: None is not a whole number"),
        ({"min_success": True}, "--min-success: True is not a number"),
        ({"resume": "yes"}, "--resume: 'yes' is not true or false"),
        ({"out": 5}, "--out: 5 is not a text"),
        ({"camera": "front"}, "--camera: 'front' is not a list of texts"),
        ({"cell": 0}, "--cell: '0' is no cell"),
    ],
)
def test_a_script_that_gives_another_kind_of_value_is_told(options, message):
    with pytest.raises(BadInput, match=re.escape(message)):
        RunConfig(**options)


def test_a_script_may_give_numbers_of_numpy_and_paths_as_text(tmp_path):
    config = RunConfig(cell=5, cycles=np.int64(3), mass=np.float32(0.5), out=str(tmp_path))
    assert (config.cell, config.cycles, config.mass, config.out) == ("5", 3, 0.5, tmp_path)
    json.dumps(config.as_json())
