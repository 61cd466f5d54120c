"""How fast it is: contestants for the same work, measured by turns in one run, and what the machine could do at best."""
