"""The two papers that pamid comes from: their tables on calibrated virtual rigs (twins), never on the authors' own."""
