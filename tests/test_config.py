import pytest

from gpdf_service.config import Config
from gpdf_service.errors import ConfigError


def test_the_defaults_need_no_file():
    assert Config.from_mapping({}) == Config()


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
