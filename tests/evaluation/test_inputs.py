"""What the results say of the motion that is scored."""

from ha2g_jax.evaluation import inputs


def test_scored_frames_that_were_given_are_named():
    assert inputs._given(4) == inputs._given(1) == []
    (note,) = inputs._given(7)
    assert "first 7 frames" in note and "knew those of the first 3 scored frames" in note
