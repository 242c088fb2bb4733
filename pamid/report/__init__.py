"""A run as a page: `pamid.report.writing.write_report` reads a run folder, writes HTML and
figures."""
