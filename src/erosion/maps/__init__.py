"""From a table of impacts to the wear of each face of a surface."""
