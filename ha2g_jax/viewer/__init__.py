"""Motion in a browser: one HTML page that holds all it needs, as a file or in a notebook."""

from ha2g_jax.viewer.page import Page, view, write_page

__all__ = ["Page", "view", "write_page"]
