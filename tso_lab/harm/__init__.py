"""How often a cloud gets worse in the field, and whether tso says so."""
