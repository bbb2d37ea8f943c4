"""Settings that cannot be used are refused before the model is loaded."""

import pytest
from fixtures.service import TOKEN

from ha2g_jax.apps.serve.settings import Settings, check
from ha2g_jax.errors import UserError

BAD_SETTINGS = {
    "host": ({"host": "0.0.0.0"}, "other machines reach 0.0.0.0: give --token"),
    "empty host": ({"host": ""}, "give --token"),
    "short token": ({"token": "secret"}, "16 or more random characters"),
    "port": ({"port": 70000}, "the port is 70000"),
    "rate": ({"rate": float("nan")}, "--rate is nan"),
    "grace": ({"grace": -1}, "--grace is -1"),
    "seconds": ({"max_seconds": 0}, "--max-seconds is 0"),
}


@pytest.mark.parametrize("name", BAD_SETTINGS)
def test_bad_settings_are_refused(name):
    settings, message = BAD_SETTINGS[name]
    with pytest.raises(UserError, match=message):
        check(Settings(**settings))
    check(Settings(host="0.0.0.0", token=TOKEN))
