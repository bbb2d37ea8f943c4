"""The generators that HA2G is compared with (HA2G, Table 1), a file each, over the project's own layers."""
