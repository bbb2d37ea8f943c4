"""Motion of ha2g-jax in Blender: an add-on with a panel, and the functions that the headless script uses too.

Nothing here needs the ha2g_jax package: the files that `ha2g export` writes hold all that is read. `reading`, `bvh`,
`glb`, `rotations`, `bone_names` and `fitting` need numpy only; `armatures`, `keys`, `scene` and `panel` need Blender.
"""


def register() -> None:
    """Add the panel; Blender calls this when the add-on is enabled."""
    from . import panel

    panel.register()


def unregister() -> None:
    """Remove the panel."""
    from . import panel

    panel.unregister()
