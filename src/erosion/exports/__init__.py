"""What CFD codes take of a model and a case: coefficients, volumes, rebounds. Measurements are not known here."""
