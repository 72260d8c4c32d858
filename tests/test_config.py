from dataclasses import fields
from pathlib import Path

import pytest

import gpdf_service
from gpdf_service.config import Config
from gpdf_service.errors import ConfigError


def test_the_defaults_need_no_file():
    assert Config.from_mapping({}) == Config()


def test_every_value_is_asked_for():
    sources = "".join(path.read_text() for path in Path(gpdf_service.__file__).parent.rglob("*.py"))
    for table in fields(Config):
        for value in fields(getattr(Config(), table.name)):
            assert f".{value.name}" in sources, value.name


def test_a_value_that_nobody_asks_for_any_more_is_no_reason_to_refuse_a_scene_that_was_kept():
    kept = {"perception": {"tread_length": 0.3, "tread_depth": 0.21}}
    assert Config.from_kept(kept) == Config.from_mapping({"perception": {"tread_depth": 0.21}})


def test_a_nested_value_is_taken():
    assert Config.from_mapping({"fields": {"noise_variance": 1}}).fields.noise_variance == 1.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"field": {}}, "config.field: there is no such key"),
        ({"fields": {"length": 1.0}}, "config.fields.length: there is no such key"),
        ({"fields": {"noise_variance": "low"}}, "must be of type float"),
        ({"fields": {"noise_variance": True}}, "must be of type float"),
        ({"fields": 3}, "must be a table"),
        ({"fields": {"noise_variance": -1.0}}, "positive"),
        ({"planning": {"waypoint_spacing": float("nan")}}, "positive"),
        ({"planning": {"max_iterations": 0}}, "positive"),
    ],
)
def test_a_wrong_value_is_refused_with_its_place(values, message):
    with pytest.raises(ConfigError, match=message):
        Config.from_mapping(values)
