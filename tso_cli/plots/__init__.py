"""Pictures and tables of results; matplotlib is imported inside."""
