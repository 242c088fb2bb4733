"""A run as a page: `pamid.report.writing.write_report` reads the run folder and writes one HTML file and its figures."""
