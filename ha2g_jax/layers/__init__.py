"""Neural network layers that several methods share; none of them belongs to one method alone."""
