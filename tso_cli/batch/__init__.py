"""Many items from files, once each: the manifest, the journal, and the run over both."""
