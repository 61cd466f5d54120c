"""`tso train` and `tso train-prior`: options, data, files and recipes."""
