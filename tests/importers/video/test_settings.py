"""Settings come from a file and the command line, and a wrong one is named."""

import json

import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.importers.video.settings import VideoSettings, from_pairs, read_settings


def test_settings_survive_a_file(tmp_path):
    settings = from_pairs(["min_seconds=3", "recognise=tiny.en", "filters.min_words=none", "filters.stride = 5"])
    assert settings.min_seconds == 3.0 and settings.recognise == "tiny.en"
    assert settings.filters == VideoSettings().filters._replace(min_words=None, stride=5)
    path = tmp_path / "settings.json"
    path.write_text(json.dumps(settings.as_json()))
    assert read_settings(path) == settings
    assert from_pairs(["min_seconds=5", "recognise=none", "filters.min_words=2", "filters.stride=10"], settings) == (
        VideoSettings()
    )


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ("min_second=3", "unknown setting 'min_second'"),
        ("min_seconds=long", "expected a number"),
        ("min_seconds=nan", "expected a number"),
        ("min_visible=50", "expected a number from 0 to 1"),
        ("filters.stride=0", "expected a whole number from 1"),
    ],
)
def test_a_wrong_pair_says_what_was_expected(pair, message):
    with pytest.raises(UserError, match=message):
        from_pairs([pair])
