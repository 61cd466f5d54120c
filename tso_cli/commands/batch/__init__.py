"""`tso batch`: options, items, the run, and its page."""
