"""The description of a config lists the shapes in the tables of the paper."""

import json

from ha2g_jax.config import presets
from ha2g_jax.config import settings as configs
from ha2g_jax.train.describe import as_table, describe


def _outputs(rows):
    return {row["module"]: row["output"] for row in rows}


def test_lists_the_paper_s_shapes_of_ted_expressive():
    rows = describe(configs.paper("ted_expressive"))
    outputs = _outputs(rows)
    audio = {name: outputs[f"generator.audio.{name}"] for name in ("stage_2", "stage_3", "stage_4")}
    assert audio == {"stage_2": "64x64x35", "stage_3": "128x32x18", "stage_4": "256x16x9"}
    assert [outputs[f"generator.audio.{name}"] for name in ("low", "mid", "high")] == ["32x34"] * 3
    widths = (24, 30, 36, 66, 96, 126)
    assert [outputs[f"generator.pose_{level}"] for level in range(1, 7)] == [f"34x{width}" for width in widths]
    assert outputs["generator.coordinator"] == "3x6"
    assert outputs["generator.identity.resnet"] == "512x7x7"
    assert outputs["discriminator.gru"] == "28x64"
    assert outputs["autoencoder.encoder"] == "128"
    stage = next(row for row in rows if row["module"] == "generator.audio.stage_2")
    assert stage["output_shapes"] == [[64, 64, 35]]
    assert stage["input"] == "32x128x70"
    json.dumps(rows)


def test_parts_add_up_and_tables_that_grow_with_data_are_left_out():
    rows = describe(presets.sized("ted_expressive", "debug"))
    counts = {row["module"]: row["parameters"] for row in rows}
    for whole in ("generator", "generator.audio", "generator.pose_1", "discriminator", "autoencoder.encoder"):
        depth = whole.count(".") + 1
        parts = [count for name, count in counts.items() if name.startswith(whole + ".") and name.count(".") == depth]
        assert sum(parts) == counts[whole], whole
    assert "generator.text.embedding" not in counts

    table = as_table(rows).splitlines()
    assert table[0].split() == ["module", "input", "output", "parameters"]
    total = next(line for line in table if line.startswith("total"))
    networks = counts["generator"] + counts["discriminator"] + counts["autoencoder"]
    assert total.split()[-1] == f"{networks:,}"
