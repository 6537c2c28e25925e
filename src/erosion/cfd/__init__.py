"""What runs of CFD codes leave: tables of impacts, and the surfaces that they hit. No model is known here."""
