"""Documents that other programs read: JSON, JUnit XML, Markdown."""
