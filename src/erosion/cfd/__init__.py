"""A CFD run: its tables of impacts and its surfaces, the wear of each face, and what the codes take of a model."""
