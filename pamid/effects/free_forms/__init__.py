"""Free forms of the families: a file per form, scanned as the catalogue is, but no part of it."""
