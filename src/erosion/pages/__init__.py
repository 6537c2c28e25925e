"""The frame that all pages share, and the page of a map."""
