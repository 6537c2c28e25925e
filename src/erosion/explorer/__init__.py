"""The explorer: a page on which every slider changes the cut (NiceGUI, extra `explorer`)."""
