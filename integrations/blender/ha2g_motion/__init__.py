"""Motion of ha2g-jax in Blender: an add-on with a panel, whose functions the script without a window uses, too.

The add-on does not need the package ha2g_jax: it reads the files of `ha2g export`. `reading`, `bvh`, `glb`,
`checks`, `rotations`, `bone_names` and `fitting` need numpy only;
`armatures`, `keys`, `scene` and `panel` need Blender.
"""


def register() -> None:
    """Add the panel; Blender calls this when the add-on is enabled."""
    from . import panel

    panel.register()


def unregister() -> None:
    """Remove the panel."""
    from . import panel

    panel.unregister()
