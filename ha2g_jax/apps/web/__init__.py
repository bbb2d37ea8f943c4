"""A site for browsers: a model that generates motion in the page, without a server."""
