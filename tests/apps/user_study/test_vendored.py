"""The library in the site is the released one, with its licence."""

import hashlib
import importlib.resources

ASSETS = importlib.resources.files("ha2g_jax") / "assets" / "study"
JSPSYCH_8_3_0 = "b58c69e607f2ddbd282f2daec43d882cac18d9e3efdad816215b818d1406d6ce"


def test_jspsych_is_dist_index_browser_min_js_of_its_npm_package():
    assert hashlib.sha256((ASSETS / "jspsych.min.js").read_bytes()).hexdigest() == JSPSYCH_8_3_0


def test_the_licences_of_all_its_parts_are_there():
    text = (ASSETS / "LICENSES.txt").read_text("utf-8")
    for part in ("jsPsych 8.3.0", "auto-bind 4.0.0", "random-words 1.3.0", "seedrandom 3.0.5"):
        assert part in text
    assert text.count("Permission is hereby granted") == 4
