"""How wrong the input may be: one difficulty at a time, from harmless to hopeless."""
