"""Applications on top of the core, which imports none of them."""
