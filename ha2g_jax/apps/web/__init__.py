"""A site for browsers: a model that generates motion in the page, without a server."""

from ha2g_jax.apps.web.site import write_site as write_site
