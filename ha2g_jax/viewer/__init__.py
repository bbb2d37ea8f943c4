"""Viewer of motion: one self-contained HTML page, as a file or in a notebook."""

from ha2g_jax.viewer.page import Page, view

__all__ = ["Page", "view"]
