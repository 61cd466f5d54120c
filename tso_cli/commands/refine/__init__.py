"""`tso refine`: options, files, the run, and its words."""
