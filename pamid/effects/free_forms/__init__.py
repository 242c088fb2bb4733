"""Free forms of the families: one file per form, scanned as the catalogue is, but no part of it."""
