"""Contents of the HTML report, as values: everything that the page shows, before it is drawn."""
