"""How wrong the input may be: one thing at a time, from harmless to hopeless."""
